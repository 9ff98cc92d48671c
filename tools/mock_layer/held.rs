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

/// Submissions that have not started, in order of submission, and the state of semaphores.
#[derive(Default)]
pub struct Order {
    pub held: Vec<Held>,
    /// Timeline semaphores with the largest value that started submissions signal.
    pub timelines: HashMap<vk::Semaphore, u64>,
    /// Current waits of the host, one for each waiting thread.
    pub wants: Vec<Want>,
}

impl Order {
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

#[cfg(test)]
mod tests {
    use super::*;
    use vk::Handle;

    const MAIN: Place = (0, 0);
    const COPIES: Place = (1, 0);

    fn info(&(semaphore, value): &(u64, u64)) -> vk::SemaphoreSubmitInfo<'static> {
        vk::SemaphoreSubmitInfo::default().semaphore(vk::Semaphore::from_raw(semaphore)).value(value)
    }

    /// A submission whose fence has this number.
    fn submission(name: u64, place: Place, waits: &[(u64, u64)], signals: &[(u64, u64)]) -> Held {
        Held {
            place,
            waits: waits.iter().map(info).collect(),
            signals: signals.iter().map(info).collect(),
            fence: vk::Fence::from_raw(name),
            ..Held::default()
        }
    }

    /// Semaphores 7 and 8 are timelines, 9 is binary.
    fn order(late: Place) -> (Order, impl Fn(&mut Order, Held) -> Vec<u64>) {
        let mut order = Order::default();
        order.timelines.extend([7, 8].map(|semaphore| (vk::Semaphore::from_raw(semaphore), 0)));
        (order, move |order, mut held| {
            held.late = held.place == late;
            order.held.push(held);
            started(order)
        })
    }

    fn started(order: &mut Order) -> Vec<u64> {
        std::iter::from_fn(|| order.next()).map(|held| held.fence.as_raw()).collect()
    }

    fn wanted(order: &mut Order, want: Want) -> Vec<u64> {
        order.wants.push(want);
        let started = started(order);
        order.wants.pop();
        started
    }

    #[test]
    fn either_queue_is_late_and_the_other_is_not() {
        for (late, eager) in [(COPIES, MAIN), (MAIN, COPIES)] {
            let (mut order, submit) = order(late);
            assert_eq!(submit(&mut order, submission(1, late, &[], &[(7, 1)])), []);
            assert_eq!(submit(&mut order, submission(2, late, &[], &[(7, 2)])), []);
            assert_eq!(submit(&mut order, submission(3, late, &[], &[(7, 3)])), []);
            assert_eq!(submit(&mut order, submission(4, eager, &[], &[(8, 1)])), [4]);
            // A waiting submission starts those that it needs, and no more.
            assert_eq!(submit(&mut order, submission(5, eager, &[(7, 2)], &[(8, 2)])), [1, 2, 5]);
            assert_eq!(wanted(&mut order, Want::Fence(vk::Fence::from_raw(5))), []);
            assert_eq!(wanted(&mut order, Want::Point((vk::Semaphore::from_raw(7), 3))), [3]);
        }
    }

    #[test]
    fn a_wait_before_its_signal_waits() {
        for late in [COPIES, MAIN] {
            let (mut order, submit) = order(late);
            assert_eq!(submit(&mut order, submission(1, MAIN, &[(7, 1)], &[])), []);
            // The rest of the queue waits too, and so does a submission that needs it.
            assert_eq!(submit(&mut order, submission(2, MAIN, &[], &[(8, 1)])), []);
            assert_eq!(wanted(&mut order, Want::All), []);
            let after = submit(&mut order, submission(3, COPIES, &[], &[(7, 1)]));
            let then = wanted(&mut order, Want::Fence(vk::Fence::from_raw(2)));
            assert_eq!([after, then].concat(), [3, 1, 2]);
            assert!(!order.has(None));
        }
    }

    #[test]
    fn the_host_signals_too() {
        let (mut order, submit) = order(COPIES);
        assert_eq!(submit(&mut order, submission(1, MAIN, &[(7, 4)], &[])), []);
        order.signalled((vk::Semaphore::from_raw(7), 3));
        assert_eq!(started(&mut order), []);
        assert!(order.has(Some(MAIN)) && !order.has(Some(COPIES)));
        order.signalled((vk::Semaphore::from_raw(7), 4));
        assert_eq!(started(&mut order), [1]);
    }

    #[test]
    fn binary_semaphores_pair_with_the_last_signal() {
        let (mut order, submit) = order(COPIES);
        // Signalled from outside the device's submissions.
        assert_eq!(submit(&mut order, submission(1, MAIN, &[(9, 0)], &[])), [1]);
        assert_eq!(submit(&mut order, submission(2, COPIES, &[], &[(9, 0)])), []);
        assert_eq!(submit(&mut order, submission(3, COPIES, &[], &[])), []);
        assert_eq!(submit(&mut order, submission(4, MAIN, &[(9, 0)], &[])), [2, 4]);
        assert_eq!(submit(&mut order, submission(5, COPIES, &[], &[(9, 0)])), [] as [u64; 0]);
        assert_eq!(wanted(&mut order, Want::Queue(COPIES)), [3, 5]);
    }

    #[test]
    fn a_host_that_waits_gets_what_another_thread_submits() {
        let (mut order, submit) = order(COPIES);
        order.wants.push(Want::Point((vk::Semaphore::from_raw(7), 2)));
        assert_eq!(submit(&mut order, submission(1, COPIES, &[], &[(7, 1)])), []);
        assert_eq!(submit(&mut order, submission(2, COPIES, &[], &[(7, 2)])), [1, 2]);
    }
}
