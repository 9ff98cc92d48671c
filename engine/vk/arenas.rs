//! Current and peak bytes of each arena.

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
    /// Peak of the allocated bytes.
    pub peak_bytes: u64,
}

/// Current and peak bytes.
type Amount = (u64, u64);

/// Bytes per arena and in total.
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
        // Living blocks have bytes in their arena, so no arena is removed that a block still needs.
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
    /// Resets the peaks of [`Context::memory`] and [`Context::memory_total`] to the current bytes, and
    /// forgets empty arenas. For measurements of several pieces of work on the same context.
    pub fn reset_memory_peaks(&self) {
        self.0.registry.reset_peaks();
    }

    /// Current and peak bytes of each arena. The peak counts from [`Context::reset_memory_peaks`] on.
    pub fn memory(&self) -> Vec<ArenaMemory> {
        self.0.registry.all()
    }

    /// Current and peak bytes of all arenas together (peak as in [`Context::memory`]).
    pub fn memory_total(&self) -> ArenaMemory {
        self.0.registry.total()
    }
}
