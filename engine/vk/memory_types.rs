//! Chooses the memory type for each kind of memory.

use super::allocator::MemoryKind;
use ash::vk;

/// Location of device memory, as the host sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Host memory.
    Unified,
    /// Memory of a card, all of which the host can write (resizable BAR).
    Window,
    /// Memory of a card.
    Card,
}

impl Place {
    /// True if the host writes device memory directly.
    pub(super) fn is_mapped(self) -> bool {
        self != Self::Card
    }

    /// Returns the location for a card: [`Place::Window`] if the host sees all of its memory, not only a window of 256 MiB.
    pub(super) fn of_card(memory: &vk::PhysicalDeviceMemoryProperties) -> Self {
        const OLD_WINDOW: u64 = 256 << 20;
        type Flags = vk::MemoryPropertyFlags;
        let heaps = memory.memory_heaps_as_slice();
        let local = heaps.iter().filter(|heap| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        let largest = local.map(|heap| heap.size).max().unwrap_or(0);
        let seen = memory.memory_types_as_slice().iter().any(|of| {
            let flags = Flags::DEVICE_LOCAL | Flags::HOST_VISIBLE | Flags::HOST_COHERENT;
            let size = heaps.get(of.heap_index as usize).map_or(0, |heap| heap.size);
            of.property_flags.contains(flags)
                && !of.property_flags.intersects(SPECIAL)
                && size == largest
                && size > OLD_WINDOW
        });
        if seen { Self::Window } else { Self::Card }
    }
}

/// Flags of types that need special treatment.
const SPECIAL: vk::MemoryPropertyFlags = vk::MemoryPropertyFlags::from_raw(
    vk::MemoryPropertyFlags::PROTECTED.as_raw()
        | vk::MemoryPropertyFlags::LAZILY_ALLOCATED.as_raw()
        | vk::MemoryPropertyFlags::DEVICE_COHERENT_AMD.as_raw(),
);

/// Returns the best memory type for a kind: the first whose flags match a wish, wishes in order. Among types with the same
/// flags, the one in the largest heap.
pub(super) fn best(
    memory: &vk::PhysicalDeviceMemoryProperties,
    allowed: u32,
    kind: MemoryKind,
    place: Place,
) -> Option<u32> {
    type Flags = vk::MemoryPropertyFlags;
    let (types, heaps) = (memory.memory_types_as_slice(), memory.memory_heaps_as_slice());
    let coherent = Flags::HOST_VISIBLE | Flags::HOST_COHERENT;
    // (required flags, unwanted flags)
    let wishes = match (kind, place) {
        (MemoryKind::Device, Place::Unified) => vec![
            (Flags::DEVICE_LOCAL | coherent | Flags::HOST_CACHED, Flags::empty()),
            (Flags::DEVICE_LOCAL | coherent, Flags::empty()),
            (Flags::DEVICE_LOCAL, Flags::empty()),
            (Flags::empty(), Flags::empty()),
        ],
        (MemoryKind::Device, Place::Window) => vec![
            (Flags::DEVICE_LOCAL | coherent, Flags::empty()),
            (Flags::DEVICE_LOCAL, Flags::empty()),
            (Flags::empty(), Flags::empty()),
        ],
        (MemoryKind::Device, Place::Card) => vec![
            (Flags::DEVICE_LOCAL, Flags::HOST_VISIBLE),
            (Flags::DEVICE_LOCAL, Flags::empty()),
            (Flags::empty(), Flags::empty()),
        ],
        // All memory is host memory, so no type is better than the device's.
        (MemoryKind::Offloaded, Place::Unified) => return best(memory, allowed, MemoryKind::Device, place),
        (MemoryKind::Offloaded, _) => vec![
            (coherent | Flags::HOST_CACHED, Flags::DEVICE_LOCAL),
            (coherent, Flags::DEVICE_LOCAL),
            (Flags::empty(), Flags::DEVICE_LOCAL),
            // A processor that is treated as a card.
            (Flags::empty(), Flags::empty()),
        ],
        (MemoryKind::HostVisible, _) => vec![
            (coherent | Flags::HOST_CACHED, Flags::empty()),
            (coherent, Flags::DEVICE_LOCAL),
            (coherent, Flags::empty()),
        ],
    };
    let fits = |index: usize, with: Flags, without: Flags| {
        let flags = types[index].property_flags;
        allowed & (1 << index) != 0
            && flags.contains(with)
            && !flags.intersects(without)
            && !flags.intersects(SPECIAL)
    };
    let size = |index: usize| heaps.get(types[index].heap_index as usize).map_or(0, |heap| heap.size);
    let mut found = wishes.iter().filter_map(|&(with, without)| {
        // Reversed, because `max_by_key` returns the last maximum and the first type is wanted.
        (0..types.len()).rev().filter(|&i| fits(i, with, without)).max_by_key(|&i| {
            // A window of 256 MiB is too small for arenas; staging memory may be in any heap.
            if kind == MemoryKind::HostVisible { 0 } else { size(i) }
        })
    });
    found.next().map(|i| i as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use vk::MemoryPropertyFlags as Flags;

    const SEEN: Flags = Flags::from_raw(Flags::HOST_VISIBLE.as_raw() | Flags::HOST_COHERENT.as_raw());

    const CACHED: Flags = Flags::from_raw(SEEN.as_raw() | Flags::HOST_CACHED.as_raw());
    const LOCAL: Flags = Flags::DEVICE_LOCAL;

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

    fn of(flags: &[Flags], unified: bool) -> [Option<u32>; 2] {
        let place = if unified { Place::Unified } else { Place::Card };
        [MemoryKind::Device, MemoryKind::HostVisible].map(|kind| best(&types(flags), u32::MAX, kind, place))
    }

    /// Tables of cards as drivers report them (vulkan.gpuinfo.org), without types for images.
    #[test]
    fn all_of_a_cards_memory_is_written_directly_where_the_host_sees_it() {
        let chosen = |types: &[(Flags, u32)], heaps: &[(u64, bool)]| {
            let memory = memory(types, heaps);
            let place = Place::of_card(&memory);
            let kinds = [MemoryKind::Device, MemoryKind::HostVisible, MemoryKind::Offloaded];
            let [device, host, offloaded] = kinds.map(|kind| best(&memory, u32::MAX, kind, place));
            // Offloaded memory and read-back use the same cached host memory.
            assert_eq!(offloaded, host);
            (place, [device, host])
        };
        // NVIDIA, RTX 30 and later, without and with resizable BAR. The window is a separate heap, or absent.
        let nvidia = [(Flags::empty(), 1), (LOCAL, 0), (SEEN, 1), (CACHED, 1), (LOCAL | SEEN, 2)];
        let window = chosen(&nvidia, &[(24_576, true), (32_768, false), (246, true)]);
        assert_eq!(window, (Place::Card, [Some(1), Some(3)]));
        let whole = [(Flags::empty(), 1), (LOCAL, 0), (SEEN, 1), (CACHED, 1), (LOCAL | SEEN, 0)];
        assert_eq!(chosen(&whole, &[(24_576, true), (32_768, false)]), (Place::Window, [Some(4), Some(3)]));
        // AMD by Mesa: with the old window, and with all memory visible. Its coherent types come last.
        let amd =
            [(LOCAL, 0), (SEEN, 1), (LOCAL | SEEN, 2), (CACHED, 1), (LOCAL | Flags::DEVICE_COHERENT_AMD, 0)];
        let window = chosen(&amd, &[(7_936, true), (16_000, false), (256, true)]);
        assert_eq!(window, (Place::Card, [Some(0), Some(3)]));
        let whole = [(LOCAL, 0), (SEEN, 1), (LOCAL | SEEN, 0), (CACHED, 1)];
        assert_eq!(chosen(&whole, &[(16_368, true), (16_000, false)]), (Place::Window, [Some(2), Some(3)]));
        // Intel's Arc.
        let arc = [(LOCAL, 0), (SEEN, 1), (CACHED, 1), (LOCAL | SEEN, 0)];
        assert_eq!(chosen(&arc, &[(16_256, true), (31_900, false)]), (Place::Window, [Some(3), Some(2)]));
        // A card whose memory the host does not see.
        assert_eq!(chosen(&[(LOCAL, 0), (SEEN, 1)], &[(8_192, true), (8_192, false)]).0, Place::Card);
        // Memory that only special types expose does not count as visible.
        let special = [(LOCAL, 0), (LOCAL | SEEN | Flags::DEVICE_COHERENT_AMD, 0), (CACHED, 1)];
        assert_eq!(chosen(&special, &[(8_192, true), (8_192, false)]), (Place::Card, [Some(0), Some(2)]));
    }

    /// A card with a window of its memory on the bus: parameters stay where the host does not see them, read-back is
    /// cached.
    #[test]
    fn a_card_keeps_its_memory_and_reads_back_through_the_cache() {
        let card = [
            Flags::empty(),
            Flags::DEVICE_LOCAL,
            SEEN,
            SEEN | Flags::HOST_CACHED,
            Flags::DEVICE_LOCAL | SEEN,
            Flags::DEVICE_LOCAL | Flags::PROTECTED,
        ];
        assert_eq!(of(&card, false), [Some(1), Some(3)]);
        // Without such a window, and without cached memory.
        assert_eq!(of(&card[..3], false), [Some(1), Some(2)]);
        // All of the card's memory on the bus.
        assert_eq!(of(&[Flags::DEVICE_LOCAL | SEEN, SEEN], false), [Some(0), Some(1)]);
        // Offloaded memory leaves the card, even if the host cannot see it.
        let offloaded = |flags: &[Flags]| best(&types(flags), u32::MAX, MemoryKind::Offloaded, Place::Card);
        assert_eq!(offloaded(&card), Some(3));
        assert_eq!(offloaded(&[Flags::DEVICE_LOCAL, Flags::DEVICE_LOCAL | SEEN, Flags::empty()]), Some(2));
        assert_eq!(offloaded(&[Flags::DEVICE_LOCAL | SEEN]), Some(0));
    }

    #[test]
    fn unified_memory_is_cached_where_it_can_be() {
        let all = Flags::DEVICE_LOCAL | SEEN | Flags::HOST_CACHED;
        assert_eq!(of(&[Flags::DEVICE_LOCAL | SEEN, all], true), [Some(1), Some(1)]);
        assert_eq!(of(&[Flags::DEVICE_LOCAL, Flags::DEVICE_LOCAL | SEEN, SEEN], true), [Some(1), Some(2)]);
        assert_eq!(
            best(&types(&[LOCAL | SEEN, all]), u32::MAX, MemoryKind::Offloaded, Place::Unified),
            Some(1)
        );
        // A part of main memory belongs to the device, invisible to the host.
        assert_eq!(of(&[Flags::DEVICE_LOCAL, SEEN | Flags::HOST_CACHED], true), [Some(0), Some(1)]);
    }

    #[test]
    fn only_allowed_types_are_taken() {
        let two = types(&[Flags::DEVICE_LOCAL, Flags::DEVICE_LOCAL]);
        assert_eq!(best(&two, 0b10, MemoryKind::Device, Place::Card), Some(1));
        assert_eq!(best(&two, 0b11, MemoryKind::HostVisible, Place::Card), None);
        let special = types(&[Flags::DEVICE_LOCAL | Flags::DEVICE_COHERENT_AMD, Flags::empty()]);
        assert_eq!(best(&special, 0b11, MemoryKind::Device, Place::Card), Some(1));
    }
}
