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

/// Current and peak bytes.
type Amount = (u64, u64);

/// Bytes per arena and in total.
#[derive(Default)]
pub(super) struct Registry(Mutex<Amounts>);

#[derive(Default)]
struct Amounts {
    arenas: BTreeMap<Arc<str>, Amount>,
    /// Without what is offloaded.
    total: Amount,
    offloaded: Amount,
}

impl Amounts {
    /// The amounts that memory of an arena and a kind counts for.
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
        // Living blocks have bytes in their arena, so no arena is removed that a block still needs.
        arenas.retain(|_, (now, _)| *now > 0);
        arenas.values_mut().chain([total, offloaded]).for_each(|(now, peak)| *peak = *now);
    }

    pub(super) fn all(&self) -> Vec<ArenaMemory> {
        self.lock().arenas.iter().map(|(name, amount)| memory(name, *amount)).collect()
    }

    /// All arenas together, without what is offloaded.
    pub(super) fn total(&self) -> ArenaMemory {
        memory("total", self.lock().total)
    }

    /// What is offloaded, of all arenas.
    pub(super) fn offloaded(&self) -> ArenaMemory {
        memory("offloaded", self.lock().offloaded)
    }
}

fn memory(name: &str, (bytes, peak_bytes): Amount) -> ArenaMemory {
    ArenaMemory { name: name.into(), bytes, peak_bytes }
}
