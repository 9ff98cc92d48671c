//! Shares of a budget. A client with many requests delays mostly itself: others wait only for work already under way.

use ashsplat_program::session::locked;
use std::collections::{BTreeMap, VecDeque};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::sync::oneshot;

/// Most waiting requests of one client; more are refused.
const MAX_WAITING: usize = 24;
const MAX_REMEMBERED: usize = 64;
/// Longest wait of a request.
const PATIENCE: Duration = Duration::from_secs(20);

/// A page, or any other client at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Client {
    pub peer: IpAddr,
    pub page: Option<u64>,
}

/// A budget and its waiting clients.
#[derive(Clone)]
pub struct Queue(Arc<Mutex<State>>);

struct State {
    free: u32,
    /// Largest share of one client.
    max_share: u32,
    clients: BTreeMap<Client, Jobs>,
    turns: u64,
}

/// The requests of one client, in their order.
#[derive(Default)]
struct Jobs {
    waiting: VecDeque<(u32, oneshot::Sender<Permit>)>,
    /// Its current share of the budget.
    held: u32,
    /// Turn in which it was served last.
    served: u64,
}

/// A share of the budget, until it is dropped.
pub struct Permit {
    queue: Queue,
    client: Client,
    share: u32,
}

impl Queue {
    /// A queue with this budget. `max_share` is the largest share of one client.
    pub fn new(budget: u32, max_share: u32) -> Queue {
        Queue(Arc::new(Mutex::new(State { free: budget, max_share, clients: BTreeMap::new(), turns: 0 })))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        locked(&self.0)
    }

    /// Waits for a share of the budget, capped at `max_share`. None if there are too many requests.
    pub async fn acquire(&self, client: Client, share: u32) -> Option<Permit> {
        let permit = {
            let mut state = self.lock();
            state.remove_closed();
            let share = share.min(state.max_share);
            let jobs = state.clients.entry(client).or_default();
            if jobs.waiting.len() >= MAX_WAITING {
                return None;
            }
            let (grant, permit) = oneshot::channel();
            jobs.waiting.push_back((share, grant));
            permit
        };
        self.serve();
        tokio::time::timeout(PATIENCE, permit).await.ok()?.ok()
    }

    /// Gives the free budget to waiting clients.
    fn serve(&self) {
        loop {
            let Some((grant, permit)) = self.next() else { return };
            // If the receiver has gone, the dropped permit frees its share at once.
            drop(grant.send(permit));
        }
    }

    fn next(&self) -> Option<(oneshot::Sender<Permit>, Permit)> {
        let mut state = self.lock();
        state.remove_closed();
        let State { free, max_share, clients, turns } = &mut *state;
        let ready = |jobs: &Jobs| {
            jobs.waiting.front().is_some_and(|(share, _)| jobs.held.saturating_add(*share) <= *max_share)
        };
        let next = clients.iter_mut().filter(|(_, jobs)| ready(jobs)).min_by_key(|(_, jobs)| jobs.served);
        let (client, jobs) = next?;
        // Small requests must not overtake a large one for ever.
        if jobs.waiting.front()?.0 > *free {
            return None;
        }
        let (share, grant) = jobs.waiting.pop_front()?;
        *turns += 1;
        *free -= share;
        (jobs.held, jobs.served) = (jobs.held + share, *turns);
        Some((grant, Permit { queue: self.clone(), client: *client, share }))
    }
}

impl State {
    fn remove_closed(&mut self) {
        for jobs in self.clients.values_mut() {
            jobs.waiting.retain(|(_, grant)| !grant.is_closed());
        }
    }

    fn give_back(&mut self, client: Client, share: u32) {
        self.free += share;
        if let Some(jobs) = self.clients.get_mut(&client) {
            jobs.held -= share;
        }
        let is_idle = |jobs: &Jobs| jobs.held == 0 && jobs.waiting.is_empty();
        if self.clients.len() > MAX_REMEMBERED {
            let oldest =
                self.clients.iter().filter(|(_, jobs)| is_idle(jobs)).min_by_key(|(_, jobs)| jobs.served);
            if let Some(client) = oldest.map(|(client, _)| *client) {
                self.clients.remove(&client);
            }
        }
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.queue.lock().give_back(self.client, self.share);
        self.queue.serve();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::pin::Pin;
    use std::task::{Context, Poll, Waker};

    type Waiting = Pin<Box<dyn Future<Output = Option<Permit>>>>;

    /// Requests of one page: granted, waiting and refused.
    #[derive(Default)]
    struct Page {
        permits: Vec<Permit>,
        waiting: Vec<Waiting>,
        refused: usize,
    }

    impl Page {
        fn ask(&mut self, queue: &Queue, page: u64, share: u32) {
            let (queue, peer) = (queue.clone(), IpAddr::from([127, 0, 0, 1]));
            let client = Client { peer, page: Some(page) };
            self.waiting.push(Box::pin(async move { queue.acquire(client, share).await }));
            self.look();
        }

        fn look(&mut self) {
            let mut still = Vec::new();
            for mut waits in self.waiting.drain(..) {
                match waits.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                    Poll::Ready(Some(permit)) => self.permits.push(permit),
                    Poll::Ready(None) => self.refused += 1,
                    Poll::Pending => still.push(waits),
                }
            }
            self.waiting = still;
        }

        fn counts(&mut self) -> [usize; 3] {
            self.look();
            [self.permits.len(), self.waiting.len(), self.refused]
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
        assert_eq!(a.counts(), [2, MAX_WAITING, 200 - 2 - MAX_WAITING]);
        (0..2).for_each(|_| b.ask(&queue, 2, 1));
        c.ask(&queue, 3, 1);
        assert_eq!([b.counts(), c.counts()], [[0, 2, 0], [0, 1, 0]]);
        // Each of them is served before the next request of the first.
        a.permits.clear();
        assert_eq!([a.counts()[0], b.counts()[0], c.counts()[0]], [0, 1, 1]);
        b.permits.clear();
        c.permits.clear();
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
        assert_eq!(gone.counts(), [2, MAX_WAITING, 30 - MAX_WAITING]);
        drop(gone);
        assert_eq!(queue.lock().free, 2);
        (0..1000).for_each(|page| Page::default().ask(&queue, page, 1));
        assert!(queue.lock().clients.len() <= MAX_REMEMBERED + 1 && queue.lock().free == 2);
    }
}
