//! The queues of a context, held for a host that submits beside it.

use super::context::Context;
use super::queue_lock::LockedQueue;
use crate::Result;

/// The queues of a context, for the thread that holds them: [`Context::hold_queues`].
pub struct HeldQueues<'a> {
    _main: LockedQueue<'a>,
    _copies: Option<LockedQueue<'a>>,
}

impl Context {
    /// Holds the queues of a context of our own until the answer is dropped: a host that submits to them, presents, or waits for the
    /// whole device has them for itself, while the program's other threads upload or render. They wait meanwhile. Whoever holds them
    /// must not call what submits: it would wait for itself.
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) where a host keeps its queue.
    pub fn hold_queues(&self) -> Result<HeldQueues<'_>> {
        // Nobody takes one of them while holding the other, but here.
        let main = self.device.lock_queue()?;
        Ok(HeldQueues { _main: main, _copies: self.device.copying.as_ref().map(|copies| copies.lock()) })
    }
}
