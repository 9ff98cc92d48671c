//! Messages that wait to be sent to one page: only the newest picture, and a bounded number of texts.

use crate::protocol::ToPage;
use ashsplat_program::session::locked;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard};
use tokio::sync::Notify;

/// Most waiting texts. A page that lets more pile up does not read, and is given up.
const MOST_WORDS: usize = 256;
/// Most bytes of waiting texts, unless the first is longer: a greeting lists all cameras.
const MOST_BYTES: usize = 8 << 20;

/// See the module.
#[derive(Default)]
pub struct Outbox {
    waiting: Mutex<Waiting>,
    news: Notify,
}

#[derive(Default)]
struct Waiting {
    words: VecDeque<String>,
    picture: Option<Vec<u8>>,
    given_up: bool,
}

impl Waiting {
    fn is_full(&self) -> bool {
        let bytes = self.words.iter().map(String::len).sum::<usize>();
        self.words.len() >= MOST_WORDS || !self.words.is_empty() && bytes >= MOST_BYTES
    }
}

impl Outbox {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        locked(&self.waiting)
    }

    /// Adds a message. A new picture replaces a waiting one.
    pub fn put(&self, message: ToPage) {
        let mut waiting = self.lock();
        match message {
            _ if waiting.given_up => return,
            ToPage::Binary(picture) => waiting.picture = Some(picture),
            ToPage::Text(_) if waiting.is_full() => {
                *waiting = Waiting { given_up: true, ..Waiting::default() };
            }
            ToPage::Text(text) => waiting.words.push_back(text),
        }
        drop(waiting);
        self.news.notify_one();
    }

    /// Number of waiting texts.
    pub fn words(&self) -> usize {
        self.lock().words.len()
    }

    /// Waits for the next message; none if the page is given up. Cancelling it loses nothing.
    pub async fn take(&self) -> Option<ToPage> {
        loop {
            {
                let mut waiting = self.lock();
                if waiting.given_up {
                    return None;
                }
                let text = waiting.words.pop_front().map(ToPage::Text);
                let next = text.or_else(|| waiting.picture.take().map(ToPage::Binary));
                if next.is_some() {
                    return next;
                }
            }
            self.news.notified().await;
        }
    }
}
