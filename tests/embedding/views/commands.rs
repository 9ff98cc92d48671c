//! Numbers of commands and objects that views need, counted in the device's table.

use super::{BLACK, SIZE, record_groups};
use crate::array_image::ArrayImage;
use crate::stage::*;
use std::cell::RefCell;

thread_local! {
    /// Names of the functions that this thread has called.
    static CALLS: RefCell<Vec<&'static str>> = const { RefCell::new(Vec::new()) };
}

fn note(name: &'static str) {
    CALLS.with_borrow_mut(|calls| calls.push(name));
}

/// Calls of dispatches, of barriers, and of new descriptor pools since the last call of this.
fn taken() -> [usize; 3] {
    let calls = CALLS.take();
    let count = |names: &[&str]| calls.iter().filter(|call| names.contains(call)).count();
    [
        count(&["vkCmdDispatch", "vkCmdDispatchIndirect"]),
        count(&["vkCmdPipelineBarrier2"]),
        count(&["vkCreateDescriptorPool"]),
    ]
}

wrappers! {
    note;
    "vkCmdDispatch" dispatch(c: vk::CommandBuffer, x: u32, y: u32, z: u32) -> ();
    "vkCmdDispatchIndirect" dispatch_indirect(c: vk::CommandBuffer, b: u64, o: u64) -> ();
    "vkCmdPipelineBarrier2" barrier(c: vk::CommandBuffer, d: *const c_void) -> ();
    "vkCreateDescriptorPool" create_pool(d: vk::Device, i: *const c_void, a: *const c_void, p: *mut u64) -> i32;
}

fn counting(host: &Host) -> ash::Device {
    let replace = |name: &CStr, own| wrapped(name, own).unwrap_or(own);
    // SAFETY: every address is null, the device's own function, or a wrapper of its type.
    unsafe { device_with(host, replace) }
}

fn counts(host: &Host, renderer: &mut Renderer, groups: &[&[RecordedFrame<'_>]]) -> [usize; 2] {
    let in_flight = Commands::new(host);
    in_flight.begin();
    taken();
    record_groups(&in_flight, renderer, groups);
    let [dispatches, barriers, ..] = taken();
    in_flight.finish();
    [dispatches, barriers]
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
        let context = guest_of(&foreign, &ContextOptions::default());
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
        taken();
        renderer.reserve(&wanted).expect("memory");
        assert!(taken()[2] > 0);
        let in_flight = Commands::new(host);
        let commands = in_flight.begun(&context);
        renderer.record_views(commands, 0, &views, &mut [Release::default(); VIEWS]).expect("a recording");
        assert_eq!(taken()[2], 0, "pools are made while recording");
        in_flight.finish();
    });
}
