//! Connections: how many may be open, in all and from one address, and which one makes way for a new one.
//!
//! A connection takes a descriptor of the program, which saving needs too. So there are few, and idle ones close
//! first.

use ashsplat_program::session::locked;
use std::net::IpAddr;
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Most connections in all. A page keeps one open, and a browser opens six more.
const MOST: usize = 96;
/// Descriptors reserved for the rest of the program, such as saving.
const RESERVE: usize = 64;
/// Connections that the viewer gets even with few descriptors.
const LEAST: usize = 8;
/// Interval at which a connection that waits for the program counts as active; much shorter than the stall limit.
const NOTE: Duration = if cfg!(test) { Duration::from_millis(20) } else { Duration::from_secs(10) };

/// Limits of number and time.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub total: usize,
    /// Connections from one address.
    pub per_peer: usize,
    /// Time for the headers of a request, also of the first.
    pub headers: Duration,
    /// Time for any other progress.
    pub stall: Duration,
}

impl Limits {
    /// Limits that fit the process's free descriptors.
    pub fn of_process() -> Limits {
        Limits::within(free_descriptors())
    }

    fn within(descriptors: usize) -> Limits {
        let total = descriptors.saturating_sub(RESERVE).clamp(LEAST, MOST);
        let (headers, stall) = (Duration::from_secs(10), Duration::from_secs(60));
        Limits { total, per_peer: total / 2, headers, stall }
    }
}

/// Number of descriptors that the process may still open.
fn free_descriptors() -> usize {
    #[cfg(unix)]
    {
        let most = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
        let most = most.map_or(usize::MAX, |most| usize::try_from(most).unwrap_or(usize::MAX));
        let open = std::fs::read_dir("/dev/fd").map_or(0, Iterator::count);
        most.saturating_sub(open)
    }
    #[cfg(not(unix))]
    usize::MAX
}

/// All open connections.
pub struct Seats {
    limits: Limits,
    taken: Mutex<Vec<Arc<Seat>>>,
}

/// One connection.
pub struct Seat {
    peer: IpAddr,
    state: Mutex<State>,
    signal: Notify,
}

struct State {
    /// Time of the last traffic.
    moved: Instant,
    /// Number of requests that are being answered.
    requests: usize,
    /// True for a page's WebSocket, which is watched elsewhere.
    page: bool,
    /// True if it must make way.
    goes: bool,
}

impl Seats {
    pub fn new(limits: Limits) -> Seats {
        Seats { limits, taken: Mutex::default() }
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<Seat>>> {
        locked(&self.taken)
    }

    /// Takes a seat for a new connection. If none is free, the longest idle connection makes way. None if none is idle.
    pub fn take(&self, peer: IpAddr) -> Option<Arc<Seat>> {
        let mut taken = self.lock();
        let staying = |seat: &&Arc<Seat>| !seat.lock().goes;
        let of_peer = taken.iter().filter(staying).filter(|seat| seat.peer == peer).count();
        let full = taken.iter().filter(staying).count() >= self.limits.total;
        if of_peer >= self.limits.per_peer || full {
            let idle = taken.iter().filter(staying).filter(|seat| seat.is_idle());
            // An address that has used up its share gives up one of its own.
            let idle = idle.filter(|seat| of_peer < self.limits.per_peer || seat.peer == peer);
            let longest = idle.min_by_key(|seat| seat.lock().moved)?;
            longest.lock().goes = true;
            longest.signal.notify_one();
        }
        let state = State { moved: Instant::now(), requests: 0, page: false, goes: false };
        let seat = Arc::new(Seat { peer, state: Mutex::new(state), signal: Notify::new() });
        taken.push(seat.clone());
        Some(seat)
    }

    /// Frees the seat of a closed connection.
    pub fn leave(&self, seat: &Arc<Seat>) {
        self.lock().retain(|taken| !Arc::ptr_eq(taken, seat));
    }

    #[cfg(test)]
    pub fn taken(&self) -> usize {
        self.lock().len()
    }
}

impl Seat {
    pub fn peer(&self) -> IpAddr {
        self.peer
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    /// Records traffic.
    pub fn has_moved(&self) {
        self.lock().moved = Instant::now();
    }

    /// Waits for the program's own work. Meanwhile the connection counts as active, since its peer is not at fault.
    pub async fn waits_for<T>(&self, work: impl Future<Output = T>) -> T {
        let mut work = pin!(work);
        loop {
            match tokio::time::timeout(NOTE, work.as_mut()).await {
                Ok(done) => return done,
                Err(_) => self.has_moved(),
            }
        }
    }

    /// Counts a request as being answered until the value is dropped.
    pub fn begin(self: &Arc<Seat>) -> Answering {
        self.lock().requests += 1;
        Answering(self.clone())
    }

    /// Marks the connection as a page's WebSocket.
    pub fn becomes_page(&self) {
        self.lock().page = true;
    }

    fn is_idle(&self) -> bool {
        let state = self.lock();
        !state.page && state.requests == 0
    }

    /// Waits until the connection must make way, or has stalled.
    pub async fn must_go(&self, stall: Duration) {
        let must_go = || {
            let state = self.lock();
            state.goes || !state.page && state.moved.elapsed() >= stall
        };
        while !must_go() {
            tokio::time::timeout(stall / 8, self.signal.notified()).await.ok();
        }
    }
}

/// A request that is being answered.
pub struct Answering(Arc<Seat>);

impl Drop for Answering {
    fn drop(&mut self) {
        self.0.lock().requests -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_waits_for_the_program_stays() {
        let stall = Duration::from_millis(300);
        let seats = Seats::new(Limits { total: 2, per_peer: 2, headers: stall, stall });
        let seat = seats.take("127.0.0.1".parse().expect("an address")).expect("a seat");
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
        let stays = runtime.block_on(async {
            tokio::select! {
                biased;
                () = seat.waits_for(tokio::time::sleep(4 * stall)) => true,
                () = seat.must_go(stall) => false,
            }
        });
        assert!(stays);
        // When the work is done, its time runs again.
        runtime.block_on(seat.must_go(stall));
    }

    #[test]
    fn the_longest_idle_makes_way_and_no_place_takes_all() {
        let limits = Limits { total: 5, per_peer: 3, ..Limits::within(usize::MAX) };
        let seats = Seats::new(limits);
        let [here, there] = ["127.0.0.1", "10.0.0.7"].map(|ip| ip.parse().expect("an address"));
        let (goes, start) = (|seat: &Seat| seat.lock().goes, Instant::now());
        let moved = |seat: &Seat, after| seat.lock().moved = start + Duration::from_secs(after);
        let all: Vec<Arc<Seat>> = (0..3).map(|_| seats.take(here).expect("a seat")).collect();
        let answering = all[0].begin();
        moved(&all[1], 7);
        moved(&all[2], 3);
        let other = seats.take(there).expect("a seat");
        moved(&other, 0);
        // The address has used up its share: its own idle connection goes, not another address's.
        let next = seats.take(here).expect("a seat");
        assert!(goes(&all[2]) && !goes(&all[1]) && !goes(&other));
        seats.leave(&all[2]);
        next.becomes_page();
        all[1].becomes_page();
        assert!(seats.take(here).is_none(), "none of them is idle");
        let last = seats.take(there).expect("a seat");
        last.becomes_page();
        // All are taken: the other address's idle connection makes way, and then one of this address.
        assert!(seats.take(there).is_some() && goes(&other));
        seats.leave(&other);
        drop(answering);
        assert!(seats.take(here).is_some() && goes(&all[0]));
        assert_eq!(seats.taken(), 6);
    }
}
