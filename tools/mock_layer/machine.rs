//! The devices that the layer can imitate.

use ash::vk;

/// Environment variable with a machine's name.
pub const VARIABLE: &str = "ASHSPLAT_MOCK";

type Flags = vk::MemoryPropertyFlags;

const LOCAL: Flags = Flags::DEVICE_LOCAL;
const SEEN: Flags = both(Flags::HOST_VISIBLE, Flags::HOST_COHERENT);
const CACHED: Flags = both(SEEN, Flags::HOST_CACHED);

const fn both(a: Flags, b: Flags) -> Flags {
    Flags::from_raw(a.as_raw() | b.as_raw())
}

/// Size in bytes, and true if it is device-local.
pub(crate) type Heap = (u64, bool);
/// Property flags, index of the heap.
pub(crate) type Type = (Flags, u32);

/// Environment variable that names queues whose submissions wait for no semaphore: a fault that tests must find.
pub const FORGETTING: &str = "ASHSPLAT_MOCK_FORGETS_WAITS";

/// Which queues are late, those for copies or the others. A machine with one family has no late queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LateQueues {
    Copies,
    Others,
}

/// A device that the layer imitates.
#[derive(Debug)]
pub struct Machine {
    /// Its name in `ASHSPLAT_MOCK`.
    pub name: &'static str,
    pub(crate) device_type: vk::PhysicalDeviceType,
    pub(crate) heaps: &'static [Heap],
    pub(crate) types: &'static [Type],
    pub(crate) families: &'static [vk::QueueFlags],
    /// Queues whose submissions are held back until needed.
    pub(crate) late: LateQueues,
    /// True if the limits are the least that the engine accepts, mostly the specification's minimum.
    pub(crate) small: bool,
}

const LARGE: u64 = 8 << 30;
/// Part of a card's memory that a processor sees without resizable BAR.
const WINDOW: u64 = 256 << 20;

const CARD: [Heap; 2] = [(LARGE, true), (LARGE, false)];
const CARD_TYPES: [Type; 4] = [(Flags::empty(), 1), (LOCAL, 0), (SEEN, 1), (CACHED, 1)];
const ALL: vk::QueueFlags = vk::QueueFlags::from_raw(
    vk::QueueFlags::GRAPHICS.as_raw() | vk::QueueFlags::COMPUTE.as_raw() | vk::QueueFlags::TRANSFER.as_raw(),
);
const APART: vk::QueueFlags =
    vk::QueueFlags::from_raw(vk::QueueFlags::COMPUTE.as_raw() | vk::QueueFlags::TRANSFER.as_raw());

const DISCRETE: Machine = Machine {
    name: "discrete",
    device_type: vk::PhysicalDeviceType::DISCRETE_GPU,
    heaps: &CARD,
    types: &CARD_TYPES,
    families: &[ALL],
    late: LateQueues::Copies,
    small: false,
};

const QUEUES: Machine =
    Machine { name: "transfer-queue", families: &[ALL, vk::QueueFlags::TRANSFER, APART], ..DISCRETE };

const UNIFIED: Machine = Machine {
    name: "unified",
    device_type: vk::PhysicalDeviceType::INTEGRATED_GPU,
    heaps: &[(LARGE, true)],
    types: &[(both(LOCAL, SEEN), 0), (both(LOCAL, CACHED), 0)],
    ..DISCRETE
};

/// All machines.
pub const MACHINES: &[Machine] = &[
    // A card with memory that no processor sees.
    DISCRETE,
    // A card with a window of 256 MiB, which is a separate heap.
    Machine {
        name: "discrete-window",
        heaps: &[CARD[0], CARD[1], (WINDOW, true)],
        types: &[(LOCAL, 0), (SEEN, 1), (CACHED, 1), (both(LOCAL, SEEN), 2)],
        ..DISCRETE
    },
    // A card whose memory the processor sees in full, with a queue for copies.
    Machine {
        name: "discrete-rebar",
        types: &[(LOCAL, 0), (SEEN, 1), (both(LOCAL, SEEN), 0), (CACHED, 1)],
        ..QUEUES
    },
    // Memory shared by both, in a cached and an uncached type.
    UNIFIED,
    // The same, but uncached: the processor reads it word by word.
    Machine { name: "unified-uncached", types: &[(both(LOCAL, SEEN), 0)], ..UNIFIED },
    // A card with queues for copies and for compute besides the main one. Submissions to the copy queue run as late as
    // possible.
    QUEUES,
    // The same, but submissions to the other queues run as late as possible.
    Machine { name: "transfer-queue-main-late", late: LateQueues::Others, ..QUEUES },
    // Workgroups of 256, 16 KiB of shared memory, 128 bytes of push constants.
    Machine { name: "small-limits", small: true, ..DISCRETE },
];

impl Machine {
    /// The machine of this name.
    pub fn of(name: &str) -> Option<&'static Machine> {
        MACHINES.iter().find(|machine| machine.name == name)
    }

    /// The machine that the environment names.
    ///
    /// # Panics
    /// For an unknown name: a test without a machine would prove nothing.
    pub(crate) fn requested() -> &'static Machine {
        let name = std::env::var(VARIABLE).unwrap_or_default();
        Self::of(&name).unwrap_or_else(|| {
            let names: Vec<_> = MACHINES.iter().map(|machine| machine.name).collect();
            panic!("{VARIABLE}='{name}' is none of {}", names.join(", "))
        })
    }

    pub(crate) fn type_bits(&self) -> u32 {
        (1 << self.types.len()) - 1
    }

    /// True for a family whose queues only copy.
    fn copies(&self, family: u32) -> bool {
        self.families.get(family as usize) == Some(&vk::QueueFlags::TRANSFER)
    }

    /// True if submissions to queues of this family are held back until needed.
    pub(crate) fn holds(&self, family: u32) -> bool {
        self.families.contains(&vk::QueueFlags::TRANSFER)
            && self.copies(family) == (self.late == LateQueues::Copies)
    }

    /// True if submissions to queues of this family ignore their waits, by [`FORGETTING`].
    ///
    /// # Panics
    /// For an unknown kind of queues.
    pub(crate) fn forgets(&self, family: u32) -> bool {
        match std::env::var(FORGETTING).as_deref() {
            Err(_) => false,
            Ok("copies") => self.copies(family),
            Ok("others") => !self.copies(family),
            Ok(other) => panic!("{FORGETTING}='{other}' is neither 'copies' nor 'others'"),
        }
    }

    /// Changes the driver's description of itself.
    pub(crate) fn describe(&self, properties: &mut vk::PhysicalDeviceProperties) {
        properties.device_type = self.device_type;
        let driver = properties.device_name_as_c_str().unwrap_or_default().to_string_lossy().into_owned();
        let name = format!("{} mock of {driver}", self.name);
        let room = properties.device_name.len() - 1;
        properties.device_name.fill(0);
        for (to, from) in properties.device_name.iter_mut().zip(name.bytes().take(room)) {
            *to = from as std::ffi::c_char;
        }
        let limits = &mut properties.limits;
        // Software drivers say 128 MiB and take more.
        limits.max_storage_buffer_range = u32::MAX;
        if !self.small {
            return;
        }
        let sizes = limits.max_compute_work_group_size;
        limits.max_compute_work_group_size = [sizes[0].min(256), sizes[1].min(256), sizes[2].min(64)];
        let cap = |limit: &mut u32, cap: u32| *limit = (*limit).min(cap);
        cap(&mut limits.max_compute_work_group_invocations, 256);
        cap(&mut limits.max_compute_shared_memory_size, 16 << 10);
        cap(&mut limits.max_push_constants_size, 128);
        cap(&mut limits.max_storage_buffer_range, 1 << 27);
        cap(&mut limits.max_uniform_buffer_range, 16 << 10);
        cap(&mut limits.max_texel_buffer_elements, 1 << 16);
        cap(&mut limits.max_memory_allocation_count, 4096);
        limits.max_compute_work_group_count = limits.max_compute_work_group_count.map(|n| n.min(65_535));
        let coarse = |alignment: &mut u64| *alignment = (*alignment).max(256);
        coarse(&mut limits.min_storage_buffer_offset_alignment);
        coarse(&mut limits.min_uniform_buffer_offset_alignment);
        coarse(&mut limits.min_texel_buffer_offset_alignment);
    }
}
