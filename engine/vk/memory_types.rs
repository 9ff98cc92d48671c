//! Kinds of device memory, their memory types, a host's allocator, and the bytes of each arena.

use super::lock::lock;
use ash::vk::{self, MemoryPropertyFlags as Flags};
use std::collections::BTreeMap;
use std::ptr::NonNull;
use std::sync::Mutex;

/// Kind of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryKind {
    /// Fastest for kernels. Filled by [`Context::upload`](super::Context::upload), read by
    /// [`Context::download`](super::Context::download).
    Device,
    /// Mapped, coherent and, where possible, cached: [`Buffer::write`](super::Buffer::write) and
    /// [`Buffer::read`](super::Buffer::read).
    HostVisible,
    /// The host's memory, which kernels reach over the bus. Holds data that does not fit into device memory. Uploads and
    /// downloads work as for [`MemoryKind::Device`]. It counts for
    /// [`ContextOptions::offload`](super::ContextOptions::offload) and not for
    /// [`ContextOptions::max_memory`](super::ContextOptions::max_memory).
    Offloaded,
}

/// A request to a host's allocator.
#[derive(Clone, Copy, Debug)]
pub struct MemoryRequest<'a> {
    /// Name of the block, for debugging.
    pub name: &'a str,
    /// Size, alignment and allowed memory types of the buffer.
    pub requirements: vk::MemoryRequirements,
    /// How the memory is used. [`MemoryKind::HostVisible`] must be mapped.
    pub kind: MemoryKind,
}

/// A piece of device memory.
#[derive(Clone, Copy, Debug)]
pub struct HostMemory {
    /// The memory object.
    pub memory: vk::DeviceMemory,
    /// Byte offset of the piece in the memory object.
    pub offset: u64,
    /// Host address of the piece, if it is mapped.
    pub mapped: Option<NonNull<u8>>,
    /// An identifier for the allocator's own use.
    pub id: u64,
}

// SAFETY: an address of mapped device memory is valid on every thread; the engine orders accesses to it.
unsafe impl Send for HostMemory {}
// SAFETY: as above; a shared reference gives no access to the memory.
unsafe impl Sync for HostMemory {}

/// A host's allocator, which provides the memory of all buffers of a context: see [`super::ForeignDevice::allocator`].
///
/// Operations that allocate call it ([`super::Context::allocate`], uploads, `Renderer::reserve`); recording a frame never
/// does. It is also called when the last owner of a buffer is dropped, on the thread of that drop. A slot owns the buffers
/// of its last recording, until it is recorded again or released ([`super::RecordSlot::release`]).
///
/// # Safety
/// - [`HostAllocator::allocate`] returns memory of the context's device, of a requested type, with the requested size and
///   alignment;
/// - the piece has no other user before it is freed;
/// - if the piece is mapped, it is mapped at the given address until it is freed, and the memory type is
///   host-coherent.
pub unsafe trait HostAllocator: Send + Sync {
    /// Allocates a piece of memory.
    ///
    /// # Errors
    /// The reason, in one line.
    fn allocate(&self, request: &MemoryRequest<'_>) -> Result<HostMemory, String>;

    /// Frees a piece that is not in use any more.
    fn free(&self, memory: HostMemory);
}

/// Location of device memory, as the host sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Location {
    /// Host memory.
    Unified,
    /// Memory of a card, all of which the host can write (resizable BAR).
    Window,
    /// Memory of a card.
    Card,
}

impl Location {
    /// True if the host writes device memory directly.
    pub(super) fn is_mapped(self) -> bool {
        self != Self::Card
    }

    /// Returns the location for a card: [`Location::Window`] if the host sees all of its memory, not only a window of 256 MiB.
    pub(super) fn of_card(memory: &vk::PhysicalDeviceMemoryProperties) -> Self {
        const OLD_WINDOW: u64 = 256 << 20;
        let heaps = memory.memory_heaps_as_slice();
        let local = heaps.iter().filter(|heap| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        let largest = local.map(|heap| heap.size).max().unwrap_or(0);
        let sees_all = memory.memory_types_as_slice().iter().any(|of| {
            let size = heaps.get(of.heap_index as usize).map_or(0, |heap| heap.size);
            of.property_flags.contains(Flags::DEVICE_LOCAL | MAPPABLE)
                && !of.property_flags.intersects(SPECIAL)
                && size == largest
                && size > OLD_WINDOW
        });
        if sees_all { Self::Window } else { Self::Card }
    }
}

/// Flags of a memory type that is mapped, and needs no flushes.
pub(super) const MAPPABLE: Flags =
    Flags::from_raw(Flags::HOST_VISIBLE.as_raw() | Flags::HOST_COHERENT.as_raw());

/// Memory types with any of these flags are never chosen.
const SPECIAL: Flags = Flags::from_raw(
    Flags::PROTECTED.as_raw() | Flags::LAZILY_ALLOCATED.as_raw() | Flags::DEVICE_COHERENT_AMD.as_raw(),
);

/// Returns the best memory type for a kind: the first that has one of the preferred sets of flags, in order of preference.
/// Among types with the same flags, the one in the largest heap.
pub(super) fn best(
    memory: &vk::PhysicalDeviceMemoryProperties,
    allowed: u32,
    kind: MemoryKind,
    place: Location,
) -> Option<u32> {
    let (types, heaps) = (memory.memory_types_as_slice(), memory.memory_heaps_as_slice());
    let (none, local, cached) = (Flags::empty(), Flags::DEVICE_LOCAL, MAPPABLE | Flags::HOST_CACHED);
    // (required flags, unwanted flags)
    let choices = match (kind, place) {
        (MemoryKind::Device, Location::Unified) => {
            vec![(local | cached, none), (local | MAPPABLE, none), (local, none), (none, none)]
        }
        (MemoryKind::Device, Location::Window) => {
            vec![(local | MAPPABLE, none), (local, none), (none, none)]
        }
        (MemoryKind::Device, Location::Card) => {
            vec![(local, Flags::HOST_VISIBLE), (local, none), (none, none)]
        }
        // All memory is host memory, so no type is better than the device's.
        (MemoryKind::Offloaded, Location::Unified) => {
            return best(memory, allowed, MemoryKind::Device, place);
        }
        // The last wish is for a processor that is treated as a card.
        (MemoryKind::Offloaded, _) => vec![(cached, local), (MAPPABLE, local), (none, local), (none, none)],
        (MemoryKind::HostVisible, _) => vec![(cached, none), (MAPPABLE, local), (MAPPABLE, none)],
    };
    let fits = |index: usize, with: Flags, without: Flags| {
        let flags = types[index].property_flags;
        allowed & (1 << index) != 0
            && flags.contains(with)
            && !flags.intersects(without)
            && !flags.intersects(SPECIAL)
    };
    let size = |index: usize| heaps.get(types[index].heap_index as usize).map_or(0, |heap| heap.size);
    let mut found = choices.iter().filter_map(|&(with, without)| {
        // Reversed, because `max_by_key` returns the last maximum and the first type is wanted.
        (0..types.len()).rev().filter(|&i| fits(i, with, without)).max_by_key(|&i| {
            // A window of 256 MiB is too small for arenas; staging memory may be in any heap.
            if kind == MemoryKind::HostVisible { 0 } else { size(i) }
        })
    });
    found.next().map(|i| i as u32)
}

/// Memory of one arena.
#[derive(Clone, Debug, PartialEq)]
pub struct ArenaMemory {
    /// The arena's name.
    pub name: &'static str,
    /// Allocated now.
    pub bytes: u64,
    /// Peak of the allocated bytes.
    pub peak_bytes: u64,
}

/// (current bytes, peak bytes).
type Amount = (u64, u64);

#[derive(Default)]
pub(super) struct Registry(Mutex<Amounts>);

#[derive(Default)]
struct Amounts {
    arenas: BTreeMap<&'static str, Amount>,
    /// Excludes offloaded memory.
    total: Amount,
    offloaded: Amount,
}

impl Amounts {
    /// Returns the totals to which memory of this arena and kind is added: the arena's, and the device's or the offloaded
    /// memory's.
    fn of(&mut self, arena: &'static str, kind: MemoryKind) -> [&mut Amount; 2] {
        let all = if kind == MemoryKind::Offloaded { &mut self.offloaded } else { &mut self.total };
        [self.arenas.entry(arena).or_default(), all]
    }
}

impl Registry {
    pub(super) fn add(&self, arena: &'static str, bytes: u64, kind: MemoryKind) {
        for (now, peak) in lock(&self.0).of(arena, kind) {
            *now += bytes;
            *peak = (*now).max(*peak);
        }
    }

    pub(super) fn remove(&self, arena: &'static str, bytes: u64, kind: MemoryKind) {
        for (now, _) in lock(&self.0).of(arena, kind) {
            *now -= bytes;
        }
    }

    pub(super) fn reset_peaks(&self) {
        let Amounts { arenas, total, offloaded } = &mut *lock(&self.0);
        // Living blocks have bytes in their arena, so this removes no arena of a living block.
        arenas.retain(|_, (now, _)| *now > 0);
        arenas.values_mut().chain([total, offloaded]).for_each(|(now, peak)| *peak = *now);
    }

    pub(super) fn all(&self) -> Vec<ArenaMemory> {
        lock(&self.0).arenas.iter().map(|(name, amount)| memory(name, *amount)).collect()
    }

    /// Memory of all arenas, without offloaded memory.
    pub(super) fn total(&self) -> ArenaMemory {
        memory("total", lock(&self.0).total)
    }

    pub(super) fn offloaded(&self) -> ArenaMemory {
        memory("offloaded", lock(&self.0).offloaded)
    }
}

fn memory(name: &'static str, (bytes, peak_bytes): Amount) -> ArenaMemory {
    ArenaMemory { name, bytes, peak_bytes }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: Flags = Flags::empty();
    const SEEN: Flags = MAPPABLE;
    const CACHED: Flags = Flags::from_raw(SEEN.as_raw() | Flags::HOST_CACHED.as_raw());
    const LOCAL: Flags = Flags::DEVICE_LOCAL;
    const SPECIAL: Flags = Flags::DEVICE_COHERENT_AMD;

    /// Builds a table of types with their heaps. Heaps are (MiB, true if device-local).
    fn memory(types: &[(Flags, u32)], heaps: &[(u64, bool)]) -> vk::PhysicalDeviceMemoryProperties {
        let mut memory = vk::PhysicalDeviceMemoryProperties::default();
        (memory.memory_type_count, memory.memory_heap_count) = (types.len() as u32, heaps.len() as u32);
        for (to, &(property_flags, heap_index)) in memory.memory_types.iter_mut().zip(types) {
            *to = vk::MemoryType { property_flags, heap_index };
        }
        for (to, &(mib, local)) in memory.memory_heaps.iter_mut().zip(heaps) {
            let flags = if local { vk::MemoryHeapFlags::DEVICE_LOCAL } else { vk::MemoryHeapFlags::empty() };
            *to = vk::MemoryHeap { size: mib << 20, flags };
        }
        memory
    }

    fn types(flags: &[Flags]) -> vk::PhysicalDeviceMemoryProperties {
        memory(&flags.iter().map(|&flags| (flags, 0)).collect::<Vec<_>>(), &[(0, true)])
    }

    fn of(flags: &[Flags], place: Location) -> [Option<u32>; 2] {
        [MemoryKind::Device, MemoryKind::HostVisible].map(|kind| best(&types(flags), u32::MAX, kind, place))
    }

    fn offloaded(flags: &[Flags], place: Location) -> Option<u32> {
        best(&types(flags), u32::MAX, MemoryKind::Offloaded, place)
    }

    /// Tables of cards as drivers report them (vulkan.gpuinfo.org), without types for images.
    #[test]
    fn all_of_a_cards_memory_is_written_directly_where_the_host_sees_it() {
        let check = |card: &str, types: &[(Flags, u32)], heaps: &[(u64, bool)], place, chosen: [u32; 2]| {
            let memory = memory(types, heaps);
            assert_eq!(Location::of_card(&memory), place, "{card}");
            let kinds = [MemoryKind::Device, MemoryKind::HostVisible, MemoryKind::Offloaded];
            // Offloaded memory and read-back use the same cached host memory.
            let expected = [chosen[0], chosen[1], chosen[1]].map(Some);
            assert_eq!(kinds.map(|kind| best(&memory, u32::MAX, kind, place)), expected, "{card}");
        };
        let nvidia = |window| [(NONE, 1), (LOCAL, 0), (SEEN, 1), (CACHED, 1), (LOCAL | SEEN, window)];
        let heaps = [(24_576, true), (32_768, false), (246, true)];
        check("NVIDIA, RTX 30 and later, the window is a heap", &nvidia(2), &heaps, Location::Card, [1, 3]);
        check("NVIDIA with resizable BAR", &nvidia(0), &heaps[..2], Location::Window, [4, 3]);
        // Coherent types of AMD by Mesa come last.
        let amd = [(LOCAL, 0), (SEEN, 1), (LOCAL | SEEN, 2), (CACHED, 1), (LOCAL | SPECIAL, 0)];
        let heaps = [(7_936, true), (16_000, false), (256, true)];
        check("AMD with the old window", &amd, &heaps, Location::Card, [0, 3]);
        let amd = [(LOCAL, 0), (SEEN, 1), (LOCAL | SEEN, 0), (CACHED, 1)];
        check("AMD, all visible", &amd, &[(16_368, true), (16_000, false)], Location::Window, [2, 3]);
        let arc = [(LOCAL, 0), (SEEN, 1), (CACHED, 1), (LOCAL | SEEN, 0)];
        check("Intel's Arc", &arc, &[(16_256, true), (31_900, false)], Location::Window, [3, 2]);
        let hidden = [(LOCAL, 0), (SEEN, 1)];
        check("the host does not see it", &hidden, &[(8_192, true), (8_192, false)], Location::Card, [0, 1]);
        let special = [(LOCAL, 0), (LOCAL | SEEN | SPECIAL, 0), (CACHED, 1)];
        let heaps = [(8_192, true), (8_192, false)];
        check("only special types expose it", &special, &heaps, Location::Card, [0, 2]);
    }

    /// A card with a window of its memory on the bus: parameters stay where the host does not see them, read-back is
    /// cached.
    #[test]
    fn a_card_keeps_its_memory_and_reads_back_through_the_cache() {
        let card = [NONE, LOCAL, SEEN, CACHED, LOCAL | SEEN, LOCAL | Flags::PROTECTED];
        assert_eq!(of(&card, Location::Card), [Some(1), Some(3)]);
        // Without such a window, and without cached memory.
        assert_eq!(of(&card[..3], Location::Card), [Some(1), Some(2)]);
        // All of the card's memory on the bus.
        assert_eq!(of(&[LOCAL | SEEN, SEEN], Location::Card), [Some(0), Some(1)]);
        // Offloaded memory leaves the card, even if the host cannot see it.
        assert_eq!(offloaded(&card, Location::Card), Some(3));
        assert_eq!(offloaded(&[LOCAL, LOCAL | SEEN, NONE], Location::Card), Some(2));
        assert_eq!(offloaded(&[LOCAL | SEEN], Location::Card), Some(0));
    }

    #[test]
    fn unified_memory_is_cached_where_it_can_be() {
        let seen = [LOCAL | SEEN, LOCAL | CACHED];
        assert_eq!(of(&seen, Location::Unified), [Some(1), Some(1)]);
        assert_eq!(offloaded(&seen, Location::Unified), Some(1));
        assert_eq!(of(&[LOCAL, LOCAL | SEEN, SEEN], Location::Unified), [Some(1), Some(2)]);
        // A part of main memory belongs to the device, invisible to the host.
        assert_eq!(of(&[LOCAL, CACHED], Location::Unified), [Some(0), Some(1)]);
    }

    #[test]
    fn only_allowed_types_are_taken() {
        let two = types(&[LOCAL, LOCAL]);
        assert_eq!(best(&two, 0b10, MemoryKind::Device, Location::Card), Some(1));
        assert_eq!(best(&two, 0b11, MemoryKind::HostVisible, Location::Card), None);
        let special = types(&[LOCAL | SPECIAL, NONE]);
        assert_eq!(best(&special, 0b11, MemoryKind::Device, Location::Card), Some(1));
    }
}
