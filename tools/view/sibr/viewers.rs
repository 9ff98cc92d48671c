//! The viewers that speak the protocol, and whether they let training continue.

use ashsplat_program::session::locked;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Most viewers at once. For one more, the longest silent viewer goes.
const MOST: usize = 4;

/// The connected viewers.
#[derive(Debug, Default)]
pub struct Wishes(Mutex<Vec<Viewer>>);

#[derive(Debug)]
struct Viewer {
    stream: Arc<TcpStream>,
    /// Time of its last message or answer.
    at: Instant,
    /// True if it waits for an answer.
    waits: bool,
    /// True if training may continue.
    train: bool,
    keep_alive: bool,
}

impl Wishes {
    /// True if training may continue. A viewer that has sent nothing yet does not pause it.
    pub fn may_train(&self) -> bool {
        locked(&self.0).iter().all(|viewer| viewer.train)
    }

    /// True if a viewer wants to keep looking after training ends.
    pub fn wants_to_stay(&self) -> bool {
        locked(&self.0).iter().any(|viewer| viewer.keep_alive)
    }

    /// Adds a viewer; false if all others are being answered.
    pub fn admit(&self, stream: &Arc<TcpStream>) -> bool {
        let mut viewers = locked(&self.0);
        if viewers.len() >= MOST {
            let silent = viewers.iter().enumerate().filter(|(_, viewer)| !viewer.waits);
            let Some((longest, _)) = silent.min_by_key(|(_, viewer)| viewer.at) else { return false };
            viewers.remove(longest).stream.shutdown(Shutdown::Both).ok();
        }
        let (stream, at) = (stream.clone(), Instant::now());
        viewers.push(Viewer { stream, at, waits: false, train: true, keep_alive: false });
        true
    }

    /// Removes a viewer.
    pub fn leave(&self, stream: &Arc<TcpStream>) {
        locked(&self.0).retain(|viewer| !Arc::ptr_eq(&viewer.stream, stream));
    }

    /// Records a message that waits for an answer.
    pub fn speaks(&self, stream: &Arc<TcpStream>, train: bool, keep_alive: bool) {
        self.note(stream, |viewer| {
            (viewer.waits, viewer.train, viewer.keep_alive) = (true, train, keep_alive);
        });
    }

    /// Records that the answer was sent.
    pub fn is_answered(&self, stream: &Arc<TcpStream>) {
        self.note(stream, |viewer| viewer.waits = false);
    }

    fn note(&self, stream: &Arc<TcpStream>, change: impl FnOnce(&mut Viewer)) {
        let mut viewers = locked(&self.0);
        if let Some(viewer) = viewers.iter_mut().find(|viewer| Arc::ptr_eq(&viewer.stream, stream)) {
            viewer.at = Instant::now();
            change(viewer);
        }
    }
}
