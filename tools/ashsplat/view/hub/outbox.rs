//! What waits to be sent to one page: of pictures only the newest, of words a bounded number.

use crate::view::protocol::ToPage;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Words that may wait. A page that lets more come together does not read, and is given up.
const MOST_WORDS: usize = 256;
/// Bytes of them, beside the first: a greeting lists all cameras.
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
        // A panic of another thread leaves nothing half-done here.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a message. An older picture that still waits goes.
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

    /// Words that wait.
    pub fn words(&self) -> usize {
        self.lock().words.len()
    }

    /// The next message, when there is one; none when the page is given up. Cancelling it loses nothing.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn now(outbox: &Outbox) -> Option<ToPage> {
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        runtime.block_on(outbox.take())
    }

    #[test]
    fn only_the_newest_picture_waits() {
        let outbox = Outbox::default();
        (0..100).for_each(|number| outbox.put(ToPage::Binary(vec![number; 1000])));
        outbox.put(ToPage::Text("words".into()));
        assert!(matches!(now(&outbox), Some(ToPage::Text(text)) if text == "words"));
        assert!(matches!(now(&outbox), Some(ToPage::Binary(bytes)) if bytes == [99; 1000]));
        assert!(outbox.lock().picture.is_none() && outbox.words() == 0);
    }

    #[test]
    fn a_page_that_does_not_read_is_given_up() {
        let outbox = Outbox::default();
        (0..MOST_WORDS).for_each(|_| outbox.put(ToPage::Text("words".into())));
        assert!(outbox.words() == MOST_WORDS && !outbox.lock().given_up);
        (0..10 * MOST_WORDS).for_each(|_| outbox.put(ToPage::Text("words".into())));
        assert!(now(&outbox).is_none() && outbox.words() == 0);
        // A long greeting is no reason; more of its kind are.
        let outbox = Outbox::default();
        (0..2).for_each(|_| outbox.put(ToPage::Text("w".repeat(MOST_BYTES))));
        assert!(now(&outbox).is_none());
    }
}
