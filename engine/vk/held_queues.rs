//! Holds the queues of a context, for a host that submits beside it.

use super::context::Context;
use super::open_device::LockedQueue;
use crate::Result;

/// Locked queues of a context, owned by the holding thread: [`Context::hold_queues`].
pub struct HeldQueues<'a> {
    _main: LockedQueue<'a>,
    _copies: Option<LockedQueue<'a>>,
}

impl Context {
    /// Locks the queues of a context of our own until the result is dropped. The host can then submit, present or wait for
    /// the whole device, while the program's other threads, which upload or render, wait. The holder must not call anything
    /// that submits: it would deadlock.
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) if a host keeps its queue.
    pub fn hold_queues(&self) -> Result<HeldQueues<'_>> {
        // Only this function takes both locks, so their order cannot deadlock.
        let main = self.device.lock_queue()?;
        Ok(HeldQueues { _main: main, _copies: self.device.copying.as_ref().map(|copies| copies.lock()) })
    }
}
