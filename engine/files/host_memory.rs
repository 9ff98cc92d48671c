//! Budgets of host memory for reading files, and the machine's free memory.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use ashsplat::{Error, Result};

/// The budget if the system does not report its free memory.
const UNKNOWN: u64 = 4 << 30;
/// Share of the machine's free memory that reading may take; the rest is for other programs and for kept data.
const SHARE: (u64, u64) = (3, 4);

/// Default budget of readers, bytes: see [`HostMemory::set_default`].
static DEFAULT: AtomicU64 = AtomicU64::new(UNSET);
const UNSET: u64 = u64::MAX;

/// Budget of host memory for files while they are decoded. Clones share it, for example those of several threads.
#[derive(Clone, Debug)]
pub struct HostMemory(Arc<State>);

#[derive(Debug)]
struct State {
    limit: u64,
    /// The setting that determines the limit, for messages.
    limit_name: &'static str,
    used: Mutex<u64>,
    freed: Condvar,
}

impl PartialEq for HostMemory {
    fn eq(&self, other: &Self) -> bool {
        self.0.limit == other.0.limit
    }
}

impl Default for HostMemory {
    /// The budget of [`HostMemory::set_default`], or three quarters of the machine's free memory.
    fn default() -> Self {
        match DEFAULT.load(Ordering::Relaxed) {
            UNSET => Self::named(available(), "--max-host-memory, by default three quarters of what is free"),
            limit => Self::new(limit),
        }
    }
}

impl HostMemory {
    /// A budget of `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self::named(limit, "--max-host-memory")
    }

    /// Limits every reader of this process without a budget of its own, including readers of JSON and COLMAP.
    pub fn set_default(limit: u64) {
        DEFAULT.store(limit, Ordering::Relaxed);
    }

    /// The machine's free memory, or the budget of [`HostMemory::set_default`] if that is less.
    fn free() -> Self {
        let (set, machine) = (DEFAULT.load(Ordering::Relaxed), Self::machine());
        if set < machine.limit() { Self::new(set) } else { machine }
    }

    fn machine() -> Self {
        Self::named(available(), "three quarters of what is free")
    }

    fn named(limit: u64, limit_name: &'static str) -> Self {
        Self(Arc::new(State { limit, limit_name, used: Mutex::new(0), freed: Condvar::new() }))
    }

    /// The budget of decoding while `kept` bytes of decoded photos are held.
    pub(crate) fn beside_photos(&self, kept: u64) -> Self {
        Self::named(self.0.limit.saturating_sub(kept), "what --max-host-memory leaves beside the photos kept")
    }

    /// Size of the budget, bytes.
    pub fn limit(&self) -> u64 {
        self.0.limit
    }

    /// Reserves memory for reading a file; waits while others have it. The holder must not wait for other threads.
    pub(crate) fn take(&self, path: &Path, bytes: u64) -> Result<Lease> {
        self.keep(&|| reading(path), bytes)
    }

    /// Reserves memory for data that `what` names, such as those that are kept while files are read. The files get the
    /// rest: see [`HostMemory::beside_photos`].
    pub(crate) fn keep(&self, what: &dyn Fn() -> String, bytes: u64) -> Result<Lease> {
        let Self(state) = self;
        if bytes > state.limit {
            return Err(too_large(what(), bytes, state.limit, state.limit_name));
        }
        let used = state.used.lock().unwrap_or_else(PoisonError::into_inner);
        let enough = |used: &mut u64| bytes > state.limit - (*used).min(state.limit);
        let mut used = state.freed.wait_while(used, enough).unwrap_or_else(PoisonError::into_inner);
        // Decoders abort the program when an allocation fails. This trial allocation returns an error instead.
        drop(reserved_for(what, bytes)?);
        *used += bytes;
        Ok(Lease { state: state.clone(), bytes })
    }
}

/// Refuses a file that needs more than `limit`, before memory is reserved for it.
pub(crate) fn check(path: &Path, bytes: u64, limit: Option<u64>) -> Result<()> {
    limit.map_or_else(HostMemory::default, HostMemory::new).take(path, bytes).map(drop)
}

/// Refuses a file that the process has too little memory for.
pub(crate) fn check_free(path: &Path, bytes: u64) -> Result<()> {
    HostMemory::free().take(path, bytes).map(drop)
}

/// Refuses to write data for which the machine has too little memory, independent of the budget of reading.
pub(crate) fn check_writing(path: &Path, bytes: u64) -> Result<()> {
    HostMemory::machine().keep(&|| format!("{}: writing it", path.display()), bytes).map(drop)
}

pub(crate) fn reserved(path: &Path, bytes: u64) -> Result<Vec<u8>> {
    reserved_for(&|| reading(path), bytes)
}

fn reserved_for(what: &dyn Fn() -> String, bytes: u64) -> Result<Vec<u8>> {
    let mut room = Vec::new();
    match usize::try_from(bytes).map(|bytes| room.try_reserve_exact(bytes)) {
        Ok(Ok(())) => Ok(room),
        _ => Err(too_large(what(), bytes, available(), "what the system has left")),
    }
}

fn reading(path: &Path) -> String {
    format!("{}: reading it", path.display())
}

fn too_large(what: String, needed: u64, limit: u64, limit_name: &'static str) -> Error {
    Error::TooLarge { what, needed, unit: "bytes of host memory", limit, limit_name }
}

/// Memory that is reserved as long as the value lives.
#[derive(Debug)]
pub(crate) struct Lease {
    state: Arc<State>,
    bytes: u64,
}

impl Drop for Lease {
    fn drop(&mut self) {
        *self.state.used.lock().unwrap_or_else(PoisonError::into_inner) -= self.bytes;
        self.state.freed.notify_all();
    }
}

/// Three quarters of the least memory that the machine, the control groups and the process limit leave, bytes.
fn available() -> u64 {
    free_bytes().unwrap_or(UNKNOWN) / SHARE.1 * SHARE.0
}

#[cfg(not(target_os = "linux"))]
fn free_bytes() -> Option<u64> {
    let mut system = sysinfo::System::new();
    system.refresh_memory_specifics(sysinfo::MemoryRefreshKind::nothing().with_ram());
    Some(system.available_memory()).filter(|&bytes| bytes > 0)
}

#[cfg(target_os = "linux")]
fn free_bytes() -> Option<u64> {
    // Files of the kernel have no length and are no pipes.
    #[allow(clippy::disallowed_methods)]
    let text = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let machine = kib_of(&text("/proc/meminfo"), "MemAvailable:");
    let own = address_space(&text("/proc/self/limits"))
        .map(|max| max.saturating_sub(kib_of(&text("/proc/self/status"), "VmSize:").unwrap_or(0)));
    let groups = group_folders(&text("/proc/self/cgroup"));
    let left = |(folder, names): &(String, [&str; 2])| {
        let [max, used] = names.map(|name| text(&format!("{folder}/{name}")).trim().parse::<u64>().ok());
        Some(max?.saturating_sub(used?))
    };
    groups.iter().filter_map(left).chain(machine).chain(own).min()
}

/// Reads a number of a file with one `name: number kB` per line, and returns bytes.
#[cfg(target_os = "linux")]
fn kib_of(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find(|line| line.starts_with(name))?;
    line.split_ascii_whitespace().nth(1)?.parse::<u64>().ok()?.checked_mul(1 << 10)
}

/// Limit of `ulimit -v`, bytes; `None` if it is unlimited.
#[cfg(target_os = "linux")]
fn address_space(limits: &str) -> Option<u64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_ascii_whitespace().next()?.parse().ok()
}

/// The control groups of this process and their parents, with the names of their files for limit and use. Version 2 has
/// one hierarchy (`0::/path`), version 1 one for memory. A container may show only the root, not the path.
#[cfg(target_os = "linux")]
fn group_folders(cgroup: &str) -> Vec<(String, [&'static str; 2])> {
    let mut folders = Vec::new();
    for line in cgroup.lines() {
        let mut fields = line.splitn(3, ':').skip(1);
        let (Some(kinds), Some(path)) = (fields.next(), fields.next()) else { continue };
        let (root, names) = match kinds {
            "" => ("/sys/fs/cgroup", ["memory.max", "memory.current"]),
            kinds if kinds.split(',').any(|kind| kind == "memory") => {
                ("/sys/fs/cgroup/memory", ["memory.limit_in_bytes", "memory.usage_in_bytes"])
            }
            _ => continue,
        };
        let above = Path::new(path).ancestors().map(|path| path.to_string_lossy().into_owned());
        folders.extend(above.map(|path| (format!("{root}{}", path.trim_end_matches('/')), names)));
    }
    folders
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;

    #[test]
    fn a_bound_is_shared_and_given_back() {
        let _turn = turn();
        let memory = HostMemory::new(100);
        let path = Path::new("a.png");
        let message = memory.take(path, 101).expect_err("too much").to_string();
        let expected = "a.png: reading it needs 101 bytes of host memory, more than 100 (--max-host-memory)";
        assert_eq!(message, expected);
        let lease = memory.take(path, 60).expect("fits");
        let other = memory.clone();
        let thread = std::thread::spawn(move || other.take(Path::new("b.png"), 50).map(drop));
        std::thread::sleep(std::time::Duration::from_millis(100));
        assert!(!thread.is_finished(), "it has more than the bound");
        drop(lease);
        thread.join().expect("ends").expect("fits");
        let all = HostMemory::new(u64::MAX).take(path, u64::MAX >> 1).expect_err("more than there is");
        assert!(all.to_string().contains("what the system has left"), "{all}");
    }
}
