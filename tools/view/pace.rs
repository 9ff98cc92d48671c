//! Limits how fast a page may talk: a bucket of tokens, which messages empty and time fills.

use std::time::{Duration, Instant};

/// Tokens added per second. A page sends its camera once per screen refresh, at most 240 times a second, and confirms each frame.
const PER_SECOND: f64 = 600.0;
/// Most tokens, which a silent page has.
const MAX_TOKENS: f64 = 1200.0;
/// Bytes, received or sent, that cost as much as one message.
const BYTES: f64 = 1024.0;

pub struct Pace {
    tokens: f64,
    at: Instant,
}

impl Pace {
    pub fn new() -> Pace {
        Pace { tokens: MAX_TOKENS, at: Instant::now() }
    }

    /// Takes the price of a message of this many bytes.
    pub fn spend(&mut self, bytes: usize) {
        self.tokens -= 1.0 + bytes as f64 / BYTES;
    }

    /// Time until the next message may come.
    pub fn wait(&mut self) -> Duration {
        let now = Instant::now();
        let seconds = now.saturating_duration_since(self.at).as_secs_f64();
        self.tokens = MAX_TOKENS.min(self.tokens + PER_SECOND * seconds);
        self.at = now;
        Duration::from_secs_f64((-self.tokens).max(0.0) / PER_SECOND)
    }
}
