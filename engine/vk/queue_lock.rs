//! A queue locked for one thread, together with a host's lock of it.

use super::open_device::Device;
use crate::{Error, Result};
use ash::vk;
use std::ops::Deref;
use std::sync::{MutexGuard, PoisonError};

/// A host's lock of the queue that it gives to a context, for hosts whose other threads submit to that queue: see
/// [`super::ForeignDevice::queue_lock`].
///
/// Operations that submit take it around each `vkQueueSubmit2`, and around a `vkQueueWaitIdle` after a wait has failed.
/// They do not hold it while waiting for the device, and recording never takes it. A thread that holds it must not call
/// anything that submits: it would deadlock.
///
/// # Safety
/// From the return of [`QueueLock::lock`] to the call of [`QueueLock::unlock`], on the same thread, nobody else uses the queue.
pub unsafe trait QueueLock: Send + Sync {
    /// Waits for the lock and takes it.
    fn lock(&self);

    /// Releases the lock.
    fn unlock(&self);
}

/// A queue, locked for this thread.
pub(super) struct LockedQueue<'a> {
    queue: MutexGuard<'a, vk::Queue>,
    host: Option<&'a dyn QueueLock>,
}

impl<'a> LockedQueue<'a> {
    /// Takes the host's lock after our own, so that our threads wait for each other without holding it.
    pub(super) fn new(queue: MutexGuard<'a, vk::Queue>, host: Option<&'a dyn QueueLock>) -> Self {
        if let Some(host) = host {
            host.lock();
        }
        Self { queue, host }
    }
}

impl Deref for LockedQueue<'_> {
    type Target = vk::Queue;

    fn deref(&self) -> &vk::Queue {
        &self.queue
    }
}

impl Drop for LockedQueue<'_> {
    fn drop(&mut self) {
        if let Some(host) = self.host {
            host.unlock();
        }
    }
}

impl Device {
    /// Locks the queue for this thread.
    pub(super) fn lock_queue(&self) -> Result<LockedQueue<'_>> {
        let Some(queue) = &self.queue else {
            let problem = "the host keeps its queue: only recording into its command buffers is possible";
            return Err(Error::argument("queue", problem));
        };
        let queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(LockedQueue::new(queue, self.queue_lock.as_deref()))
    }
}
