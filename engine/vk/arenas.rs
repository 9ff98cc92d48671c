//! Current and peak bytes of each arena.

use super::allocator::MemoryKind;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

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

/// (current bytes, peak bytes).
type Amount = (u64, u64);

/// Bytes per arena and in total.
#[derive(Default)]
pub(super) struct Registry(Mutex<Amounts>);

#[derive(Default)]
struct Amounts {
    arenas: BTreeMap<Arc<str>, Amount>,
    /// Excludes offloaded memory.
    total: Amount,
    offloaded: Amount,
}

impl Amounts {
    /// Returns the amounts that memory of this arena and kind counts for.
    fn of(&mut self, arena: &Arc<str>, kind: MemoryKind) -> [&mut Amount; 2] {
        let all = if kind == MemoryKind::Offloaded { &mut self.offloaded } else { &mut self.total };
        [self.arenas.entry(arena.clone()).or_default(), all]
    }
}

impl Registry {
    fn lock(&self) -> MutexGuard<'_, Amounts> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn add(&self, arena: &Arc<str>, bytes: u64, kind: MemoryKind) {
        for (now, peak) in self.lock().of(arena, kind) {
            *now += bytes;
            *peak = (*now).max(*peak);
        }
    }

    pub(super) fn remove(&self, arena: &Arc<str>, bytes: u64, kind: MemoryKind) {
        for (now, _) in self.lock().of(arena, kind) {
            *now -= bytes;
        }
    }

    pub(super) fn reset_peaks(&self) {
        let Amounts { arenas, total, offloaded } = &mut *self.lock();
        // Living blocks have bytes in their arena, so this removes no arena of a living block.
        arenas.retain(|_, (now, _)| *now > 0);
        arenas.values_mut().chain([total, offloaded]).for_each(|(now, peak)| *peak = *now);
    }

    pub(super) fn all(&self) -> Vec<ArenaMemory> {
        self.lock().arenas.iter().map(|(name, amount)| memory(name, *amount)).collect()
    }

    /// Memory of all arenas, without offloaded memory.
    pub(super) fn total(&self) -> ArenaMemory {
        memory("total", self.lock().total)
    }

    /// Offloaded memory of all arenas.
    pub(super) fn offloaded(&self) -> ArenaMemory {
        memory("offloaded", self.lock().offloaded)
    }
}

fn memory(name: &str, (bytes, peak_bytes): Amount) -> ArenaMemory {
    ArenaMemory { name: name.into(), bytes, peak_bytes }
}
