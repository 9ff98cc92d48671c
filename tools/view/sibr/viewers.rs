//! The viewers that speak the protocol, and whether they let training continue.

use ashsplat_program::session::locked;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;

/// Most viewers at once. For one more, the longest silent viewer goes.
const MOST: usize = 4;

/// Requests of the connected viewers about the training.
#[derive(Debug, Default)]
pub struct Wishes {
    viewers: Mutex<Vec<Arc<Viewer>>>,
}

#[derive(Debug)]
pub struct Viewer {
    stream: TcpStream,
    said: Mutex<Said>,
}

#[derive(Clone, Copy, Debug)]
struct Said {
    /// Time of its last message or answer.
    at: Instant,
    /// True if it waits for an answer.
    waits: bool,
    /// True if training may continue.
    train: bool,
    keep_alive: bool,
}

impl Wishes {
    fn lock(&self) -> MutexGuard<'_, Vec<Arc<Viewer>>> {
        locked(&self.viewers)
    }

    /// True if training may continue. A viewer that has sent nothing yet does not pause it.
    pub fn may_train(&self) -> bool {
        self.lock().iter().all(|viewer| viewer.said().train)
    }

    /// True if a viewer wants to keep looking after training ends.
    pub fn wants_to_stay(&self) -> bool {
        self.lock().iter().any(|viewer| viewer.said().keep_alive)
    }

    /// Adds a viewer; none if all others are being answered.
    pub fn admit(&self, stream: TcpStream) -> Option<Arc<Viewer>> {
        let mut viewers = self.lock();
        if viewers.len() >= MOST {
            let silent = viewers.iter().enumerate().filter(|(_, viewer)| !viewer.said().waits);
            let (longest, _) = silent.min_by_key(|(_, viewer)| viewer.said().at)?;
            viewers.remove(longest).stream.shutdown(Shutdown::Both).ok();
        }
        let said = Said { at: Instant::now(), waits: false, train: true, keep_alive: false };
        let viewer = Arc::new(Viewer { stream, said: Mutex::new(said) });
        viewers.push(viewer.clone());
        Some(viewer)
    }

    /// Removes a viewer.
    pub fn leave(&self, viewer: &Arc<Viewer>) {
        self.lock().retain(|other| !Arc::ptr_eq(other, viewer));
    }
}

impl Viewer {
    pub fn stream(&self) -> &TcpStream {
        &self.stream
    }

    fn said(&self) -> Said {
        *locked(&self.said)
    }

    /// Records a message that waits for an answer.
    pub fn speaks(&self, train: bool, keep_alive: bool) {
        *locked(&self.said) = Said { at: Instant::now(), waits: true, train, keep_alive };
    }

    /// Records that the answer was sent.
    pub fn is_answered(&self) {
        let mut said = locked(&self.said);
        (said.at, said.waits) = (Instant::now(), false);
    }
}
