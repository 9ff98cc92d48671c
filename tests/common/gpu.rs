//! Running single kernels: buffers from slices and back, and the check that validation stayed silent.

use std::sync::OnceLock;

use ashsplat::loss::Windowing;
use ashsplat::vk::{Buffer, Context, ContextOptions, Kernel, KernelInterface, Limits, MemoryKind, Recorder};
use bytemuck::Pod;

use super::machine::{self, Machine};
use super::{assert_silent, context, options};

/// What outputs hold before a kernel runs, to see what it writes.
pub const UNTOUCHED: u32 = 0xDEAD_BEEF;

/// The shared device. Dropping it at the end of a test fails the test if validation has said anything.
pub struct Gpu {
    /// The device.
    pub context: &'static Context,
    /// What runs kernels by [`Gpu::dispatch`].
    machine: Machine,
    /// What is told to kernels of it.
    limits: Limits,
}

impl Gpu {
    /// The device that all tests share, or the machine that runs this test.
    pub fn new() -> Gpu {
        Gpu::of(context())
    }

    /// A device, or the machine that runs this test, with buffers on that device.
    pub fn of(context: &'static Context) -> Gpu {
        let machine = machine::current();
        Gpu { context, machine, limits: machine.limits(context.limits()) }
    }

    /// Whether an interpreter stands in the device's place.
    pub fn is_interpreted(&self) -> bool {
        matches!(self.machine, Machine::Interpreter { .. })
    }

    /// Limits of the device or of the machine in its place.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Whether kernels can read texels here; says what is skipped where they cannot.
    pub fn has_texels(&self, skipped: &str) -> bool {
        let has = self.context.limits().max_texels > 0;
        if !has {
            eprintln!("skipped: {skipped}: kernels cannot read texels on this device");
        }
        has
    }

    /// The forms of the loss that this device has.
    pub fn windowings(&self) -> impl Iterator<Item = Windowing> {
        let sweeps = self.has_texels("the loss by sweeps").then_some(Windowing::Sweeps);
        std::iter::once(Windowing::Blocks).chain(sweeps)
    }

    /// The same device without push descriptors, and so without texels: kernels in their form that reads storage buffers.
    pub fn without_texels() -> Gpu {
        static CONTEXT: OnceLock<Context> = OnceLock::new();
        // Called each time: `options` makes the calling test the only one with such a device.
        let options = options();
        let plain = || Context::new(&ContextOptions { push_descriptors: false, ..options });
        Gpu::of(CONTEXT.get_or_init(|| plain().expect("a device")))
    }

    /// A device that nobody checks, for thousands of steps of which only the result matters. Checks take as long as such steps;
    /// shorter trials run the same kernels on the shared device.
    pub fn unchecked() -> Gpu {
        static CONTEXT: OnceLock<Context> = OnceLock::new();
        let plain = || Context::new(&ContextOptions::default());
        Gpu::of(CONTEXT.get_or_init(|| plain().expect("a device")))
    }

    /// The subgroup size of the kernels.
    pub fn subgroup(&self) -> u32 {
        self.limits.subgroup_size
    }

    /// The largest possible workgroup up to a size.
    pub fn workgroup(&self, preferred: u32) -> u32 {
        match self.machine {
            Machine::Interpreter { workgroup, .. } => self.limits.workgroup_size(preferred.max(workgroup)),
            _ => self.limits.workgroup_size(preferred),
        }
    }

    /// A buffer with these contents.
    pub fn buffer<T: Pod>(&self, name: &'static str, values: &[T]) -> Buffer {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let buffer = self.allocate(name, bytes.len() as u64);
        if !bytes.is_empty() {
            self.context.upload(&buffer.range(0, bytes.len() as u64), bytes).expect("upload");
        }
        buffer
    }

    /// A buffer of a number of elements, each word [`UNTOUCHED`].
    pub fn untouched<T: Pod>(&self, name: &'static str, count: usize) -> Buffer {
        let words = (count * size_of::<T>()).div_ceil(4).max(4);
        self.buffer(name, &vec![UNTOUCHED; words])
    }

    /// A buffer of zeros.
    pub fn zeros<T: Pod>(&self, name: &'static str, count: usize) -> Buffer {
        self.buffer(name, &vec![0_u8; (count * size_of::<T>()).next_multiple_of(4).max(16)])
    }

    /// The first `count` elements of a buffer.
    pub fn read<T: Pod>(&self, buffer: &Buffer, count: usize) -> Vec<T> {
        if count == 0 {
            return Vec::new();
        }
        let bytes =
            self.context.download(&buffer.range(0, (count * size_of::<T>()) as u64)).expect("download");
        bytemuck::pod_collect_to_vec(&bytes)
    }

    /// Compiles a kernel.
    pub fn kernel<K: KernelInterface>(&self, spec: &K::Spec) -> Kernel<K> {
        Kernel::new(self.context, spec).expect(K::NAME)
    }

    /// Records, submits and waits.
    pub fn run(&self, record: impl FnOnce(&mut Recorder)) {
        self.context
            .run("test", |recorder| {
                record(recorder);
                Ok(())
            })
            .expect("a submission");
    }

    /// Runs a kernel once. Tests that call it can run on every [`Machine`].
    pub fn dispatch<K: KernelInterface>(
        &self,
        spec: &K::Spec,
        bind: &K::Bind<'_>,
        push: &K::Push,
        workgroups: u64,
    ) {
        self.dispatch_each::<K>(spec, bind, [*push], workgroups);
    }

    /// Runs a kernel several times, with barriers between.
    pub fn dispatch_each<K: KernelInterface>(
        &self,
        spec: &K::Spec,
        bind: &K::Bind<'_>,
        pushes: impl IntoIterator<Item = K::Push>,
        workgroups: u64,
    ) {
        let on_device = |pushes: &mut dyn Iterator<Item = K::Push>| {
            let kernel = self.kernel::<K>(spec);
            self.run(|recorder| {
                pushes.for_each(|push| {
                    recorder.barrier();
                    recorder.dispatch(&kernel, bind, &push, workgroups);
                });
            });
        };
        let mut pushes = pushes.into_iter();
        match self.machine {
            Machine::Device => on_device(&mut pushes),
            Machine::Interpreter { lanes, .. } => pushes.for_each(|push| {
                machine::interpret::<K>(self.context, lanes, (spec, bind, &push), workgroups);
            }),
            Machine::Both { error } => pushes.for_each(|push| {
                let run = || on_device(&mut std::iter::once(push));
                machine::compare::<K>(self.context, error, (spec, bind, &push), workgroups, run);
            }),
        }
    }

    fn allocate(&self, name: &'static str, bytes: u64) -> Buffer {
        let request = [(name, bytes.max(16).next_multiple_of(4))];
        self.context.allocate("test", &request, MemoryKind::Device).expect("memory").remove(0)
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert_silent(self.context);
        }
    }
}

/// Sizes at which a kernel that works on blocks may go wrong.
pub fn sizes(block: usize) -> Vec<usize> {
    vec![0, 1, 2, block - 1, block, block + 1, 2 * block - 1, 3 * block + 7, 7 * block + block / 2]
}
