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
const MAX_CONNECTIONS: usize = 96;
/// Descriptors reserved for the rest of the program, such as saving.
const RESERVE: usize = 64;
/// Connections that the viewer gets even with few descriptors.
const MIN_CONNECTIONS: usize = 8;
/// Interval at which a connection that waits for the program counts as active; much shorter than the stall limit.
const NOTE: Duration = Duration::from_secs(10);

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
        let total = free_descriptors().saturating_sub(RESERVE).clamp(MIN_CONNECTIONS, MAX_CONNECTIONS);
        let (headers, stall) = (Duration::from_secs(10), Duration::from_secs(60));
        Limits { total, per_peer: total / 2, headers, stall }
    }
}

/// Number of descriptors that the process may still open.
fn free_descriptors() -> usize {
    #[cfg(unix)]
    {
        let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
        let limit = limit.map_or(usize::MAX, |limit| usize::try_from(limit).unwrap_or(usize::MAX));
        let open = std::fs::read_dir("/dev/fd").map_or(0, Iterator::count);
        limit.saturating_sub(open)
    }
    #[cfg(not(unix))]
    usize::MAX
}

pub struct OpenConnections {
    pub limits: Limits,
    taken: Mutex<Vec<Arc<OpenConnection>>>,
}

pub struct OpenConnection {
    pub peer: IpAddr,
    state: Mutex<State>,
    signal: Notify,
}

struct State {
    /// Time of the last traffic.
    last_traffic: Instant,
    requests: usize,
    /// True for a page's WebSocket, which is watched elsewhere.
    page: bool,
    /// True if it must make way.
    evicted: bool,
}

impl OpenConnections {
    pub fn new(limits: Limits) -> OpenConnections {
        OpenConnections { limits, taken: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<OpenConnection>>> {
        locked(&self.taken)
    }

    /// Admits a new connection. If there are too many, the longest idle one makes way. None if none is idle.
    pub fn admit(&self, peer: IpAddr) -> Option<Arc<OpenConnection>> {
        let mut taken = self.lock();
        let staying = |connection: &&Arc<OpenConnection>| !connection.lock().evicted;
        let of_peer = taken.iter().filter(staying).filter(|connection| connection.peer == peer).count();
        let full = taken.iter().filter(staying).count() >= self.limits.total;
        if of_peer >= self.limits.per_peer || full {
            let idle = taken.iter().filter(staying).filter(|connection| connection.is_idle());
            // An address that has used up its share gives up one of its own.
            let idle = idle.filter(|connection| of_peer < self.limits.per_peer || connection.peer == peer);
            let longest = idle.min_by_key(|connection| connection.lock().last_traffic)?;
            longest.lock().evicted = true;
            longest.signal.notify_one();
        }
        let state = State { last_traffic: Instant::now(), requests: 0, page: false, evicted: false };
        let connection = Arc::new(OpenConnection { peer, state: Mutex::new(state), signal: Notify::new() });
        taken.push(connection.clone());
        Some(connection)
    }

    pub fn remove(&self, connection: &Arc<OpenConnection>) {
        self.lock().retain(|taken| !Arc::ptr_eq(taken, connection));
    }
}

impl OpenConnection {
    fn lock(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    pub fn note_traffic(&self) {
        self.lock().last_traffic = Instant::now();
    }

    /// Waits for the program's own work. Meanwhile the connection counts as active, since its peer is not at fault.
    pub async fn waits_for<T>(&self, work: impl Future<Output = T>) -> T {
        let mut work = pin!(work);
        loop {
            match tokio::time::timeout(NOTE, work.as_mut()).await {
                Ok(done) => return done,
                Err(_) => self.note_traffic(),
            }
        }
    }

    /// Counts a request as being answered until the value is dropped.
    pub fn begin(self: &Arc<OpenConnection>) -> RequestGuard {
        self.lock().requests += 1;
        RequestGuard(self.clone())
    }

    pub fn becomes_page(&self) {
        self.lock().page = true;
    }

    fn is_idle(&self) -> bool {
        let state = self.lock();
        !state.page && state.requests == 0
    }

    /// Waits until the connection must make way, or has stalled.
    pub async fn until_evicted(&self, stall: Duration) {
        let must_go = || {
            let state = self.lock();
            state.evicted || !state.page && state.last_traffic.elapsed() >= stall
        };
        while !must_go() {
            tokio::time::timeout(stall / 8, self.signal.notified()).await.ok();
        }
    }
}

/// A request that is being answered.
pub struct RequestGuard(Arc<OpenConnection>);

impl Drop for RequestGuard {
    fn drop(&mut self) {
        self.0.lock().requests -= 1;
    }
}
