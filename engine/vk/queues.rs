//! Chooses the queue families for the engine's work.

use ash::vk;

/// Indices of queue families with compute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ComputeFamilies {
    /// For work without presentation. A family without graphics if there is one: its queue does not wait for other draws.
    pub(super) alone: u32,
    /// For work beside presentation to a screen.
    pub(super) presenting: u32,
    /// True if both have timestamps.
    pub(super) timed: bool,
    /// For copies only: its queue runs beside the others. None if there is no such family.
    pub(super) copying: Option<u32>,
}

/// Returns None without compute. Prefers families with timestamps.
pub(super) fn compute_families(families: &[vk::QueueFamilyProperties]) -> Option<ComputeFamilies> {
    let is_timed = |f: &vk::QueueFamilyProperties| f.timestamp_valid_bits > 0;
    let compute = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
    let timed = families.iter().any(|f| compute(f) && is_timed(f));
    let fits = |f: &vk::QueueFamilyProperties| compute(f) && (is_timed(f) || !timed);
    let presenting = families.iter().position(fits)?;
    let apart = |f: &vk::QueueFamilyProperties| fits(f) && !f.queue_flags.contains(vk::QueueFlags::GRAPHICS);
    let alone = families.iter().position(apart).unwrap_or(presenting);
    // Video families can copy too, but have another purpose.
    let copies = vk::QueueFlags::TRANSFER | vk::QueueFlags::SPARSE_BINDING | vk::QueueFlags::PROTECTED;
    let only_copies = |f: &vk::QueueFamilyProperties| {
        f.queue_flags.contains(vk::QueueFlags::TRANSFER) && copies.contains(f.queue_flags)
    };
    let copying = families.iter().position(only_copies).map(|index| index as u32);
    Some(ComputeFamilies { alone: alone as u32, presenting: presenting as u32, timed, copying })
}

#[cfg(test)]
mod tests {
    use super::*;
    use vk::QueueFlags as Flags;

    fn of(families: &[(Flags, u32)]) -> Option<(u32, u32, bool)> {
        let family = |&(queue_flags, timestamp_valid_bits)| vk::QueueFamilyProperties {
            queue_flags,
            timestamp_valid_bits,
            queue_count: 1,
            ..vk::QueueFamilyProperties::default()
        };
        let found = compute_families(&families.iter().map(family).collect::<Vec<_>>())?;
        Some((found.alone, found.presenting, found.timed))
    }

    #[test]
    fn copies_have_a_family_that_does_nothing_else() {
        let all = Flags::GRAPHICS | Flags::COMPUTE | Flags::TRANSFER | Flags::SPARSE_BINDING;
        let copies = Flags::TRANSFER | Flags::SPARSE_BINDING;
        let films = Flags::TRANSFER | Flags::SPARSE_BINDING | Flags::VIDEO_DECODE_KHR;
        let found = |flags: &[Flags]| {
            let family = |&queue_flags| vk::QueueFamilyProperties {
                queue_flags,
                queue_count: 1,
                ..vk::QueueFamilyProperties::default()
            };
            compute_families(&flags.iter().map(family).collect::<Vec<_>>()).and_then(|found| found.copying)
        };
        // NVIDIA's order, AMD's order, and cards without a copy family.
        assert_eq!(found(&[all, copies, Flags::COMPUTE | copies, films]), Some(1));
        assert_eq!(found(&[all, Flags::COMPUTE | copies, films, copies]), Some(3));
        assert_eq!(found(&[all, Flags::COMPUTE | copies, films]), None);
    }

    #[test]
    fn families_without_graphics_come_first_for_work_alone() {
        let all = Flags::GRAPHICS | Flags::COMPUTE | Flags::TRANSFER;
        let apart = Flags::COMPUTE | Flags::TRANSFER;
        // Orders of real cards, one with a copy family before the compute family.
        assert_eq!(of(&[(all, 64), (Flags::TRANSFER, 64), (apart, 64)]), Some((2, 0, true)));
        assert_eq!(of(&[(all, 64), (apart, 64)]), Some((1, 0, true)));
        // One family for everything.
        assert_eq!(of(&[(all, 36)]), Some((0, 0, true)));
        // Timestamps are preferred to a separate queue.
        assert_eq!(of(&[(all, 36), (apart, 0)]), Some((0, 0, true)));
        assert_eq!(of(&[(all, 0), (apart, 0)]), Some((1, 0, false)));
        assert_eq!(of(&[(Flags::TRANSFER, 64), (Flags::GRAPHICS, 64)]), None);
    }
}
