//! A queue for copies only, on devices with such a queue family: uploads run beside the main queue's work.
//!
//! Each of the two queues counts its submissions in a timeline semaphore. A copy that must not overtake the main queue's
//! work waits for that count. The main queue waits for the copy queue's count to acquire the copied data.

use super::error::vk_error;
use super::queue_lock::LockedQueue;
use super::raw_device::RawDevice;
use crate::Result;
use ash::vk;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Semaphore that counts the submissions to a queue.
pub(super) struct Timeline {
    pub(super) semaphore: vk::Semaphore,
    /// Submissions so far. Changed only under the queue's lock.
    count: AtomicU64,
}

/// A value of a semaphore that a submission waits for.
#[derive(Clone, Copy)]
pub(super) struct Point {
    pub(super) semaphore: vk::Semaphore,
    pub(super) value: u64,
}

impl Timeline {
    fn new(device: &RawDevice) -> Result<Self> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: valid create info; timelineSemaphore is on in devices with a queue for copies.
        let semaphore = unsafe { device.create_semaphore(&info, None) };
        Ok(Self { semaphore: semaphore.map_err(vk_error("vkCreateSemaphore"))?, count: AtomicU64::new(0) })
    }

    /// Returns the point after all submissions so far.
    pub(super) fn last(&self) -> Point {
        Point { semaphore: self.semaphore, value: self.count.load(Ordering::Acquire) }
    }

    /// Returns the point that the next submission signals.
    pub(super) fn next(&self) -> Point {
        let last = self.last();
        Point { value: last.value + 1, ..last }
    }

    /// Counts a submission that was made.
    pub(super) fn submitted(&self, point: Point) {
        self.count.store(point.value, Ordering::Release);
    }
}

/// The copy queue, with the timelines of both queues.
pub(super) struct CopyQueue {
    queue: Mutex<vk::Queue>,
    pub(super) family: u32,
    /// Timeline of the main queue.
    pub(super) worked: Timeline,
    /// Timeline of this queue.
    pub(super) copied: Timeline,
}

impl CopyQueue {
    /// # Errors
    /// When the driver has no memory left.
    pub(super) fn new(device: &RawDevice, family: u32) -> Result<Self> {
        // SAFETY: the device was created with one queue of this family.
        let queue = unsafe { device.get_device_queue(family, 0) };
        let worked = Timeline::new(device)?;
        let copied = Timeline::new(device).inspect_err(|_| {
            // SAFETY: it was made just now, and is not in use.
            unsafe { device.destroy_semaphore(worked.semaphore, None) }
        })?;
        Ok(Self { queue: Mutex::new(queue), family, worked, copied })
    }

    /// Locks the queue for this thread.
    pub(super) fn lock(&self) -> LockedQueue<'_> {
        LockedQueue::new(self.queue.lock().unwrap_or_else(PoisonError::into_inner), None)
    }

    /// Destroys the semaphores of an idle device.
    pub(super) fn close(&self, device: &ash::Device) {
        // SAFETY: whoever closes has waited for both queues.
        unsafe {
            device.destroy_semaphore(self.worked.semaphore, None);
            device.destroy_semaphore(self.copied.semaphore, None);
        }
    }
}
