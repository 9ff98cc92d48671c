//! Limits how fast a page may talk: a bucket of tokens, which messages empty and time fills.

use std::time::{Duration, Instant};

/// Tokens added per second. A page sends its camera once per screen refresh, at most 240 times a second, and confirms each frame.
const PER_SECOND: f64 = 600.0;
/// Most tokens, which a silent page has.
const MOST: f64 = 1200.0;
/// Bytes, received or sent, that cost as much as one message.
const BYTES: f64 = 1024.0;

pub struct Pace {
    tokens: f64,
    at: Instant,
}

impl Pace {
    pub fn new() -> Pace {
        Pace { tokens: MOST, at: Instant::now() }
    }

    /// Takes the price of a message of this many bytes.
    pub fn spend(&mut self, bytes: usize) {
        self.tokens -= 1.0 + bytes as f64 / BYTES;
    }

    /// Time until the next message may come.
    pub fn wait(&mut self) -> Duration {
        self.wait_at(Instant::now())
    }

    fn wait_at(&mut self, now: Instant) -> Duration {
        let seconds = now.saturating_duration_since(self.at).as_secs_f64();
        self.tokens = MOST.min(self.tokens + PER_SECOND * seconds);
        self.at = now;
        Duration::from_secs_f64((-self.tokens).max(0.0) / PER_SECOND)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_has_to_wait() {
        let mut pace = Pace::new();
        let start = pace.at;
        let flood = |pace: &mut Pace, now: Instant| {
            let sent = (0..100_000).take_while(|_| {
                let may = pace.wait_at(now).is_zero();
                if may {
                    pace.spend(0);
                }
                may
            });
            sent.count()
        };
        let first = flood(&mut pace, start);
        assert!((1200..=1202).contains(&first), "{first}");
        let second = flood(&mut pace, start + Duration::from_secs(1));
        assert!((598..=602).contains(&second), "{second}");
        // Long messages cost more.
        let mut pace = Pace::new();
        pace.spend(256 * 1024);
        assert!(pace.wait_at(pace.at).is_zero());
        (0..9).for_each(|_| pace.spend(256 * 1024));
        assert!(pace.wait_at(pace.at) > Duration::from_secs(2));
    }
}
