//! Runs single kernels: uploads and reads buffers, and checks that validation stays silent.

use super::compare::equal;
use super::layout::{pack, plane_capacity, planes, unpack};
use super::machine::{self, Machine};
use super::{assert_silent, context, options};
use crate::reference::types::Gaussian;
use ashsplat::kernels::constants::STATE_WORDS;
use ashsplat::passes::loss::NativeLayout;
use ashsplat::vk::{Buffer, Context, ContextOptions, Kernel, KernelInterface, Limits, MemoryKind, Recorder};
use bytemuck::Pod;
use std::sync::OnceLock;

/// Initial word of every output, so that tests see what a kernel writes.
pub const UNTOUCHED: u32 = 0xDEAD_BEEF;

/// The shared device. Its drop at the end of a test fails the test if there are validation messages.
pub struct Gpu {
    pub context: &'static Context,
    /// Runs the kernels of [`Gpu::dispatch`].
    machine: Machine,
    /// Limits that kernels are built for.
    limits: Limits,
}

impl Gpu {
    /// Uses the device that all tests share, or the machine that runs this test.
    pub fn new() -> Gpu {
        Gpu::of(context())
    }

    /// Uses this device's buffers, and the machine that runs this test.
    pub fn of(context: &'static Context) -> Gpu {
        let machine = machine::current();
        Gpu { context, machine, limits: machine.limits(context.limits()) }
    }

    pub fn with(options: &ContextOptions) -> Gpu {
        Gpu::of(Box::leak(Box::new(Context::new(options).expect("a device"))))
    }

    pub fn is_interpreted(&self) -> bool {
        matches!(self.machine, Machine::Interpreter { .. })
    }

    /// A size for devices, or a smaller one for the interpreter, which is slower.
    pub fn sized<T>(&self, usual: T, interpreted: T) -> T {
        if self.is_interpreted() { interpreted } else { usual }
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// True if kernels can read texels on this device; prints the skipped test otherwise.
    pub fn has_texels(&self, skipped: &str) -> bool {
        let has = self.context.limits().max_texels > 0;
        if !has {
            eprintln!("skipped: {skipped}: kernels cannot read texels on this device");
        }
        has
    }

    pub fn layouts(&self) -> impl Iterator<Item = NativeLayout> {
        let sweeps = self.has_texels("the loss by sweeps").then_some(NativeLayout::Strips);
        std::iter::once(NativeLayout::Rows).chain(sweeps)
    }

    /// The same device without push descriptors and hence without texels: kernels read storage buffers instead.
    pub fn without_texels() -> Gpu {
        static CONTEXT: OnceLock<Context> = OnceLock::new();
        // Called each time: `options` makes the calling test the only one with such a device.
        let options = options();
        let plain = ContextOptions { push_descriptors: false, ..options };
        Gpu::of(CONTEXT.get_or_init(|| Context::new(&plain).expect("a device")))
    }

    /// A device without validation, for thousands of steps whose result alone matters. Validation would double their
    /// time, and shorter tests check the same kernels.
    pub fn unchecked() -> Gpu {
        static CONTEXT: OnceLock<Context> = OnceLock::new();
        Gpu::of(CONTEXT.get_or_init(|| Context::new(&ContextOptions::default()).expect("a device")))
    }

    pub fn subgroup(&self) -> u32 {
        self.limits.subgroup_size
    }

    /// Largest workgroup size up to `preferred`.
    pub fn workgroup(&self, preferred: u32) -> u32 {
        match self.machine {
            Machine::Interpreter { workgroup, .. } => self.limits.workgroup_size(preferred.max(workgroup)),
            _ => self.limits.workgroup_size(preferred),
        }
    }

    pub fn buffer<T: Pod>(&self, name: &'static str, values: &[T]) -> Buffer {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let request = [(name, (bytes.len() as u64).max(16).next_multiple_of(4))];
        let buffers = self.context.allocate("test", &request, MemoryKind::Device);
        let buffer = buffers.expect("memory").remove(0);
        if !bytes.is_empty() {
            self.context.upload(&buffer.range(0, bytes.len() as u64), bytes).expect("upload");
        }
        buffer
    }

    pub fn untouched<T: Pod>(&self, name: &'static str, count: usize) -> Buffer {
        let words = (count * size_of::<T>()).div_ceil(4).max(4);
        self.buffer(name, &vec![UNTOUCHED; words])
    }

    pub fn zeros<T: Pod>(&self, name: &'static str, count: usize) -> Buffer {
        self.buffer(name, &vec![0_u8; (count * size_of::<T>()).next_multiple_of(4).max(16)])
    }

    pub fn read<T: Pod>(&self, buffer: &Buffer, count: usize) -> Vec<T> {
        if count == 0 {
            return Vec::new();
        }
        let bytes =
            self.context.download(&buffer.range(0, (count * size_of::<T>()) as u64)).expect("download");
        bytemuck::pod_collect_to_vec(&bytes)
    }

    /// Fails unless a buffer has these values and, behind them, only [`UNTOUCHED`] words.
    #[track_caller]
    pub fn assert_values<T: Pod>(&self, buffer: &Buffer, expected: &[T], case: &str) {
        let expected: &[u32] = bytemuck::cast_slice(expected);
        let words = self.read::<u32>(buffer, buffer.bytes() as usize / 4);
        let (own, behind) = words.split_at(expected.len());
        equal(buffer.name(), own, expected).unwrap_or_else(|error| panic!("{case}: {error}"));
        let untouched = behind.iter().all(|&word| word == UNTOUCHED);
        assert!(untouched, "{case}: '{}' is written behind its end", buffer.name());
    }

    /// Creates the planes of Gaussians, with a few unused places behind them.
    pub fn gaussians(&self, name: &'static str, gaussians: &[Gaussian]) -> Buffer {
        self.buffer(name, &pack(gaussians, plane_capacity(gaussians.len())))
    }

    /// Reads Gaussians from planes as those of [`Self::gaussians`].
    pub fn read_gaussians(&self, buffer: &Buffer, count: usize, coefficients: usize) -> Vec<Gaussian> {
        let capacity = plane_capacity(count);
        unpack(&self.read::<[f32; 4]>(buffer, planes(coefficients) * capacity), capacity, count, coefficients)
    }

    /// Creates a frame's state from some of its words; the others are 0.
    pub fn frame_state(&self, words: &[(u32, u32)]) -> Buffer {
        let mut state = vec![0; STATE_WORDS as usize];
        words.iter().for_each(|&(index, word)| state[index as usize] = word);
        self.buffer("state", &state)
    }

    pub fn read_state(&self, state: &Buffer, index: u32) -> u32 {
        self.read::<u32>(state, STATE_WORDS as usize)[index as usize]
    }

    /// Reads the first `count` numbers of a buffer as float64.
    pub fn read_f64<T: Pod + Into<f64>>(&self, buffer: &Buffer, count: usize) -> Vec<f64> {
        self.read::<T>(buffer, count).into_iter().map(Into::into).collect()
    }

    pub fn kernel<K: KernelInterface>(&self, spec: &K::Spec) -> Kernel<K> {
        Kernel::new(self.context, spec).expect(K::NAME)
    }

    pub fn run(&self, record: impl FnOnce(&mut Recorder)) {
        self.context.run("test", |recorder| record(recorder)).expect("a submission");
    }

    /// Runs a kernel once, on the test's [`Machine`].
    pub fn dispatch<K: KernelInterface>(
        &self,
        spec: &K::Spec,
        bind: &K::Bind<'_>,
        push: &K::Push,
        workgroups: u64,
    ) {
        self.dispatch_each::<K>(spec, bind, [*push], workgroups);
    }

    /// Runs a kernel once with an invocation per element and one workgroup more, which must write nothing.
    pub fn dispatch_over<K: KernelInterface>(
        &self,
        spec: &K::Spec,
        bind: &K::Bind<'_>,
        push: &K::Push,
        elements: usize,
    ) {
        let invocations: u32 = K::workgroup_size(spec).iter().product();
        self.dispatch::<K>(spec, bind, push, elements as u64 / u64::from(invocations) + 1);
    }

    /// Runs a kernel several times, with barriers in between.
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
        }
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert_silent(self.context);
        }
    }
}

/// Element counts around multiples of a kernel's block size.
pub fn sizes(block: usize) -> Vec<usize> {
    vec![0, 1, 2, block - 1, block, block + 1, 2 * block - 1, 3 * block + 7, 7 * block + block / 2]
}
