//! Starts submissions to several queues as late as the rules allow.
//!
//! A submission may start once all earlier ones of its queue have started, and its waits are signalled by started submissions.
//! Submissions to late queues ([`Machine::holds`](super::machine::Machine::holds)) start only when needed: when the host waits
//! for them, or another submission waits for their semaphore. All others start as soon as they may.

use ash::vk;
use std::collections::HashMap;

/// A semaphore and its value; 0 for binary ones.
pub type Point = (vk::Semaphore, u64);

/// Family and index of one of the machine's queues.
pub type Place = (u32, u32);

/// Object that the host waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Want {
    /// The submission with this fence.
    Fence(vk::Fence),
    /// The first submission that signals at least this value.
    Point(Point),
    /// All submissions of a queue.
    Queue(Place),
    /// All submissions of the device.
    All,
}

#[derive(Debug, Default)]
pub struct Held {
    pub place: Place,
    /// True if it starts only when needed.
    pub late: bool,
    pub waits: Vec<vk::SemaphoreSubmitInfo<'static>>,
    pub commands: Vec<vk::CommandBufferSubmitInfo<'static>>,
    pub signals: Vec<vk::SemaphoreSubmitInfo<'static>>,
    pub fence: vk::Fence,
}

/// A queue of the machine. Its handle is its address.
#[repr(C)]
pub struct Queue {
    /// The loader's table, which the loader itself writes here.
    pub table: usize,
    pub place: Place,
}

/// The machine's queues and the submissions to them that have not started, in order, with the state of semaphores.
#[derive(Default)]
pub struct Submissions {
    /// The driver's queue.
    pub queue: vk::Queue,
    /// Boxes keep the addresses stable.
    pub queues: HashMap<Place, Box<Queue>>,
    pub held: Vec<Held>,
    /// Timeline semaphores with the largest value that started submissions signal.
    pub timelines: HashMap<vk::Semaphore, u64>,
    /// Current waits of the host, one for each waiting thread.
    pub wants: Vec<Want>,
}

// SAFETY: handles and addresses are used only under the lock; no chains of structs are kept.
unsafe impl Send for Submissions {}

impl Submissions {
    /// Records a signal by the host.
    pub fn signalled(&mut self, (semaphore, value): Point) {
        if let Some(known) = self.timelines.get_mut(&semaphore) {
            *known = value.max(*known);
        }
    }

    /// Returns a timeline semaphore's value; none for a binary one.
    pub fn reached(&self, semaphore: vk::Semaphore) -> Option<u64> {
        self.timelines.get(&semaphore).copied()
    }

    /// Takes out the next submission that may and should start.
    pub fn next(&mut self) -> Option<Held> {
        let needed = self.needed();
        let ready = |late: bool| {
            (0..self.held.len()).find(|&at| needed[at] && self.held[at].late == late && self.may_start(at))
        };
        let at = ready(false).or_else(|| ready(true))?;
        let held = self.held.remove(at);
        for signal in &held.signals {
            self.signalled((signal.semaphore, signal.value));
        }
        Some(held)
    }

    /// True if a queue still has a submission; without a queue, if any queue does.
    pub fn has(&self, place: Option<Place>) -> bool {
        self.held.iter().any(|held| place.is_none_or(|place| held.place == place))
    }

    fn may_start(&self, at: usize) -> bool {
        let of = &self.held[at];
        self.held[..at].iter().all(|earlier| earlier.place != of.place)
            && of.waits.iter().all(|wait| match self.reached(wait.semaphore) {
                Some(value) => value >= wait.value,
                None => self.signaller(wait.semaphore, 0, at).is_none(),
            })
    }

    /// Index of the submission that a wait needs. For a timeline semaphore, the first one that signals enough, at any position.
    /// For a binary one, the last one before the waiting submission.
    fn signaller(&self, semaphore: vk::Semaphore, value: u64, before: usize) -> Option<usize> {
        let signals = |held: &Held| {
            held.signals.iter().any(|signal| signal.semaphore == semaphore && signal.value >= value)
        };
        match self.reached(semaphore) {
            Some(reached) if reached >= value => None,
            Some(_) => self.held.iter().position(signals),
            None => self.held[..before].iter().rposition(signals),
        }
    }

    /// True for submissions that should start: those of eager queues, those that the host waits for, and those that these need.
    fn needed(&self) -> Vec<bool> {
        let count = self.held.len();
        let mut needed = vec![false; count];
        let mut open: Vec<usize> = (0..count).filter(|&at| !self.held[at].late).collect();
        for want in &self.wants {
            match *want {
                Want::All => open.extend(0..count),
                Want::Queue(place) => open.extend((0..count).filter(|&at| self.held[at].place == place)),
                Want::Fence(fence) => open.extend(self.held.iter().position(|held| held.fence == fence)),
                Want::Point((semaphore, value)) => open.extend(self.signaller(semaphore, value, count)),
            }
        }
        while let Some(at) = open.pop() {
            if std::mem::replace(&mut needed[at], true) {
                continue;
            }
            open.extend((0..at).filter(|&earlier| self.held[earlier].place == self.held[at].place));
            let waits = self.held[at].waits.iter();
            open.extend(waits.filter_map(|wait| self.signaller(wait.semaphore, wait.value, at)));
        }
        needed
    }
}
