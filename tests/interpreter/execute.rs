//! Running a program: workgroups, their subgroups between barriers, the lanes of a subgroup in lockstep.

use std::cell::Cell;
use std::fmt;

use crate::arithmetic::{POISON, binary, binary_lanes, ternary_lanes, unary_lanes};
use crate::memory::{Moment, Words};
use crate::program::{Address, Edge, Kind, NO_SLOT, Operation, Program, Slot};
use crate::subgroup::{Problem, Row, all, ballot, count, lanes_of, reduce, shuffle, vote};

/// The order of workgroups, and of the subgroups of a workgroup between barriers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// By their numbers.
    Forward,
    /// From the last to the first.
    Reverse,
    /// At random, by a seed.
    Shuffled(u64),
}

impl Order {
    fn of(self, count: u32, salt: u64) -> Vec<u32> {
        let mut order: Vec<u32> = (0..count).collect();
        match self {
            Self::Forward => {}
            Self::Reverse => order.reverse(),
            Self::Shuffled(seed) => {
                let mut state = seed ^ salt.wrapping_mul(0x9E37_79B9_7F4A_7C15);
                for place in (1..order.len()).rev() {
                    state =
                        state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    order.swap(place, (state >> 33) as usize % (place + 1));
                }
            }
        }
        order
    }
}

/// One dispatch.
#[derive(Clone, Copy, Debug)]
pub struct Dispatch<'a> {
    /// On each axis.
    pub workgroups: [u32; 3],
    /// Push constants.
    pub push: &'a [u8],
    /// See there.
    pub order: Order,
    /// Shared memory that nobody has written may be read: it is NaN. For kernels that read it and drop what they have read.
    pub accepts_unwritten_shared: bool,
}

/// What a kernel has done against the specifications, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The kernel.
    pub kernel: String,
    /// What is wrong.
    pub problem: String,
    /// The instruction: its word in the module.
    pub word: u32,
    /// And its opcode.
    pub opcode: u16,
    /// The workgroup.
    pub workgroup: [u32; 3],
    /// The subgroup in it.
    pub subgroup: u32,
    /// The lane in that; None: all.
    pub lane: Option<u32>,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kernel, problem, word, opcode, workgroup, subgroup, lane } = self;
        let [x, y, z] = workgroup;
        write!(
            f,
            "{kernel}: {problem}; opcode {opcode} at word {word}, workgroup ({x}, {y}, {z}), subgroup {subgroup}"
        )?;
        lane.map_or(Ok(()), |lane| write!(f, ", lane {lane}"))
    }
}

impl std::error::Error for Fault {}

/// A subgroup of the workgroup that runs.
struct Subgroup {
    number: u32,
    /// Rows of words, one for each slot.
    words: Vec<Cell<u32>>,
    /// Lanes that wait at the start of each block, and which blocks have such lanes.
    waiting: Vec<u128>,
    pending: Vec<u64>,
    /// The next operation, and the lanes that are there.
    at: usize,
    active: u128,
    has_ended: bool,
    moment: Moment,
    /// Barriers that shared memory and buffers have seen: of the workgroup, and of the subgroup.
    barriers: [[u32; 2]; 2],
    semantics: u32,
}

/// Shared memory, buffers: which semantics a barrier has for them.
const SEMANTICS: [u32; 2] = [0x100, 0x40];

impl Program {
    /// Runs a dispatch over buffers (binding, words) in place.
    ///
    /// # Errors
    /// The first thing that the kernel does against the specifications. Buffers are then as they were.
    ///
    /// # Panics
    /// If a binding has no buffer, or push constants are missing.
    pub fn run(&self, dispatch: &Dispatch, buffers: &mut [(u32, Vec<u32>)]) -> Result<(), Fault> {
        let push = dispatch.push.chunks(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        let words = |kind| match kind {
            Kind::Push => Vec::clone(&push),
            Kind::Shared { words } => vec![POISON; words as usize],
            Kind::Buffer { binding, .. } => {
                let buffer = buffers.iter().find(|buffer| buffer.0 == binding);
                buffer.unwrap_or_else(|| panic!("{}: no buffer {binding}", self.name)).1.clone()
            }
        };
        let accepts = dispatch.accepts_unwritten_shared;
        let mut memories: Vec<Words> =
            self.memories.iter().map(|memory| Words::new(memory, words(memory.kind), accepts)).collect();
        let [x, y, z] = dispatch.workgroups;
        let mut subgroups = self.subgroups();
        for workgroup in dispatch.order.of(x * y * z, 0) {
            let at = [workgroup % x, workgroup / x % y, workgroup / (x * y)];
            self.workgroup(dispatch, (workgroup, at), &mut subgroups, &mut memories)?;
        }
        for (memory, words) in self.memories.iter().zip(memories) {
            if let Kind::Buffer { binding, writable: true, .. } = memory.kind {
                let buffer = buffers.iter_mut().find(|buffer| buffer.0 == binding);
                buffer.into_iter().for_each(|buffer| buffer.1.clone_from(&words.words));
            }
        }
        Ok(())
    }

    fn subgroups(&self) -> Vec<Subgroup> {
        let [x, y, z] = self.workgroup_size;
        let subgroup = |number| {
            let words = vec![Cell::new(POISON); self.slots * self.lanes];
            for &(slot, word) in &self.constants {
                row(&words, self.lanes, slot).iter().for_each(|lane| lane.set(word));
            }
            Subgroup {
                number,
                words,
                waiting: vec![0; self.blocks.len()],
                pending: vec![0; self.blocks.len().div_ceil(64)],
                at: 0,
                active: 0,
                has_ended: false,
                moment: Moment::default(),
                barriers: [[0; 2]; 2],
                semantics: 0,
            }
        };
        (0..x * y * z / self.lanes as u32).map(subgroup).collect()
    }

    fn workgroup(
        &self,
        dispatch: &Dispatch,
        (number, at): (u32, [u32; 3]),
        subgroups: &mut [Subgroup],
        memories: &mut [Words],
    ) -> Result<(), Fault> {
        memories.iter_mut().for_each(Words::forget);
        let count = subgroups.len() as u32;
        for subgroup in subgroups.iter_mut() {
            subgroup.begin(self, dispatch.workgroups, (number, at), count);
        }
        let fault = |subgroup: &Subgroup, at: usize, (problem, lane): Problem| {
            let (word, opcode) = self.sources[at];
            let (kernel, subgroup) = (self.name.clone(), subgroup.number);
            Fault {
                kernel,
                problem,
                word,
                opcode,
                workgroup: at_of(number, dispatch.workgroups),
                subgroup,
                lane,
            }
        };
        let mut stage = 0;
        loop {
            for index in dispatch.order.of(count, u64::from(number) << 32 | stage) {
                let subgroup = &mut subgroups[index as usize];
                subgroup.run(self, memories).map_err(|problem| fault(subgroup, subgroup.at, problem))?;
            }
            let first = &subgroups[0];
            if let Some(other) = subgroups.iter().find(|s| (s.has_ended, s.at) != (first.has_ended, first.at))
            {
                let here = if first.has_ended { other } else { first };
                let problem = "a barrier that not all subgroups reach".to_owned();
                return Err(fault(here, here.at - 1, (problem, None)));
            }
            if first.has_ended {
                return Ok(());
            }
            subgroups.iter_mut().for_each(|subgroup| subgroup.pass_barrier(0));
            stage += 1;
        }
    }
}

fn at_of(number: u32, [x, y, _]: [u32; 3]) -> [u32; 3] {
    [number % x, number / x % y, number / (x * y)]
}

fn row(words: &[Cell<u32>], lanes: usize, slot: Slot) -> Row<'_> {
    &words[slot as usize * lanes..][..lanes]
}

impl Subgroup {
    fn begin(
        &mut self,
        program: &Program,
        workgroups: [u32; 3],
        (number, at): (u32, [u32; 3]),
        subgroups: u32,
    ) {
        let lanes = program.lanes;
        let (first, end) = program.kept;
        self.words[first as usize * lanes..end as usize * lanes].iter().for_each(|word| word.set(POISON));
        for &(slot, word) in &program.initials {
            row(&self.words, lanes, slot).iter().for_each(|lane| lane.set(word));
        }
        let [x, y, z] = program.workgroup_size;
        for &(input, slot) in &program.inputs {
            for lane in 0..lanes as u32 {
                let index = self.number * lanes as u32 + lane;
                let local = [index % x, index / x % y, index / (x * y)];
                let words = match input {
                    24 => workgroups,
                    25 => [x, y, z],
                    26 => at,
                    27 => local,
                    28 => [0, 1, 2].map(|k| at[k] * [x, y, z][k] + local[k]),
                    29 => [index, 0, 0],
                    36 => [lanes as u32, 0, 0],
                    38 => [subgroups, 0, 0],
                    40 => [self.number, 0, 0],
                    41 => [lane, 0, 0],
                    _ => [POISON; 3],
                };
                let count = if matches!(input, 24..=28) { 3 } else { 1 };
                for (slot, word) in (slot..slot + count).zip(words) {
                    row(&self.words, lanes, slot)[lane as usize].set(word);
                }
            }
        }
        self.waiting.fill(0);
        self.pending.fill(0);
        (self.at, self.active, self.has_ended) = (0, all(lanes), false);
        self.moment =
            Moment { subgroup: number * subgroups + self.number + 1, workgroup: number, ..Moment::default() };
        (self.barriers, self.semantics) = ([[0; 2]; 2], 0);
    }

    /// A barrier of the workgroup (0) or of the subgroup (1), for the memory that its semantics name.
    fn pass_barrier(&mut self, scope: usize) {
        for (kind, semantics) in SEMANTICS.iter().enumerate() {
            self.barriers[scope][kind] += u32::from(self.semantics & semantics != 0);
        }
        self.semantics = 0;
    }

    /// The moment of an access to a memory by a lane.
    fn now(&self, memory: &Words, lane: usize) -> Moment {
        let kind = usize::from(!memory.is_shared);
        let [of_workgroup, own] = self.barriers;
        Moment { lane: lane as u8, barriers: of_workgroup[kind], own_barriers: own[kind], ..self.moment }
    }

    /// Runs to the next barrier of the workgroup, or to the end.
    fn run(&mut self, program: &Program, memories: &mut [Words]) -> Result<(), Problem> {
        let lanes = program.lanes;
        while !self.has_ended {
            let words = &self.words;
            let r = |slot: Slot| row(words, lanes, slot);
            match program.operations[self.at] {
                Operation::Unary { code, target, a } => unary_lanes(code, r(target), [r(a)]),
                Operation::Binary { code, target, a, b } => binary_lanes(code, r(target), [r(a), r(b)]),
                Operation::Ternary { code, target, a, b, c } => {
                    ternary_lanes(code, r(target), [r(a), r(b), r(c)])
                }
                Operation::Copy { target, from } => copy(r(target), r(from)),
                Operation::CopyActive { target, from } => copy_active(r(target), r(from), self.active, lanes),
                Operation::Index { target, before, index, stride, count } => {
                    self.index(r(target), (before != NO_SLOT).then(|| r(before)), r(index), (stride, count))?;
                }
                Operation::LoadLocal { target, base, offset } => {
                    for lane in lanes_of(self.active) {
                        r(target)[lane].set(r(base + r(offset)[lane].get())[lane].get());
                    }
                }
                Operation::StoreLocal { base, offset, from } => {
                    for lane in lanes_of(self.active) {
                        r(base + r(offset)[lane].get())[lane].set(r(from)[lane].get());
                    }
                }
                Operation::Load { target, address } => {
                    let memory = &mut memories[address.memory as usize];
                    for lane in lanes_of(self.active) {
                        let place = place_of(address, lane, &r);
                        let word = memory.load(place, self.now(memory, lane));
                        r(target)[lane].set(word.map_err(|problem| (problem, Some(lane as u32)))?);
                    }
                }
                Operation::Store { from, address } => {
                    let memory = &mut memories[address.memory as usize];
                    for lane in lanes_of(self.active) {
                        let (place, word) = (place_of(address, lane, &r), r(from)[lane].get());
                        let stored = memory.store(place, word, self.now(memory, lane));
                        stored.map_err(|problem| (problem, Some(lane as u32)))?;
                    }
                }
                Operation::Atomic { code, target, value, address } => {
                    let memory = &mut memories[address.memory as usize];
                    for lane in lanes_of(self.active) {
                        let (place, now) = (place_of(address, lane, &r), self.now(memory, lane));
                        let given = if value == NO_SLOT { 0 } else { r(value)[lane].get() };
                        let old = memory.change(place, now, |old| changed(code, old, given));
                        r(target)[lane].set(old.map_err(|problem| (problem, Some(lane as u32)))?);
                    }
                }
                Operation::Group { code, kind, target, value, other } => match code {
                    333 => vote(code, r(target), r(target), self.active),
                    334 | 335 | 338 => vote(code, r(target), r(value), self.active),
                    339 => ballot(&words[target as usize * lanes..][..4 * lanes], r(value), self.active),
                    342..=344 => count(code, kind, r(target), &words[value as usize * lanes..][..4 * lanes]),
                    337 | 345..=348 => shuffle(code, r(target), (r(value), r(other)), self.active)?,
                    _ => reduce(code, kind, r(target), r(value), self.active),
                },
                Operation::MemoryBarrier { semantics } => self.semantics |= semantics,
                Operation::Barrier { of_workgroup, semantics } => {
                    if self.active != all(lanes) {
                        let missing = (!self.active).trailing_zeros();
                        return Err((format!("a barrier that lane {missing} does not reach"), None));
                    }
                    self.semantics |= semantics;
                    if of_workgroup {
                        self.at += 1;
                        return Ok(());
                    }
                    self.pass_barrier(1);
                }
                Operation::Jump(edge) => {
                    self.follow(program, edge, self.active);
                    self.next_block(program);
                    continue;
                }
                Operation::Branch { condition, yes, no } => {
                    let is_set = |lane: &usize| r(condition)[*lane].get() != 0;
                    let taken =
                        lanes_of(self.active).filter(is_set).fold(0, |all, lane| all | 1_u128 << lane);
                    let rest = self.active & !taken;
                    self.follow(program, yes, taken);
                    self.follow(program, no, rest);
                    self.next_block(program);
                    continue;
                }
                Operation::End => {
                    self.next_block(program);
                    continue;
                }
            }
            self.at += 1;
        }
        Ok(())
    }

    /// Lanes go to wait at the start of a block.
    fn follow(&mut self, program: &Program, edge: Edge, taking: u128) {
        if taking == 0 {
            return;
        }
        let lanes = program.lanes;
        for &(target, from) in &program.moves[edge.moves.0 as usize..edge.moves.1 as usize] {
            copy_active(row(&self.words, lanes, target), row(&self.words, lanes, from), taking, lanes);
        }
        self.waiting[edge.block as usize] |= taking;
        self.pending[edge.block as usize / 64] |= 1 << (edge.block % 64);
    }

    /// Goes on with the first block where lanes wait: with all that have come there, for merge blocks follow their constructs.
    fn next_block(&mut self, program: &Program) {
        let Some(part) = self.pending.iter().position(|part| *part != 0) else {
            self.has_ended = true;
            return;
        };
        let block = 64 * part + self.pending[part].trailing_zeros() as usize;
        self.pending[part] &= self.pending[part] - 1;
        self.active = std::mem::take(&mut self.waiting[block]);
        self.at = program.blocks[block] as usize;
    }

    fn index(
        &self,
        target: Row,
        before: Option<Row>,
        index: Row,
        (stride, count): (u32, u32),
    ) -> Result<(), Problem> {
        for lane in lanes_of(self.active) {
            let given = index[lane].get();
            let before = before.map_or(0, |before| before[lane].get());
            let place = u64::from(before) + u64::from(given) * u64::from(stride);
            match u32::try_from(place) {
                Ok(place) if given < count => target[lane].set(place),
                _ => return Err((format!("index {given} of {count} elements"), Some(lane as u32))),
            }
        }
        Ok(())
    }
}

fn place_of<'a>(address: Address, lane: usize, r: &impl Fn(Slot) -> Row<'a>) -> u64 {
    let offset = if address.offset == NO_SLOT { 0 } else { r(address.offset)[lane].get() };
    u64::from(address.place) + u64::from(offset)
}

fn copy(target: Row, from: Row) {
    target.iter().zip(from).for_each(|(target, from)| target.set(from.get()));
}

fn copy_active(target: Row, from: Row, active: u128, lanes: usize) {
    if active == all(lanes) {
        return copy(target, from);
    }
    lanes_of(active).for_each(|lane| target[lane].set(from[lane].get()));
}

/// What an atomic leaves: Load, Exchange, IAdd, ISub, SMin, UMin, SMax, UMax, And, Or, Xor.
fn changed(code: u16, old: u32, value: u32) -> u32 {
    let operation = match code {
        227 => return old,
        229 => return value,
        234 => 128,
        235 => 130,
        236 => 2039,
        237 => 2038,
        238 => 2042,
        239 => 2041,
        240 => 199,
        241 => 197,
        _ => 198,
    };
    binary(operation, [old, value]).unwrap_or(old)
}
