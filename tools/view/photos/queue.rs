//! Turns at a budget. An asker with many requests delays mostly itself: others wait only for work already under way.

use ashsplat_program::session::locked;
use std::collections::{BTreeMap, VecDeque};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::sync::oneshot;

/// Most waiting requests of one asker; more are refused.
const MOST_WAITING: usize = 24;
/// Idle askers whose last turn is remembered.
const MOST_REMEMBERED: usize = 64;
/// Longest wait of a request.
const PATIENCE: Duration = Duration::from_secs(20);

/// A page, or any other client at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Asker {
    pub peer: IpAddr,
    pub page: Option<u64>,
}

/// A budget and its waiting askers.
#[derive(Clone)]
pub struct Queue(Arc<Mutex<State>>);

struct State {
    free: u32,
    /// Largest share of one asker.
    most_of_one: u32,
    lines: BTreeMap<Asker, Line>,
    turns: u64,
}

/// The requests of one asker, in their order.
#[derive(Default)]
struct Line {
    waiting: VecDeque<(u32, oneshot::Sender<Turn>)>,
    /// Its current share of the budget.
    has: u32,
    /// Turn in which it was served last.
    served: u64,
}

/// A share of the budget, until it is dropped.
pub struct Turn {
    queue: Queue,
    asker: Asker,
    share: u32,
}

impl Queue {
    /// A queue with this budget. `most_of_one` is the largest share of one asker.
    pub fn new(budget: u32, most_of_one: u32) -> Queue {
        Queue(Arc::new(Mutex::new(State { free: budget, most_of_one, lines: BTreeMap::new(), turns: 0 })))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        locked(&self.0)
    }

    /// Waits for the asker's turn and takes a share, capped at one asker's largest. None if there are too many requests.
    pub async fn turn(&self, asker: Asker, share: u32) -> Option<Turn> {
        let turn = {
            let mut state = self.lock();
            state.forget_the_gone();
            let share = share.min(state.most_of_one);
            let line = state.lines.entry(asker).or_default();
            if line.waiting.len() >= MOST_WAITING {
                return None;
            }
            let (grant, turn) = oneshot::channel();
            line.waiting.push_back((share, grant));
            turn
        };
        self.serve();
        tokio::time::timeout(PATIENCE, turn).await.ok()?.ok()
    }

    /// Gives the free budget to waiting askers.
    fn serve(&self) {
        loop {
            let Some((grant, turn)) = self.next() else { return };
            // If the receiver has gone, the dropped turn frees its share at once.
            drop(grant.send(turn));
        }
    }

    fn next(&self) -> Option<(oneshot::Sender<Turn>, Turn)> {
        let mut state = self.lock();
        state.forget_the_gone();
        let State { free, most_of_one, lines, turns } = &mut *state;
        let ready = |line: &Line| {
            line.waiting.front().is_some_and(|(share, _)| line.has.saturating_add(*share) <= *most_of_one)
        };
        let next = lines.iter_mut().filter(|(_, line)| ready(line)).min_by_key(|(_, line)| line.served);
        let (asker, line) = next?;
        // Small requests must not overtake a large one for ever.
        if line.waiting.front()?.0 > *free {
            return None;
        }
        let (share, grant) = line.waiting.pop_front()?;
        *turns += 1;
        *free -= share;
        (line.has, line.served) = (line.has + share, *turns);
        Some((grant, Turn { queue: self.clone(), asker: *asker, share }))
    }
}

impl State {
    /// Removes requests whose connection is closed.
    fn forget_the_gone(&mut self) {
        for line in self.lines.values_mut() {
            line.waiting.retain(|(_, grant)| !grant.is_closed());
        }
    }

    fn give_back(&mut self, asker: Asker, share: u32) {
        self.free += share;
        if let Some(line) = self.lines.get_mut(&asker) {
            line.has -= share;
        }
        let at_rest = |line: &Line| line.has == 0 && line.waiting.is_empty();
        if self.lines.len() > MOST_REMEMBERED {
            let oldest =
                self.lines.iter().filter(|(_, line)| at_rest(line)).min_by_key(|(_, line)| line.served);
            if let Some(asker) = oldest.map(|(asker, _)| *asker) {
                self.lines.remove(&asker);
            }
        }
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.queue.lock().give_back(self.asker, self.share);
        self.queue.serve();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::pin::Pin;
    use std::task::{Context, Poll, Waker};

    type Waiting = Pin<Box<dyn Future<Output = Option<Turn>>>>;

    /// Requests of one page: granted, waiting and refused.
    #[derive(Default)]
    struct Page {
        turns: Vec<Turn>,
        waiting: Vec<Waiting>,
        refused: usize,
    }

    impl Page {
        fn ask(&mut self, queue: &Queue, page: u64, share: u32) {
            let (queue, peer) = (queue.clone(), IpAddr::from([127, 0, 0, 1]));
            let asker = Asker { peer, page: Some(page) };
            self.waiting.push(Box::pin(async move { queue.turn(asker, share).await }));
            self.look();
        }

        fn look(&mut self) {
            let mut still = Vec::new();
            for mut waits in self.waiting.drain(..) {
                match waits.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                    Poll::Ready(Some(turn)) => self.turns.push(turn),
                    Poll::Ready(None) => self.refused += 1,
                    Poll::Pending => still.push(waits),
                }
            }
            self.waiting = still;
        }

        fn counts(&mut self) -> [usize; 3] {
            self.look();
            [self.turns.len(), self.waiting.len(), self.refused]
        }
    }

    fn clock() -> tokio::runtime::Runtime {
        tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime")
    }

    #[test]
    fn who_asks_for_much_does_not_delay_others() {
        let clock = clock();
        let _entered = clock.enter();
        let queue = Queue::new(2, 2);
        let [mut a, mut b, mut c] = [(); 3].map(|()| Page::default());
        (0..200).for_each(|_| a.ask(&queue, 1, 1));
        assert_eq!(a.counts(), [2, MOST_WAITING, 200 - 2 - MOST_WAITING]);
        (0..2).for_each(|_| b.ask(&queue, 2, 1));
        c.ask(&queue, 3, 1);
        assert_eq!([b.counts(), c.counts()], [[0, 2, 0], [0, 1, 0]]);
        // Each of them is served before the next request of the first.
        a.turns.clear();
        assert_eq!([a.counts()[0], b.counts()[0], c.counts()[0]], [0, 1, 1]);
        b.turns.clear();
        c.turns.clear();
        assert_eq!([a.counts()[0], b.counts()[0], c.counts()[0]], [1, 1, 0]);
    }

    #[test]
    fn who_has_gone_waits_no_more_and_nothing_is_lost() {
        let clock = clock();
        let _entered = clock.enter();
        let queue = Queue::new(2, 2);
        let mut gone = Page::default();
        (0..20).for_each(|_| gone.ask(&queue, 1, 1));
        gone.waiting.clear();
        (0..30).for_each(|_| gone.ask(&queue, 1, 1));
        assert_eq!(gone.counts(), [2, MOST_WAITING, 30 - MOST_WAITING]);
        drop(gone);
        assert_eq!(queue.lock().free, 2);
        (0..1000).for_each(|page| Page::default().ask(&queue, page, 1));
        assert!(queue.lock().lines.len() <= MOST_REMEMBERED + 1 && queue.lock().free == 2);
    }
}
