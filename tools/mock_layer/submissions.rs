//! Starts submissions to several queues as late as the rules allow.
//!
//! A submission may start once all earlier ones of its queue have started, and its waits are signalled by started submissions.
//! Submissions to late queues ([`Machine::holds`](super::machine::Machine::holds)) start only when needed: when the host waits
//! for them, or another submission waits for their semaphore. All others start as soon as they may.

use ash::vk;
use std::collections::HashMap;

/// A semaphore and its value; 0 for binary ones.
pub type SemaphoreValue = (vk::Semaphore, u64);

/// Family and index of one of the machine's queues.
pub type QueueIndex = (u32, u32);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wait {
    Fence(vk::Fence),
    /// The first submission that signals at least this value.
    Semaphore(SemaphoreValue),
    Queue(QueueIndex),
    All,
}

#[derive(Debug, Default)]
pub struct Submission {
    pub index: QueueIndex,
    /// True if it starts only when needed.
    pub is_late: bool,
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
    pub index: QueueIndex,
}

/// The machine's queues and the submissions to them that have not started, in order, with the state of semaphores.
#[derive(Default)]
pub struct Submissions {
    pub queue: vk::Queue,
    /// Boxes keep the addresses stable.
    pub queues: HashMap<QueueIndex, Box<Queue>>,
    pub pending: Vec<Submission>,
    /// Timeline semaphores with the largest value that started submissions signal.
    pub timelines: HashMap<vk::Semaphore, u64>,
    /// Current waits of the host, one for each waiting thread.
    pub host_waits: Vec<Wait>,
}

// SAFETY: handles and addresses are used only under the lock; no chains of structs are kept.
unsafe impl Send for Submissions {}

impl Submissions {
    pub fn signalled(&mut self, (semaphore, value): SemaphoreValue) {
        if let Some(known) = self.timelines.get_mut(&semaphore) {
            *known = value.max(*known);
        }
    }

    /// Returns a timeline semaphore's value; none for a binary one.
    pub fn reached(&self, semaphore: vk::Semaphore) -> Option<u64> {
        self.timelines.get(&semaphore).copied()
    }

    /// Takes out the next submission that may and should start.
    pub fn next(&mut self) -> Option<Submission> {
        let needed = self.needed();
        let ready = |is_late: bool| {
            (0..self.pending.len())
                .find(|&at| needed[at] && self.pending[at].is_late == is_late && self.may_start(at))
        };
        let at = ready(false).or_else(|| ready(true))?;
        let submission = self.pending.remove(at);
        for signal in &submission.signals {
            self.signalled((signal.semaphore, signal.value));
        }
        Some(submission)
    }

    /// True if a queue still has a submission; without a queue, if any queue does.
    pub fn has(&self, index: Option<QueueIndex>) -> bool {
        self.pending.iter().any(|submission| index.is_none_or(|index| submission.index == index))
    }

    fn may_start(&self, at: usize) -> bool {
        let of = &self.pending[at];
        self.pending[..at].iter().all(|earlier| earlier.index != of.index)
            && of.waits.iter().all(|wait| match self.reached(wait.semaphore) {
                Some(value) => value >= wait.value,
                None => self.signaller(wait.semaphore, 0, at).is_none(),
            })
    }

    /// Index of the submission that a wait needs. For a timeline semaphore, the first one that signals enough, at any position.
    /// For a binary one, the last one before the waiting submission.
    fn signaller(&self, semaphore: vk::Semaphore, value: u64, before: usize) -> Option<usize> {
        let signals = |submission: &Submission| {
            submission.signals.iter().any(|signal| signal.semaphore == semaphore && signal.value >= value)
        };
        match self.reached(semaphore) {
            Some(reached) if reached >= value => None,
            Some(_) => self.pending.iter().position(signals),
            None => self.pending[..before].iter().rposition(signals),
        }
    }

    /// True for submissions that should start: those of eager queues, those that the host waits for, and those that these need.
    fn needed(&self) -> Vec<bool> {
        let count = self.pending.len();
        let mut needed = vec![false; count];
        let mut open: Vec<usize> = (0..count).filter(|&at| !self.pending[at].is_late).collect();
        for host_wait in &self.host_waits {
            match *host_wait {
                Wait::All => open.extend(0..count),
                Wait::Queue(index) => open.extend((0..count).filter(|&at| self.pending[at].index == index)),
                Wait::Fence(fence) => {
                    open.extend(self.pending.iter().position(|submission| submission.fence == fence))
                }
                Wait::Semaphore((semaphore, value)) => open.extend(self.signaller(semaphore, value, count)),
            }
        }
        while let Some(at) = open.pop() {
            if std::mem::replace(&mut needed[at], true) {
                continue;
            }
            open.extend((0..at).filter(|&earlier| self.pending[earlier].index == self.pending[at].index));
            let waits = self.pending[at].waits.iter();
            open.extend(waits.filter_map(|wait| self.signaller(wait.semaphore, wait.value, at)));
        }
        needed
    }
}
