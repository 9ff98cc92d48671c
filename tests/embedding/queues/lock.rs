//! A host's lock around a queue that its other threads submit to.

use super::SIZE;
use crate::host::Host;
use crate::stage::{camera, cloud, device_with, options, owned, rendered, with_host};
use ashsplat::ash::{self, vk};
use ashsplat::vk::{Context, ContextOptions, ForeignDevice, QueueLock};
use ashsplat::{Placed, RecordedFrame, RenderSettings, Renderer, Reservation};
use std::ffi::{CStr, c_void};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};

/// A host's lock: a flag that a thread holds.
#[derive(Default)]
struct Gate {
    held: Mutex<bool>,
    free: Condvar,
    taken: AtomicU32,
}

// SAFETY: the threads of the test use the queue between both calls alone.
unsafe impl QueueLock for Gate {
    fn lock(&self) {
        let mut held = self.held.lock().expect("no panic while held");
        while *held {
            held = self.free.wait(held).expect("no panic while held");
        }
        *held = true;
        assert!(!IN_USE.swap(true, Ordering::SeqCst), "two threads have the queue");
        self.taken.fetch_add(1, Ordering::SeqCst);
    }

    fn unlock(&self) {
        assert!(IN_USE.swap(false, Ordering::SeqCst), "nobody has the queue");
        *self.held.lock().expect("no panic while held") = false;
        self.free.notify_one();
    }
}

/// The device's vkQueueSubmit2, and the numbers of calls without and with the lock held.
static SUBMIT: AtomicUsize = AtomicUsize::new(0);
static SUBMITTED: [AtomicU32; 2] = [AtomicU32::new(0), AtomicU32::new(0)];
static IN_USE: AtomicBool = AtomicBool::new(false);

unsafe extern "system" fn submit(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo2<'_>,
    fence: vk::Fence,
) -> vk::Result {
    SUBMITTED[usize::from(IN_USE.load(Ordering::SeqCst))].fetch_add(1, Ordering::SeqCst);
    // SAFETY: the address is that of the device's function.
    unsafe {
        let real: vk::PFN_vkQueueSubmit2 = std::mem::transmute(SUBMIT.load(Ordering::SeqCst));
        real(queue, count, submits, fence)
    }
}

/// The host's device with wrapped submissions.
fn watched(host: &Host) -> ash::Device {
    let replace = |name: &CStr, address: *const c_void| {
        if name != c"vkQueueSubmit2" {
            return address;
        }
        SUBMIT.store(address as usize, Ordering::SeqCst);
        submit as *const c_void
    };
    // SAFETY: every address is null, the device's own function, or a wrapper of its type.
    unsafe { device_with(host, replace) }
}

/// Ends the host's thread even if the test fails.
struct Stop<'a>(&'a AtomicBool);

impl Drop for Stop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// All of the guest's submissions hold the lock, while a thread of the host submits as well.
#[test]
fn a_hosts_lock_is_taken_around_submissions() {
    with_host(&options(), |host| {
        let gate = Arc::new(Gate::default());
        let device = watched(host);
        let foreign = ForeignDevice { device: &device, queue_lock: Some(gate.clone()), ..host.foreign() };
        // SAFETY: as in `guest`; the host's thread below takes the lock.
        let context =
            unsafe { Context::from_foreign(&foreign, &ContextOptions::default()) }.expect("a context");
        let (gaussians, settings) = (cloud(100, 3), RenderSettings::default());
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.upload(&gaussians).expect("a scene");
        renderer.reserve(&Reservation::new(100, 1, SIZE[0], SIZE[1])).expect("memory");
        let scene = renderer.scene().expect("uploaded");
        renderer.render(&view, &settings).expect("a frame");
        let of_frame = gate.taken.load(Ordering::SeqCst);
        renderer.render(&view, &settings).expect("a frame");
        let of_frame = gate.taken.load(Ordering::SeqCst) - of_frame;
        assert!(of_frame >= 1, "the lock is taken");
        // Recording takes no lock.
        let placed = [Placed::from(&scene)];
        let before = gate.taken.load(Ordering::SeqCst);
        rendered(host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
        assert_eq!(gate.taken.load(Ordering::SeqCst), before);
        let expected = owned(&gaussians, &view, &settings);
        let (stop, hosts) = (AtomicBool::new(false), AtomicU32::new(0));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !stop.load(Ordering::SeqCst) {
                    gate.lock();
                    // SAFETY: the lock gives the queue to this thread.
                    unsafe { host.device.queue_submit2(host.queue, &[], vk::Fence::null()) }
                        .expect("submitted");
                    hosts.fetch_add(1, Ordering::SeqCst);
                    gate.unlock();
                    std::thread::yield_now();
                }
            });
            let _stop = Stop(&stop);
            for _ in 0..3 {
                let frame = renderer.render(&view, &settings).expect("a frame");
                assert!(frame.color == expected.color);
            }
        });
        let taken = gate.taken.load(Ordering::SeqCst) - before - hosts.load(Ordering::SeqCst);
        assert_eq!(taken, 3 * of_frame);
        let [outside, within] = SUBMITTED.each_ref().map(|count| count.load(Ordering::SeqCst));
        assert!(outside == 0 && within >= 3, "{outside} submissions without the lock, {within} within");
    });
}
