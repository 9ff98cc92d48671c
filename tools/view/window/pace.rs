//! Decides when to draw a frame, and how coarse: coarse while the view moves, sharp when it rests. `web/frames.js` does the same.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Smallest side of a coarse frame, pixels.
const MIN_SIDE: f64 = 16.0;
/// Frame time to reach while the view moves, ms.
const GOAL: f64 = 55.0;
/// Sides of coarse frames, as shares of the window's.
const SCALES: [f64; 6] = [1.0, 0.75, 0.5, 0.375, 0.25, 0.1875];
/// The view rests after this time without a change.
const REST: Duration = Duration::from_millis(140);
/// Limits of the frames that the frame rate is averaged over.
const RATE_TIME: Duration = Duration::from_secs(2);
const RATE_FRAMES: usize = 40;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NextFrame {
    Nothing,
    /// The view moves: draw at this share of the window's size.
    Moving(f64),
    /// The view rests.
    Still,
}

impl NextFrame {
    /// Sides of the frame in a window of this size, pixels.
    pub fn sides(self, window: [u32; 2]) -> [u32; 2] {
        let share = if let NextFrame::Moving(share) = self { share } else { 1.0 };
        window.map(f64::from).map(|side| (side * share).round().max(MIN_SIDE).min(side) as u32)
    }
}

pub struct Pace {
    level: usize,
    changed: Option<Instant>,
    dirty: bool,
    sharp: bool,
    shown: VecDeque<Instant>,
}

impl Pace {
    pub fn new() -> Pace {
        Pace { level: 0, changed: None, dirty: false, sharp: false, shown: VecDeque::new() }
    }

    pub fn touch(&mut self, now: Instant) {
        (self.dirty, self.sharp, self.changed) = (true, false, Some(now));
    }

    /// Records a jump rather than a gradual change: the next frame is sharp.
    pub fn leap(&mut self) {
        (self.dirty, self.sharp, self.changed) = (false, false, None);
    }

    /// Records new contents in an unchanged view: the next frame shows them, sharp once the view rests.
    pub fn renew(&mut self, busy: bool) {
        (self.dirty, self.sharp) = (self.dirty || busy, false);
    }

    fn rests(&self, now: Instant, busy: bool) -> bool {
        !busy && self.changed.is_none_or(|changed| now.duration_since(changed) > REST)
    }

    /// Returns the next frame to draw, without marking it as drawn.
    pub fn next(&self, now: Instant, busy: bool) -> NextFrame {
        match (self.dirty, self.sharp) {
            (true, _) => NextFrame::Moving(SCALES[self.level]),
            (false, false) if self.rests(now, busy) => NextFrame::Still,
            _ => NextFrame::Nothing,
        }
    }

    /// Time at which a sharp frame becomes due without further events.
    pub fn wakes(&self) -> Option<Instant> {
        self.changed.filter(|_| !self.sharp).map(|changed| changed + REST + Duration::from_millis(1))
    }

    pub fn drawn(&mut self, frame: NextFrame, now: Instant) {
        match frame {
            // A full-size frame is as sharp as one at rest.
            NextFrame::Moving(scale) => (self.dirty, self.sharp) = (false, scale == 1.0),
            _ => (self.dirty, self.sharp) = (false, true),
        }
        self.shown.push_back(now);
        while self.shown.len() > 1
            && (self.shown.len() > RATE_FRAMES || now.duration_since(self.shown[0]) > RATE_TIME)
        {
            self.shown.pop_front();
        }
    }

    /// Adapts the coarseness to a moving frame's time: slow frames become coarser, fast ones finer again.
    pub fn adapt(&mut self, milliseconds: f64, scale: f64) {
        let Some(level) = SCALES.iter().position(|s| *s == scale) else { return };
        let wanted = scale * (GOAL / milliseconds.max(1.0)).sqrt();
        let coarsest = SCALES.len() - 1;
        if milliseconds > 1.3 * GOAL && level < coarsest {
            let fits = SCALES.iter().position(|s| *s <= wanted).unwrap_or(coarsest);
            self.level = fits.max(level + 1);
        } else if level > 0 && wanted >= SCALES[level - 1] * 1.1 {
            self.level = level - 1;
        }
    }

    /// Recent frames per second; 0 for single frames.
    pub fn frames_per_second(&self) -> f64 {
        match (self.shown.front(), self.shown.back()) {
            (Some(first), Some(last)) if self.shown.len() > 2 => {
                (self.shown.len() - 1) as f64 / last.duration_since(*first).as_secs_f64().max(1e-9)
            }
            _ => 0.0,
        }
    }
}
