//! Messages that wait to be sent to one page: only the newest picture, and a bounded number of texts.

use crate::protocol::ToPage;
use ashsplat_program::session::locked;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard};
use tokio::sync::Notify;

/// Most waiting texts. A page that lets more pile up does not read, and is given up.
const MAX_TEXTS: usize = 256;
/// Most bytes of waiting texts, unless the first is longer: a greeting lists all cameras.
const MAX_BYTES: usize = 8 << 20;

#[derive(Default)]
pub struct Outbox {
    waiting: Mutex<WaitingMessages>,
    changed: Notify,
}

#[derive(Default)]
struct WaitingMessages {
    texts: VecDeque<String>,
    picture: Option<Vec<u8>>,
    given_up: bool,
}

impl WaitingMessages {
    fn is_full(&self) -> bool {
        let bytes = self.texts.iter().map(String::len).sum::<usize>();
        self.texts.len() >= MAX_TEXTS || !self.texts.is_empty() && bytes >= MAX_BYTES
    }
}

impl Outbox {
    fn lock(&self) -> MutexGuard<'_, WaitingMessages> {
        locked(&self.waiting)
    }

    /// Adds a message. A new picture replaces a waiting one.
    pub fn put(&self, message: ToPage) {
        let mut waiting = self.lock();
        match message {
            _ if waiting.given_up => return,
            ToPage::Binary(picture) => waiting.picture = Some(picture),
            ToPage::Text(_) if waiting.is_full() => {
                *waiting = WaitingMessages { given_up: true, ..WaitingMessages::default() };
            }
            ToPage::Text(text) => waiting.texts.push_back(text),
        }
        drop(waiting);
        self.changed.notify_one();
    }

    pub fn texts(&self) -> usize {
        self.lock().texts.len()
    }

    /// Waits for the next message; none if the page is given up. Cancelling it loses nothing.
    pub async fn take(&self) -> Option<ToPage> {
        loop {
            {
                let mut waiting = self.lock();
                if waiting.given_up {
                    return None;
                }
                let text = waiting.texts.pop_front().map(ToPage::Text);
                let next = text.or_else(|| waiting.picture.take().map(ToPage::Binary));
                if next.is_some() {
                    return next;
                }
            }
            self.changed.notified().await;
        }
    }
}
