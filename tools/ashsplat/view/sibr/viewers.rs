//! The viewers that speak the protocol, and what they want of the training.

use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Viewers that are served at once. For one more, the one that has been silent for longest goes.
const MOST: usize = 4;

/// What the viewers want of the training.
#[derive(Debug, Default)]
pub struct Wishes {
    viewers: Mutex<Vec<Arc<Viewer>>>,
}

/// A connection.
#[derive(Debug)]
pub struct Viewer {
    stream: TcpStream,
    said: Mutex<Said>,
}

#[derive(Clone, Copy, Debug)]
struct Said {
    /// When it spoke, or was answered, last.
    at: Instant,
    /// Whether it waits for an answer.
    waits: bool,
    /// Whether training may go on.
    train: bool,
    keep_alive: bool,
}

impl Wishes {
    fn lock(&self) -> MutexGuard<'_, Vec<Arc<Viewer>>> {
        // A panic of another thread leaves nothing half-done here.
        self.viewers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether training may go on. One that has said nothing yet does not mind.
    pub fn may_train(&self) -> bool {
        self.lock().iter().all(|viewer| viewer.said().train)
    }

    /// Whether one wants to look on when training is over.
    pub fn wants_to_stay(&self) -> bool {
        self.lock().iter().any(|viewer| viewer.said().keep_alive)
    }

    /// A viewer has come; none where all the others are being answered.
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

    /// A viewer has gone.
    pub fn leave(&self, viewer: &Arc<Viewer>) {
        self.lock().retain(|other| !Arc::ptr_eq(other, viewer));
    }
}

impl Viewer {
    pub fn stream(&self) -> &TcpStream {
        &self.stream
    }

    fn lock(&self) -> MutexGuard<'_, Said> {
        self.said.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn said(&self) -> Said {
        *self.lock()
    }

    /// It has said what it wants, and waits for an answer.
    pub fn speaks(&self, train: bool, keep_alive: bool) {
        *self.lock() = Said { at: Instant::now(), waits: true, train, keep_alive };
    }

    /// It has its answer.
    pub fn is_answered(&self) {
        let mut said = self.lock();
        (said.at, said.waits) = (Instant::now(), false);
    }
}
