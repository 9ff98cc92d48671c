//! A host's lock around a queue: other threads submit to it, and a wait fails.

use super::SIZE;
use crate::stage::*;
use ashsplat::vk::QueueLock;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// A host's lock: a flag that a thread holds.
#[derive(Default)]
struct Lock {
    held: Mutex<bool>,
    free: Condvar,
    taken: AtomicU32,
}

// SAFETY: the threads of the test use the queue between both calls alone.
unsafe impl QueueLock for Lock {
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

static IN_USE: AtomicBool = AtomicBool::new(false);
/// Calls of vkQueueSubmit2 without and with the lock held.
static SUBMITTED: [AtomicU32; 2] = [AtomicU32::new(0), AtomicU32::new(0)];

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
        let gate = Arc::new(Lock::default());
        let context = guest_with(host, gate.clone(), &[c"vkQueueSubmit2"]);
        let gaussians = cloud(100, 3);
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.upload(&gaussians).expect("a scene");
        renderer.reserve(&Reservation::new(100, 1, SIZE[0], SIZE[1])).expect("memory");
        let scene = renderer.scene().expect("uploaded");
        renderer.render(&view, &SETTINGS).expect("a frame");
        let of_frame = gate.taken.load(Ordering::SeqCst);
        renderer.render(&view, &SETTINGS).expect("a frame");
        let of_frame = gate.taken.load(Ordering::SeqCst) - of_frame;
        assert!(of_frame >= 1, "the lock is taken");
        // Recording takes no lock.
        let placed = [Placed::from(&scene)];
        let before = gate.taken.load(Ordering::SeqCst);
        rendered(host, &mut renderer, &frame_of(&placed, &view));
        assert_eq!(gate.taken.load(Ordering::SeqCst), before);
        let expected = owned(&gaussians, &view, &SETTINGS);
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
                let frame = renderer.render(&view, &SETTINGS).expect("a frame");
                assert!(frame.color == expected.color);
            }
        });
        let taken = gate.taken.load(Ordering::SeqCst) - before - hosts.load(Ordering::SeqCst);
        assert_eq!(taken, 3 * of_frame);
        let [outside, within] = SUBMITTED.each_ref().map(|count| count.load(Ordering::SeqCst));
        assert!(outside == 0 && within >= 3, "{outside} submissions without the lock, {within} within");
    });
}

/// A host's lock that threads spin for.
struct Spin;

static HELD: AtomicBool = AtomicBool::new(false);

// SAFETY: one thread at a time has set the flag.
unsafe impl QueueLock for Spin {
    fn lock(&self) {
        while HELD.swap(true, Ordering::SeqCst) {
            std::thread::yield_now();
        }
    }

    fn unlock(&self) {
        assert!(HELD.swap(false, Ordering::SeqCst), "not held");
    }
}

/// The number of the next calls of vkWaitForFences that fail.
static FAILING: AtomicU32 = AtomicU32::new(0);
/// Calls of vkQueueWaitIdle without the lock, and with it.
static IDLES: [AtomicU32; 2] = [AtomicU32::new(0), AtomicU32::new(0)];

fn note(name: &str) {
    let (calls, held) = match name {
        "vkQueueSubmit2" => (&SUBMITTED, &IN_USE),
        "vkQueueWaitIdle" => (&IDLES, &HELD),
        _ => return,
    };
    calls[usize::from(held.load(Ordering::SeqCst))].fetch_add(1, Ordering::SeqCst);
}

wrappers! {
    note;
    "vkQueueSubmit2" submit(q: vk::Queue, n: u32, s: *const c_void, f: vk::Fence) -> vk::Result;
    "vkQueueWaitIdle" idle(q: vk::Queue) -> vk::Result;
    "vkWaitForFences" wait(d: vk::Device, n: u32, f: *const c_void, a: u32, t: u64) -> vk::Result, {
        let fewer = |failing: u32| failing.checked_sub(1);
        if FAILING.fetch_update(Ordering::SeqCst, Ordering::SeqCst, fewer).is_ok() {
            return vk::Result::ERROR_OUT_OF_HOST_MEMORY;
        }
    };
}

/// A guest with a lock and wrappers of these functions.
fn guest_with(host: &Host, lock: Arc<dyn QueueLock>, names: &[&CStr]) -> Context {
    let replace = |name: &CStr, own| match names.contains(&name) {
        true => wrapped(name, own).expect("it has a wrapper"),
        false => own,
    };
    // SAFETY: every address is null, the device's own function, or a wrapper of its type.
    let device = unsafe { device_with(host, replace) };
    let foreign = ForeignDevice { device: &device, queue_lock: Some(lock), ..host.foreign() };
    guest_of(&foreign, &ContextOptions::default())
}

/// A thread of the guest waits for the queue instead of the fence, and holds the lock meanwhile.
#[test]
fn a_wait_that_fails_is_made_up_for_within_a_hosts_lock() {
    with_host(&options(), |host| {
        let context = guest_with(host, Arc::new(Spin), &[c"vkWaitForFences", c"vkQueueWaitIdle"]);
        let gaussians = cloud(100, 3);
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.upload(&gaussians).expect("a scene");
        let idles = || IDLES.each_ref().map(|count| count.load(Ordering::SeqCst));
        assert_eq!(idles(), [0, 0], "a wait that succeeds is enough");
        // The first wait, and the one that would make sure that nothing runs.
        FAILING.store(2, Ordering::SeqCst);
        let error = renderer.render(&view, &SETTINGS).map(drop).expect_err("the wait failed").to_string();
        assert!(error.contains("vkWaitForFences") && error.contains("OUT_OF_HOST_MEMORY"), "{error}");
        // Nobody else submits, so that thread holds the flag.
        let start = Instant::now();
        while idles() == [0, 0] || HELD.load(Ordering::SeqCst) {
            assert!(start.elapsed() < Duration::from_secs(60), "{:?}", idles());
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!((FAILING.load(Ordering::SeqCst), idles()), (0, [0, 1]));
        let frame = renderer.render(&view, &SETTINGS).expect("a frame");
        assert!(frame.color == owned(&gaussians, &view, &SETTINGS).color);
    });
}
