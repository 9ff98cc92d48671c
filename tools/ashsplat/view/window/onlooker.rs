//! Events of a tree of tiles, passed from its reading thread to the window.

use super::super::streamed::Onlooker;
use std::sync::{Mutex, PoisonError};
use winit::event_loop::EventLoopProxy;

/// Wakes the window's loop, and keeps the latest message for it.
pub struct Bell {
    wake: Mutex<EventLoopProxy<()>>,
    said: Mutex<Option<String>>,
}

impl Bell {
    pub fn new(wake: EventLoopProxy<()>) -> Bell {
        Bell { wake: Mutex::new(wake), said: Mutex::default() }
    }

    /// Takes the latest message, if any.
    pub fn said(&self) -> Option<String> {
        self.said.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Onlooker for Bell {
    fn renew(&self) {
        // A loop that has ended needs no waking.
        self.wake.lock().unwrap_or_else(PoisonError::into_inner).send_event(()).ok();
    }

    fn tell(&self, problem: &str) {
        *self.said.lock().unwrap_or_else(PoisonError::into_inner) = Some(problem.to_owned());
        self.renew();
    }
}
