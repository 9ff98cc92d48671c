//! Numbers of commands and objects that views need, counted in the device's table.

use super::{BLACK, SIZE, record_groups};
use crate::array_image::ArrayImage;
use crate::stage::*;
use std::mem::transmute;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

/// Generates a wrapper for each command: statics with the real address and the number of calls, and a function that
/// counts and forwards.
macro_rules! counted {
    ($($name:literal $wrapper:ident($($arg:ident: $ty:ty),*);)*) => {
        mod real {
            use super::AtomicUsize;
            $(#[allow(non_upper_case_globals)] pub static $wrapper: AtomicUsize = AtomicUsize::new(0);)*
        }
        mod calls {
            use super::AtomicU32;
            $(#[allow(non_upper_case_globals)] pub static $wrapper: AtomicU32 = AtomicU32::new(0);)*
        }
        $(unsafe extern "system" fn $wrapper($($arg: $ty),*) {
            calls::$wrapper.fetch_add(1, Ordering::Relaxed);
            // SAFETY: the address is that of the device's function of this type.
            unsafe {
                let f: unsafe extern "system" fn($($ty),*) = transmute(real::$wrapper.load(Ordering::Relaxed));
                f($($arg),*)
            }
        })*
        fn wrapped(name: &str, address: usize) -> Option<*const c_void> {
            match name {
                $($name => {
                    real::$wrapper.store(address, Ordering::Relaxed);
                    Some($wrapper as *const c_void)
                })*
                _ => None,
            }
        }
        /// Calls of each command since the last call of this.
        fn taken() -> [u32; 6] {
            [$(calls::$wrapper.swap(0, Ordering::Relaxed)),*]
        }
    };
}

counted! {
    "vkCmdDispatch" dispatch(c: vk::CommandBuffer, x: u32, y: u32, z: u32);
    "vkCmdDispatchIndirect" dispatch_indirect(c: vk::CommandBuffer, b: u64, o: u64);
    "vkCmdPipelineBarrier2" barrier(c: vk::CommandBuffer, d: *const c_void);
    "vkCmdFillBuffer" fill(c: vk::CommandBuffer, b: u64, o: u64, s: u64, v: u32);
    "vkCmdUpdateBuffer" update(c: vk::CommandBuffer, b: u64, o: u64, s: u64, d: *const c_void);
    "vkCmdCopyBuffer" copy(c: vk::CommandBuffer, f: u64, t: u64, n: u32, r: *const c_void);
}

/// The device's vkCreateDescriptorPool, and the number of its calls.
static CREATE_POOL: AtomicUsize = AtomicUsize::new(0);
static POOLS: AtomicU32 = AtomicU32::new(0);

unsafe extern "system" fn create_pool(
    device: vk::Device,
    info: *const vk::DescriptorPoolCreateInfo<'_>,
    allocator: *const vk::AllocationCallbacks<'_>,
    pool: *mut vk::DescriptorPool,
) -> vk::Result {
    POOLS.fetch_add(1, Ordering::Relaxed);
    // SAFETY: the address is that of the device's function.
    unsafe {
        let f: vk::PFN_vkCreateDescriptorPool = transmute(CREATE_POOL.load(Ordering::Relaxed));
        f(device, info, allocator, pool)
    }
}

fn counting(host: &Host) -> ash::Device {
    let replace = |name: &CStr, address: *const c_void| {
        if name == c"vkCreateDescriptorPool" {
            CREATE_POOL.store(address as usize, Ordering::Relaxed);
            return create_pool as *const c_void;
        }
        wrapped(&name.to_string_lossy(), address as usize).unwrap_or(address)
    };
    // SAFETY: every address is null, the device's own function, or a wrapper of its type.
    unsafe { device_with(host, replace) }
}

fn counts(host: &Host, renderer: &mut Renderer, groups: &[&[RecordedFrame<'_>]]) -> [u32; 3] {
    let in_flight = Commands::new(host);
    in_flight.begin();
    taken();
    record_groups(&in_flight, renderer, groups);
    let [direct, indirect, barriers, fills, updates, copies] = taken();
    in_flight.finish();
    [direct + indirect, barriers, fills + updates + copies]
}

/// Two eyes in two recordings, in one, and with one sort: fewer commands each time.
#[test]
fn views_of_one_recording_have_fewer_commands() {
    with_host(&HostOptions::default(), |host| {
        let device = counting(host);
        let options = ContextOptions { timestamps: false, hazard_check: false, ..ContextOptions::default() };
        let foreign = ForeignDevice { device: &device, ..host.foreign() };
        let context = guest_of(&foreign, &options);
        let scene = uploaded(&context, &cloud(300, 1));
        let placed = [Placed::from(&scene)];
        let left = camera(0.3, SIZE[0], SIZE[1]);
        let cameras = [left, left.moved_aside([0.3, 0.0])];
        let array = ArrayImage::new(host, &context, SIZE, 2);
        let views = array.frames(&placed, &cameras);
        let wanted = Reservation::new(300, 1, SIZE[0], SIZE[1]);
        let wanted = Reservation { slots: 2, views: 2, images_only: true, ..wanted };
        let mut renderer = reserved(&context, &wanted);
        let two = counts(host, &mut renderer, &[&views[..1], &views[1..]]);
        let one = counts(host, &mut renderer, &[&views]);
        renderer.reserve(&Reservation { shared_sort: true, ..wanted }).expect("memory");
        let shared = counts(host, &mut renderer, &[&views]);
        assert!(one[0] == two[0] && one[1] < two[1], "{one:?}, {two:?}");
        assert!(shared[0] < one[0] && shared[1] < one[1], "{shared:?}, {one:?}");
    });
}

/// Without push descriptors, a reservation includes the sets of many views with images.
#[test]
fn many_views_make_no_descriptor_pool() {
    const VIEWS: usize = 20;
    with_host(&HostOptions { push_descriptors: false, ..HostOptions::default() }, |host| {
        let device = counting(host);
        let foreign = ForeignDevice { device: &device, ..host.foreign() };
        // SAFETY: as in `guest`.
        let context = unsafe { Context::from_foreign(&foreign, &ContextOptions::default()) };
        let context = context.expect("a context");
        let scene = uploaded(&context, &cloud(10, 1));
        let placed = [Placed::from(&scene)];
        let (eye, array) = (camera(0.3, SIZE[0], SIZE[1]), ArrayImage::new(host, &context, SIZE, 1));
        let views = [(); VIEWS].map(|()| RecordedFrame {
            target: into(&array.layers[0], BLACK, [0; 2]),
            ..frame_of(&placed, &eye)
        });
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation::new(10, 1, SIZE[0], SIZE[1]);
        let wanted = Reservation { views: VIEWS as u32, images_only: true, ..wanted };
        let before = POOLS.load(Ordering::Relaxed);
        renderer.reserve(&wanted).expect("memory");
        let reserved = POOLS.load(Ordering::Relaxed);
        assert!(reserved > before);
        let in_flight = Commands::new(host);
        let commands = in_flight.begun(&context);
        renderer.record_views(commands, 0, &views, &mut [Release::default(); VIEWS]).expect("a recording");
        assert_eq!(POOLS.load(Ordering::Relaxed), reserved, "pools are made while recording");
        in_flight.finish();
    });
}
