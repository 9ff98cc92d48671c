//! The layer in raw Vulkan: what it refuses, and that it reveals a missing semaphore in either direction, which the driver's one
//! queue would hide.
#![cfg(target_os = "linux")]

use ash::vk;
use std::path::Path;
use std::process::{Command, Stdio};

const WORDS: u64 = 64;
const OLD: u32 = 0xFFFF_FFFF;
const NEW: u32 = 0x0BAD_CAFE;

const SEEN: vk::MemoryPropertyFlags = vk::MemoryPropertyFlags::from_raw(
    vk::MemoryPropertyFlags::HOST_VISIBLE.as_raw() | vk::MemoryPropertyFlags::HOST_COHERENT.as_raw(),
);

const MAIN: usize = 0;
const COPIES: usize = 1;

#[test]
fn the_layer_claims_a_card_and_holds_copies_or_the_main_queue_back() {
    let executable = std::env::current_exe().expect("a path");
    for machine in ["transfer-queue", "transfer-queue-main-late"] {
        let output = Command::new(&executable)
            .args(["in_a_child", "--include-ignored", "--nocapture"])
            .stdin(Stdio::null())
            .env("LD_LIBRARY_PATH", executable.parent().expect("deps"))
            .env("VK_ADD_LAYER_PATH", Path::new(env!("CARGO_MANIFEST_DIR")))
            .env("VK_INSTANCE_LAYERS", "VK_LAYER_ASHSPLAT_mock")
            .env(ashsplat_mock_layer::VARIABLE, machine)
            .output()
            .expect("the test binary runs");
        let text = String::from_utf8_lossy(&output.stdout);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && text.contains("1 passed"), "{machine}: {text}{errors}");
    }
}

/// A timeline semaphore with a value.
type Point = (vk::Semaphore, u64);

struct Gpu {
    device: ash::Device,
    memory: vk::PhysicalDeviceMemoryProperties,
    pools: [vk::CommandPool; 2],
    queues: [vk::Queue; 2],
}

impl Gpu {
    /// A buffer in memory with these flags; host-visible only if they say so.
    fn buffer(&self, flags: vk::MemoryPropertyFlags) -> (vk::Buffer, vk::DeviceMemory) {
        let seen = vk::MemoryPropertyFlags::HOST_VISIBLE;
        let fits = |of: &vk::MemoryType| {
            of.property_flags.contains(flags) && (of.property_flags & seen) == (flags & seen)
        };
        let index = self.memory.memory_types_as_slice().iter().position(fits).expect("a type") as u32;
        let usage = vk::BufferUsageFlags::TRANSFER_SRC | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(WORDS * 4).usage(usage);
        // SAFETY: valid descriptions; the buffer is bound once.
        unsafe {
            let buffer = self.device.create_buffer(&info, None).expect("a buffer");
            let needs = self.device.get_buffer_memory_requirements(buffer);
            assert!(needs.memory_type_bits & (1 << index) != 0);
            let info = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(index);
            let memory = self.device.allocate_memory(&info, None).expect("memory");
            self.device.bind_buffer_memory(buffer, memory, 0).expect("bound");
            (buffer, memory)
        }
    }

    unsafe fn map(&self, memory: vk::DeviceMemory) -> ash::prelude::VkResult<*mut u32> {
        let flags = vk::MemoryMapFlags::empty();
        // SAFETY: memory of this device, as the caller promises.
        let address = unsafe { self.device.map_memory(memory, 0, vk::WHOLE_SIZE, flags) };
        address.map(|address| address.cast())
    }

    /// A command buffer for one of the queues that fills a buffer.
    fn fill(&self, queue: usize, buffer: vk::Buffer) -> vk::CommandBuffer {
        // SAFETY: recording state, a buffer of this size.
        self.record(queue, |commands| unsafe {
            self.device.cmd_fill_buffer(commands, buffer, 0, WORDS * 4, NEW);
        })
    }

    /// Records commands for one of the queues.
    fn record(&self, queue: usize, record: impl FnOnce(vk::CommandBuffer)) -> vk::CommandBuffer {
        let info =
            vk::CommandBufferAllocateInfo::default().command_pool(self.pools[queue]).command_buffer_count(1);
        // SAFETY: a new command buffer, which `record` records into.
        unsafe {
            let commands = self.device.allocate_command_buffers(&info).expect("commands")[0];
            self.device
                .begin_command_buffer(commands, &vk::CommandBufferBeginInfo::default())
                .expect("begun");
            record(commands);
            self.device.end_command_buffer(commands).expect("ended");
            commands
        }
    }

    fn submit(&self, queue: usize, commands: vk::CommandBuffer, [wait, signal]: [Option<Point>; 2]) {
        let info = |(semaphore, value)| {
            vk::SemaphoreSubmitInfo::default()
                .semaphore(semaphore)
                .value(value)
                .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
        };
        let (wait, signal) = (wait.map(info), signal.map(info));
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let submit = vk::SubmitInfo2::default()
            .command_buffer_infos(&buffers)
            .wait_semaphore_infos(wait.as_slice())
            .signal_semaphore_infos(signal.as_slice());
        // SAFETY: recorded for a queue of this family; nothing else uses the queue.
        unsafe { self.device.queue_submit2(self.queues[queue], &[submit], vk::Fence::null()) }
            .expect("submitted");
    }

    /// One queue reads a buffer that the other fills; returns the word read. `point` orders them; the signal may come first or last.
    fn fill_and_read(&self, writer: usize, signal_first: bool, point: Option<Point>) -> u32 {
        let local = vk::MemoryPropertyFlags::DEVICE_LOCAL;
        let ((filled, hidden), (read, memory)) = (self.buffer(local), self.buffer(SEEN));
        // SAFETY: memory that the host cannot see: the layer refuses, and nothing is mapped.
        let mapped = unsafe { self.map(hidden) };
        assert_eq!(mapped.err(), Some(vk::Result::ERROR_MEMORY_MAP_FAILED));
        let fill = self.fill(writer, filled);
        // SAFETY: recording state, buffers of this size.
        let copy = self.record(1 - writer, |commands| unsafe {
            let region = vk::BufferCopy::default().size(WORDS * 4);
            self.device.cmd_copy_buffer(commands, filled, read, &[region]);
        });
        let submissions = [(writer, fill, [None, point]), (1 - writer, copy, [point, None])];
        let order = if signal_first { [0, 1] } else { [1, 0] };
        for (queue, commands, points) in order.map(|at| submissions[at]) {
            self.submit(queue, commands, points);
        }
        // SAFETY: the device is idle; host-visible memory of this size, mapped once.
        unsafe {
            self.device.device_wait_idle().expect("idle");
            let words = std::slice::from_raw_parts(self.map(memory).expect("mapped"), WORDS as usize);
            let first = words[0];
            assert!(words.iter().all(|&word| word == first), "{words:?}");
            for (buffer, memory) in [(filled, hidden), (read, memory)] {
                self.device.destroy_buffer(buffer, None);
                self.device.free_memory(memory, None);
            }
            first
        }
    }

    /// Words read without the semaphore, with it, and with the signal submitted last. First the copy queue writes, then the
    /// main queue.
    fn try_all(&self, semaphore: vk::Semaphore) -> [[u32; 3]; 2] {
        let mut value = 0;
        [COPIES, MAIN].map(|writer| {
            [(true, false), (true, true), (false, true)].map(|(signal_first, ordered)| {
                value += u64::from(ordered);
                self.fill_and_read(writer, signal_first, ordered.then_some((semaphore, value)))
            })
        })
    }

    /// Words that the host sees of a fill: after waiting for the other queue only, and for the fill itself.
    fn wait_for_either(&self, late: usize, [own, other]: [vk::Semaphore; 2]) -> [u32; 2] {
        let (filled, memory) = self.buffer(SEEN);
        self.submit(late, self.fill(late, filled), [None, Some((own, 1))]);
        self.submit(1 - late, self.record(1 - late, |_| ()), [None, Some((other, 1))]);
        // SAFETY: as above, and the words are read while nothing runs that writes them.
        unsafe {
            let address = self.map(memory).expect("mapped");
            let words = [other, own].map(|semaphore| {
                let (semaphores, values) = ([semaphore], [1]);
                let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
                self.device.wait_semaphores(&info, u64::MAX).expect("signalled");
                address.read_volatile()
            });
            self.device.device_wait_idle().expect("idle");
            self.device.destroy_buffer(filled, None);
            self.device.free_memory(memory, None);
            words
        }
    }

    fn timeline(&self) -> vk::Semaphore {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: a valid description; the feature is on.
        unsafe { self.device.create_semaphore(&info, None) }.expect("a semaphore")
    }
}

#[test]
#[ignore = "the child's part, under the layer"]
fn card_in_a_child() {
    // SAFETY: raw Vulkan by its rules: valid descriptions, objects that outlive their uses, destroyed once, in order.
    unsafe {
        let entry = ash::Entry::load().expect("a loader");
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        let info = vk::InstanceCreateInfo::default().application_info(&application);
        let instance = entry.create_instance(&info, None).expect("an instance");
        let physical = instance.enumerate_physical_devices().expect("devices")[0];
        let families = instance.get_physical_device_queue_family_properties(physical);
        assert_eq!(families[1].queue_flags, vk::QueueFlags::TRANSFER);
        assert!(!families[2].queue_flags.contains(vk::QueueFlags::GRAPHICS));
        let priorities = [1.0];
        let queues = [0, 1].map(|family| {
            vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)
        });
        let mut v12 = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
        let mut v13 = vk::PhysicalDeviceVulkan13Features::default().synchronization2(true);
        let info = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .push_next(&mut v12)
            .push_next(&mut v13);
        let device = instance.create_device(physical, &info, None).expect("a device");
        let pools = [0, 1].map(|family| {
            let info = vk::CommandPoolCreateInfo::default().queue_family_index(family);
            device.create_command_pool(&info, None).expect("a pool")
        });
        let gpu = Gpu {
            memory: instance.get_physical_device_memory_properties(physical),
            queues: [0, 1].map(|family| device.get_device_queue(family, 0)),
            device,
            pools,
        };
        assert_ne!(gpu.queues[0], gpu.queues[1]);
        let semaphores @ [first, second, third] = [(); 3].map(|()| gpu.timeline());
        // New memory holds the old word. Without the semaphore, a late queue writes too late to be read.
        let (late, seen) = match std::env::var(ashsplat_mock_layer::VARIABLE).as_deref() {
            Ok("transfer-queue") => (COPIES, [OLD, NEW]),
            Ok("transfer-queue-main-late") => (MAIN, [NEW, OLD]),
            other => panic!("no machine of this trial: {other:?}"),
        };
        assert_eq!(gpu.try_all(first), seen.map(|unordered| [unordered, NEW, NEW]));
        // Waiting for one queue does not wait for the other.
        assert_eq!(gpu.wait_for_either(late, [second, third]), [OLD, NEW]);
        semaphores.iter().for_each(|semaphore| gpu.device.destroy_semaphore(*semaphore, None));
        gpu.pools.iter().for_each(|pool| gpu.device.destroy_command_pool(*pool, None));
        gpu.device.destroy_device(None);
        instance.destroy_instance(None);
    }
}
