//! The layer in raw Vulkan: what it refuses, and that it finds a missing semaphore, which the driver's one queue would hide.
#![cfg(target_os = "linux")]

use ash::vk;
use std::path::Path;
use std::process::{Command, Stdio};

const WORDS: u64 = 64;
const OLD: u32 = 0xFFFF_FFFF;
const NEW: u32 = 0x0BAD_CAFE;

#[test]
fn the_layer_claims_a_card_and_holds_copies_back() {
    let executable = std::env::current_exe().expect("a path");
    let output = Command::new(&executable)
        .args(["in_a_child", "--include-ignored", "--nocapture"])
        .stdin(Stdio::null())
        .env("LD_LIBRARY_PATH", executable.parent().expect("deps"))
        .env("VK_ADD_LAYER_PATH", Path::new(env!("CARGO_MANIFEST_DIR")))
        .env("VK_INSTANCE_LAYERS", "VK_LAYER_ASHSPLAT_mock")
        .env(ashsplat_mock_layer::VARIABLE, "transfer-queue")
        .output()
        .expect("the test binary runs");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.contains("1 passed"), "{text}");
}

struct Gpu {
    device: ash::Device,
    memory: vk::PhysicalDeviceMemoryProperties,
    pools: [vk::CommandPool; 2],
    queues: [vk::Queue; 2],
}

impl Gpu {
    /// With a buffer of memory with these flags and without others of HOST_VISIBLE.
    fn buffer(&self, flags: vk::MemoryPropertyFlags) -> (vk::Buffer, vk::DeviceMemory) {
        let seen = vk::MemoryPropertyFlags::HOST_VISIBLE;
        let index =
            self.memory.memory_types_as_slice().iter().position(|of| {
                of.property_flags.contains(flags) && (of.property_flags & seen) == (flags & seen)
            });
        let usage = vk::BufferUsageFlags::TRANSFER_SRC | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(WORDS * 4).usage(usage);
        // SAFETY: valid descriptions; the buffer is bound once.
        unsafe {
            let buffer = self.device.create_buffer(&info, None).expect("a buffer");
            let needs = self.device.get_buffer_memory_requirements(buffer);
            let index = index.expect("a type") as u32;
            assert!(needs.memory_type_bits & (1 << index) != 0);
            let info = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(index);
            let memory = self.device.allocate_memory(&info, None).expect("memory");
            self.device.bind_buffer_memory(buffer, memory, 0).expect("bound");
            (buffer, memory)
        }
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

    fn submit(&self, queue: usize, commands: vk::CommandBuffer, [wait, signal]: [Option<vk::Semaphore>; 2]) {
        let info = |semaphore| {
            vk::SemaphoreSubmitInfo::default()
                .semaphore(semaphore)
                .value(1)
                .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
        };
        let (waits, signals): (Vec<_>, Vec<_>) =
            (wait.map(info).into_iter().collect(), signal.map(info).into_iter().collect());
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let submit = vk::SubmitInfo2::default()
            .command_buffer_infos(&buffers)
            .wait_semaphore_infos(&waits)
            .signal_semaphore_infos(&signals);
        // SAFETY: recorded for a queue of this family; nothing else uses the queue.
        unsafe { self.device.queue_submit2(self.queues[queue], &[submit], vk::Fence::null()) }
            .expect("submitted");
    }

    /// What the main queue reads of a buffer that the queue for copies fills, with or without a semaphore between them.
    fn fill_and_read(&self, semaphore: Option<vk::Semaphore>) -> u32 {
        let local = vk::MemoryPropertyFlags::DEVICE_LOCAL;
        let seen = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        let ((filled, hidden), (read, memory)) = (self.buffer(local), self.buffer(seen));
        // SAFETY: memory that the host does not see: the layer's own answer, nothing is mapped.
        let mapped =
            unsafe { self.device.map_memory(hidden, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()) };
        assert_eq!(mapped.err(), Some(vk::Result::ERROR_MEMORY_MAP_FAILED));
        // SAFETY: recording state, buffers of this size.
        let fill = self.record(1, |commands| unsafe {
            self.device.cmd_fill_buffer(commands, filled, 0, WORDS * 4, NEW);
        });
        // SAFETY: as above.
        let copy = self.record(0, |commands| unsafe {
            let region = vk::BufferCopy::default().size(WORDS * 4);
            self.device.cmd_copy_buffer(commands, filled, read, &[region]);
        });
        self.submit(1, fill, [None, semaphore]);
        self.submit(0, copy, [semaphore, None]);
        // SAFETY: the device is idle; memory that the host sees, mapped once, of this size.
        unsafe {
            self.device.device_wait_idle().expect("idle");
            let flags = vk::MemoryMapFlags::empty();
            let address = self.device.map_memory(memory, 0, vk::WHOLE_SIZE, flags).expect("mapped");
            let words = std::slice::from_raw_parts(address.cast::<u32>(), WORDS as usize);
            let first = words[0];
            assert!(words.iter().all(|&word| word == first), "{words:?}");
            for (buffer, memory) in [(filled, hidden), (read, memory)] {
                self.device.destroy_buffer(buffer, None);
                self.device.free_memory(memory, None);
            }
            first
        }
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
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        let semaphore = gpu.device.create_semaphore(&info, None).expect("a semaphore");
        // What new memory holds, and what the copy has made of it.
        assert_eq!([gpu.fill_and_read(None), gpu.fill_and_read(Some(semaphore))], [OLD, NEW]);
        gpu.device.destroy_semaphore(semaphore, None);
        gpu.pools.iter().for_each(|pool| gpu.device.destroy_command_pool(*pool, None));
        gpu.device.destroy_device(None);
        instance.destroy_instance(None);
    }
}
