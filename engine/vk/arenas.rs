//! What is allocated in each arena, and the most that ever was.

use super::context::Context;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Memory of one arena.
#[derive(Clone, Debug, PartialEq)]
pub struct ArenaMemory {
    /// The arena's name.
    pub name: String,
    /// Allocated now.
    pub bytes: u64,
    /// Most that was ever allocated at a time.
    pub peak_bytes: u64,
}

/// Now, and at most.
type Amount = (u64, u64);

/// Bytes by arena, and of all together.
#[derive(Default)]
pub(super) struct Registry(Mutex<(BTreeMap<Arc<str>, Amount>, Amount)>);

impl Registry {
    pub(super) fn add(&self, arena: &Arc<str>, bytes: u64) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (arenas, total) = &mut *all;
        for (now, peak) in [arenas.entry(arena.clone()).or_default(), total] {
            *now += bytes;
            *peak = (*now).max(*peak);
        }
    }

    pub(super) fn remove(&self, arena: &Arc<str>, bytes: u64) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (arenas, total) = &mut *all;
        for (now, _) in [arenas.entry(arena.clone()).or_default(), total] {
            *now -= bytes;
        }
    }

    fn reset_peaks(&self) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (arenas, total) = &mut *all;
        // Blocks that are alive have bytes in their arena: none of them misses it.
        arenas.retain(|_, (now, _)| *now > 0);
        arenas.values_mut().chain([total]).for_each(|(now, peak)| *peak = *now);
    }

    fn all(&self) -> Vec<ArenaMemory> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.0
            .iter()
            .map(|(n, &(b, p))| ArenaMemory { name: n.to_string(), bytes: b, peak_bytes: p })
            .collect()
    }

    pub(super) fn total(&self) -> ArenaMemory {
        let (bytes, peak_bytes) = self.0.lock().unwrap_or_else(PoisonError::into_inner).1;
        ArenaMemory { name: "total".into(), bytes, peak_bytes }
    }
}

impl Context {
    /// Lets the peaks of [`Context::memory`] and [`Context::memory_total`] begin anew at what is allocated now; arenas that
    /// hold nothing are forgotten. For measurements of one piece of work after another on the same context.
    pub fn reset_memory_peaks(&self) {
        self.0.registry.reset_peaks();
    }

    /// What is allocated in each arena, and the most that ever was, or was since [`Context::reset_memory_peaks`].
    pub fn memory(&self) -> Vec<ArenaMemory> {
        self.0.registry.all()
    }

    /// What is allocated in all arenas together, and the most that ever was at a time (as in [`Context::memory`]).
    pub fn memory_total(&self) -> ArenaMemory {
        self.0.registry.total()
    }
}
