//! Current and peak bytes of each arena.

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

    pub(super) fn reset_peaks(&self) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (arenas, total) = &mut *all;
        // Living blocks have bytes in their arena, so no arena is removed that a block still needs.
        arenas.retain(|_, (now, _)| *now > 0);
        arenas.values_mut().chain([total]).for_each(|(now, peak)| *peak = *now);
    }

    pub(super) fn all(&self) -> Vec<ArenaMemory> {
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
