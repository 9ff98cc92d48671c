//! Which of a device's memory types holds what.

use super::allocator::MemoryKind;
use ash::vk;

/// The best memory type for a kind: the first whose flags contain a wish, wishes in order.
pub(super) fn best(types: &[vk::MemoryType], allowed: u32, kind: MemoryKind, unified: bool) -> Option<u32> {
    type Flags = vk::MemoryPropertyFlags;
    let coherent = Flags::HOST_VISIBLE | Flags::HOST_COHERENT;
    // (required flags, unwanted flags)
    let wishes = match (kind, unified) {
        (MemoryKind::Device, true) => vec![
            (Flags::DEVICE_LOCAL | coherent | Flags::HOST_CACHED, Flags::empty()),
            (Flags::DEVICE_LOCAL | coherent, Flags::empty()),
            (Flags::DEVICE_LOCAL, Flags::empty()),
            (Flags::empty(), Flags::empty()),
        ],
        (MemoryKind::Device, false) => vec![
            (Flags::DEVICE_LOCAL, Flags::HOST_VISIBLE),
            (Flags::DEVICE_LOCAL, Flags::empty()),
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
            // Types that need special treatment.
            && !flags.intersects(Flags::PROTECTED | Flags::LAZILY_ALLOCATED | Flags::DEVICE_COHERENT_AMD)
    };
    let mut found =
        wishes.iter().filter_map(|&(with, without)| (0..types.len()).find(|&i| fits(i, with, without)));
    found.next().map(|i| i as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use vk::MemoryPropertyFlags as Flags;

    const SEEN: Flags = Flags::from_raw(Flags::HOST_VISIBLE.as_raw() | Flags::HOST_COHERENT.as_raw());

    fn types(flags: &[Flags]) -> Vec<vk::MemoryType> {
        flags.iter().map(|&property_flags| vk::MemoryType { property_flags, heap_index: 0 }).collect()
    }

    fn of(flags: &[Flags], unified: bool) -> [Option<u32>; 2] {
        [MemoryKind::Device, MemoryKind::HostVisible].map(|kind| best(&types(flags), u32::MAX, kind, unified))
    }

    /// A card with a window of its memory on the bus: parameters stay where the host does not see them, read-back is cached.
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
    }

    #[test]
    fn unified_memory_is_cached_where_it_can_be() {
        let all = Flags::DEVICE_LOCAL | SEEN | Flags::HOST_CACHED;
        assert_eq!(of(&[Flags::DEVICE_LOCAL | SEEN, all], true), [Some(1), Some(1)]);
        assert_eq!(of(&[Flags::DEVICE_LOCAL, Flags::DEVICE_LOCAL | SEEN, SEEN], true), [Some(1), Some(2)]);
        // A part of main memory is the device's, and the host does not see it.
        assert_eq!(of(&[Flags::DEVICE_LOCAL, SEEN | Flags::HOST_CACHED], true), [Some(0), Some(1)]);
    }

    #[test]
    fn only_allowed_types_are_taken() {
        let two = types(&[Flags::DEVICE_LOCAL, Flags::DEVICE_LOCAL]);
        assert_eq!(best(&two, 0b10, MemoryKind::Device, false), Some(1));
        assert_eq!(best(&two, 0b11, MemoryKind::HostVisible, false), None);
        let special = types(&[Flags::DEVICE_LOCAL | Flags::DEVICE_COHERENT_AMD, Flags::empty()]);
        assert_eq!(best(&special, 0b11, MemoryKind::Device, false), Some(1));
    }
}
