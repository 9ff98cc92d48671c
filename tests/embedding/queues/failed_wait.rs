//! A wait fails on a host's device whose queue has a lock. A thread of the guest then waits for the queue instead of
//! the fence, and holds the lock meanwhile.

use super::SIZE;
use crate::host::Host;
use crate::stage::{camera, cloud, device_with, options, owned, with_host};
use ashsplat::ash::{self, vk};
use ashsplat::vk::{Context, ContextOptions, ForeignDevice, QueueLock};
use ashsplat::{RenderSettings, Renderer};
use std::ffi::{CStr, c_void};
use std::mem::transmute;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A host's lock.
struct Gate;

static HELD: AtomicBool = AtomicBool::new(false);

// SAFETY: one thread at a time has set the flag.
unsafe impl QueueLock for Gate {
    fn lock(&self) {
        while HELD.swap(true, Ordering::SeqCst) {
            std::thread::yield_now();
        }
    }

    fn unlock(&self) {
        assert!(HELD.swap(false, Ordering::SeqCst), "not held");
    }
}

/// The device's vkWaitForFences, the number of its next calls that fail, and the device's vkQueueWaitIdle.
static WAIT: AtomicUsize = AtomicUsize::new(0);
static FAILING: AtomicU32 = AtomicU32::new(0);
static IDLE: AtomicUsize = AtomicUsize::new(0);
/// Calls of vkQueueWaitIdle without the lock, and with it.
static IDLES: [AtomicU32; 2] = [AtomicU32::new(0), AtomicU32::new(0)];

unsafe extern "system" fn wait(
    device: vk::Device,
    count: u32,
    fences: *const vk::Fence,
    all: vk::Bool32,
    nanoseconds: u64,
) -> vk::Result {
    let fewer = |failing: u32| failing.checked_sub(1);
    if FAILING.fetch_update(Ordering::SeqCst, Ordering::SeqCst, fewer).is_ok() {
        return vk::Result::ERROR_OUT_OF_HOST_MEMORY;
    }
    // SAFETY: the address is that of the device's function.
    unsafe {
        let real: vk::PFN_vkWaitForFences = transmute(WAIT.load(Ordering::SeqCst));
        real(device, count, fences, all, nanoseconds)
    }
}

unsafe extern "system" fn idle(queue: vk::Queue) -> vk::Result {
    IDLES[usize::from(HELD.load(Ordering::SeqCst))].fetch_add(1, Ordering::SeqCst);
    // SAFETY: the address is that of the device's function.
    unsafe {
        let real: vk::PFN_vkQueueWaitIdle = transmute(IDLE.load(Ordering::SeqCst));
        real(queue)
    }
}

/// The host's device with wrapped wait functions.
fn watched(host: &Host) -> ash::Device {
    let replace = |name: &CStr, address: *const c_void| {
        let (real, wrapper) = match name.to_bytes() {
            b"vkWaitForFences" => (&WAIT, wait as *const c_void),
            b"vkQueueWaitIdle" => (&IDLE, idle as *const c_void),
            _ => return address,
        };
        real.store(address as usize, Ordering::SeqCst);
        wrapper
    };
    // SAFETY: every address is null, the device's own function, or a wrapper of its type.
    unsafe { device_with(host, replace) }
}

#[test]
fn a_wait_that_fails_is_made_up_for_within_a_hosts_lock() {
    with_host(&options(), |host| {
        let device = watched(host);
        let foreign = ForeignDevice { device: &device, queue_lock: Some(Arc::new(Gate)), ..host.foreign() };
        // SAFETY: as in `guest`; nobody else submits.
        let context =
            unsafe { Context::from_foreign(&foreign, &ContextOptions::default()) }.expect("a context");
        let (gaussians, settings) = (cloud(100, 3), RenderSettings::default());
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.upload(&gaussians).expect("a scene");
        let idles = || IDLES.each_ref().map(|count| count.load(Ordering::SeqCst));
        assert_eq!(idles(), [0, 0], "a wait that succeeds is enough");
        // The first wait, and the one that would make sure that nothing runs.
        FAILING.store(2, Ordering::SeqCst);
        let error = renderer.render(&view, &settings).map(drop).expect_err("the wait failed").to_string();
        assert!(error.contains("vkWaitForFences") && error.contains("OUT_OF_HOST_MEMORY"), "{error}");
        // Nobody else submits, so that thread holds the flag.
        let start = Instant::now();
        while idles() == [0, 0] || HELD.load(Ordering::SeqCst) {
            assert!(start.elapsed() < Duration::from_secs(60), "{:?}", idles());
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!((FAILING.load(Ordering::SeqCst), idles()), (0, [0, 1]));
        let frame = renderer.render(&view, &settings).expect("a frame");
        assert!(frame.color == owned(&gaussians, &view, &settings).color);
    });
}
