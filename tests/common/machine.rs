//! Machines that run a test's kernels: the device or an interpreter.

use ashsplat::frame::tuning::Tuning;
use ashsplat::vk::{Buffer, Context, KernelInterface, Limits};
use ashsplat_interpreter::{Dispatch, Fault, Order, Program};
use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::rc::Rc;

/// Kernels that read unwritten shared memory and drop the value: the sums of regions that no Gaussian hits. If they
/// used it, results would be NaN.
const READ_UNWRITTEN: [&str; 1] = ["backward/blend_backward"];

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Machine {
    Device,
    /// The interpreter with this many lanes, and at least this many invocations per workgroup.
    Interpreter {
        lanes: u32,
        workgroup: u32,
    },
}

thread_local! {
    static MACHINE: Cell<Machine> = const { Cell::new(Machine::Device) };
    static PROGRAMS: RefCell<Programs> = RefCell::new(HashMap::new());
    static DISPATCHES: Cell<u64> = const { Cell::new(0) };
}

type Programs = HashMap<(&'static str, u32, Vec<(u32, u32)>), Rc<Program>>;

/// Runs tests of kernels, or parts of them, on another machine than the device.
pub fn on(machine: Machine, tests: impl FnOnce()) {
    struct Back(Machine);
    impl Drop for Back {
        fn drop(&mut self) {
            MACHINE.set(self.0);
        }
    }
    let _back = Back(MACHINE.replace(machine));
    tests();
}

pub fn current() -> Machine {
    MACHINE.get()
}

impl Machine {
    /// Limits that kernels are built for. The interpreter uses those of an AMD GPU with its own number of lanes.
    pub fn limits(self, device: &Limits) -> Limits {
        let mut limits = device.clone();
        if let Self::Interpreter { lanes, .. } = self {
            (limits.subgroup_size, limits.heavy_subgroup_size, limits.own_subgroup_size) =
                (lanes, lanes, lanes);
            (limits.min_subgroup_size, limits.max_subgroup_size) = (lanes, lanes);
            limits.max_workgroup_invocations = 1024;
            limits.max_workgroup_size = [1024; 3];
            limits.max_workgroup_subgroups = 1024 / lanes;
            limits.max_texels = 0;
            limits.max_loop_iterations = None;
            limits.tuning = &Tuning::AMD;
        }
        limits
    }
}

/// The interpreter's program of a kernel, with the largest subgroups that fit into its workgroups.
fn program<K: KernelInterface>(spec: &K::Spec, lanes: u32) -> Rc<Program> {
    let invocations: u32 = K::workgroup_size(spec).iter().product();
    let lanes = K::subgroup_size(spec).unwrap_or_else(|| lanes.min(1 << invocations.trailing_zeros()));
    let key = (K::NAME, lanes, K::spec_entries(spec));
    PROGRAMS.with_borrow_mut(|programs| {
        let made = || Program::new(K::NAME, K::FORMS[0].spirv, &K::spec_entries(spec), lanes);
        programs.entry(key).or_insert_with(|| Rc::new(made().expect("a program"))).clone()
    })
}

pub type Words = Vec<(u32, Vec<u32>)>;

fn words<K: KernelInterface>(context: &Context, bind: &K::Bind<'_>) -> Words {
    let word = |buffer: &Buffer| {
        let bytes = context.download(&buffer.range(0, buffer.bytes())).expect("a download");
        bytemuck::pod_collect_to_vec(&bytes)
    };
    let buffers = K::buffers(bind);
    let bindings = K::FORMS[0].bindings.iter().zip(buffers.as_ref());
    bindings.map(|(info, buffer)| (info.binding, word(buffer))).collect()
}

/// Runs a program over words. Each dispatch uses another order of workgroups and subgroups.
pub fn run(
    program: &Program,
    name: &str,
    push: &[u8],
    workgroups: [u32; 3],
    words: &mut Words,
) -> Result<(), Fault> {
    let number = DISPATCHES.replace(DISPATCHES.get() + 1);
    let order = [Order::Shuffled(number), Order::Reverse, Order::Forward][(number % 3) as usize];
    let accepts_unwritten_shared = READ_UNWRITTEN.contains(&name);
    program.run(&Dispatch { workgroups, push, order, accepts_unwritten_shared }, words)
}

/// Interprets one dispatch over the contents of the device's buffers.
pub fn interpret<K: KernelInterface>(
    context: &Context,
    lanes: u32,
    (spec, bind, push): (&K::Spec, &K::Bind<'_>, &K::Push),
    workgroups: u64,
) {
    let before = words::<K>(context, bind);
    let mut after = before.clone();
    let program = program::<K>(spec, lanes);
    run(&program, K::NAME, K::push_bytes(push), context.limits().grid(workgroups), &mut after)
        .unwrap_or_else(|fault| panic!("{fault}"));
    let buffers = K::buffers(bind);
    for ((buffer, before), after) in buffers.as_ref().iter().zip(&before).zip(&after) {
        if before != after {
            let bytes = bytemuck::cast_slice(&after.1);
            context.upload(&buffer.range(0, buffer.bytes()), bytes).expect("an upload");
        }
    }
}
