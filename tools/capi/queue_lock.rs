//! A host's own lock for its queue, in C.

use super::AshsplatForeignDevice;
use ashsplat::vk::QueueLock;
use ashsplat::{Error, Result};
use std::ffi::c_void;

type Call = unsafe extern "C" fn(user: *mut c_void);

pub(super) struct Lock {
    user: *mut c_void,
    lock: Call,
    unlock: Call,
}

// SAFETY: the host promises that its functions may be called from any thread.
unsafe impl Send for Lock {}
// SAFETY: as above.
unsafe impl Sync for Lock {}

impl Lock {
    /// The host's lock, if it has one.
    pub fn of(host: &AshsplatForeignDevice) -> Result<Option<Self>> {
        match (host.lock_queue, host.unlock_queue) {
            (Some(lock), Some(unlock)) => Ok(Some(Self { user: host.queue_user, lock, unlock })),
            (None, None) => Ok(None),
            (Some(_), None) => Err(Error::argument("unlock_queue", "is NULL, and lock_queue is not")),
            (None, Some(_)) => Err(Error::argument("lock_queue", "is NULL, and unlock_queue is not")),
        }
    }
}

// SAFETY: the host promises exclusive use of the queue between the two calls.
unsafe impl QueueLock for Lock {
    fn lock(&self) {
        // SAFETY: as promised.
        unsafe { (self.lock)(self.user) }
    }

    fn unlock(&self) {
        // SAFETY: as promised.
        unsafe { (self.unlock)(self.user) }
    }
}
