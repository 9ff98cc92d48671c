//! A subgroup: its lanes run in lockstep, each block with all lanes that have arrived there.

use crate::arithmetic::{POISON, binary, binary_lanes, ternary_lanes, unary_lanes};
use crate::memory::{Moment, Words};
use crate::program::{Address, Edge, NO_SLOT, Operation, Program, Slot};
use std::cell::Cell;

/// A subgroup of the current workgroup.
pub(crate) struct Subgroup {
    pub(crate) number: u32,
    /// Rows of words, one per slot.
    words: Vec<Cell<u32>>,
    /// Lanes that wait at the start of each block, and bits of the blocks with such lanes.
    waiting: Vec<u128>,
    pending: Vec<u64>,
    /// The next operation, and the active lanes.
    pub(crate) at: usize,
    active: u128,
    pub(crate) has_ended: bool,
    moment: Moment,
    /// Numbers of barriers so far for shared memory and for buffers: of the workgroup, and of the subgroup.
    barriers: [[u32; 2]; 2],
    semantics: u32,
}

/// Semantics bits of a barrier for shared memory and for buffers.
const SEMANTICS: [u32; 2] = [0x100, 0x40];

fn row(words: &[Cell<u32>], lanes: usize, slot: Slot) -> Row<'_> {
    &words[slot as usize * lanes..][..lanes]
}

impl Subgroup {
    pub(crate) fn new(program: &Program, number: u32) -> Self {
        let words = vec![Cell::new(POISON); program.slots * program.lanes];
        for &(slot, word) in &program.constants {
            row(&words, program.lanes, slot).iter().for_each(|lane| lane.set(word));
        }
        Self {
            number,
            words,
            waiting: vec![0; program.blocks.len()],
            pending: vec![0; program.blocks.len().div_ceil(64)],
            at: 0,
            active: 0,
            has_ended: false,
            moment: Moment::default(),
            barriers: [[0; 2]; 2],
            semantics: 0,
        }
    }

    /// Resets the subgroup for a workgroup.
    pub(crate) fn begin(
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

    /// Counts a barrier of the workgroup (0) or of the subgroup (1) for the memory in its semantics.
    pub(crate) fn pass_barrier(&mut self, scope: usize) {
        for (kind, semantics) in SEMANTICS.iter().enumerate() {
            self.barriers[scope][kind] += u32::from(self.semantics & semantics != 0);
        }
        self.semantics = 0;
    }

    /// Moment of a lane's access to a memory.
    fn now(&self, memory: &Words, lane: usize) -> Moment {
        let kind = usize::from(!memory.is_shared);
        let [of_workgroup, own] = self.barriers;
        Moment { lane: lane as u8, barriers: of_workgroup[kind], own_barriers: own[kind], ..self.moment }
    }

    /// Runs to the workgroup's next barrier, or to the end.
    pub(crate) fn run(&mut self, program: &Program, memories: &mut [Words]) -> Result<(), Problem> {
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

    /// Makes lanes wait at the start of a block.
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

    /// Continues with the first block that has waiting lanes. All its lanes have arrived, because merge blocks
    /// follow their constructs.
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

/// New value of an atomic: Load, Exchange, IAdd, ISub, SMin, UMin, SMax, UMax, And, Or, Xor.
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

// ---- operations of subgroups, over the active lanes in the order of the lanes ----

/// One word of each lane.
type Row<'a> = &'a [Cell<u32>];

/// A problem, and its lane.
pub(crate) type Problem = (String, Option<u32>);

fn lanes_of(mut active: u128) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = active.trailing_zeros();
        active &= active.wrapping_sub(1);
        (lane < 128).then_some(lane as usize)
    })
}

/// All lanes of a subgroup.
fn all(lanes: usize) -> u128 {
    u128::MAX >> (128 - lanes)
}

/// Elect, All, Any, BroadcastFirst.
fn vote(code: u16, target: Row, value: Row, active: u128) {
    let is_set = |lane: usize| value[lane].get() != 0;
    let first = active.trailing_zeros() as usize;
    for (lane, word) in target.iter().enumerate() {
        word.set(match code {
            333 => u32::from(lane == first),
            334 => u32::from(lanes_of(active).all(is_set)),
            335 => u32::from(lanes_of(active).any(is_set)),
            _ => value[first].get(),
        });
    }
}

/// Ballot: writes four rows of words.
fn ballot(target: Row, value: Row, active: u128) {
    let ballot =
        lanes_of(active).filter(|lane| value[*lane].get() != 0).fold(0, |all, lane| all | 1_u128 << lane);
    for (word, row) in target.chunks(value.len()).enumerate() {
        row.iter().for_each(|lane| lane.set((ballot >> (32 * word)) as u32));
    }
}

/// BallotBitCount (kind: all lanes, lanes up to this one, lanes below), BallotFindLSB, BallotFindMSB.
fn count(code: u16, kind: u8, target: Row, value: Row) {
    let lanes = target.len();
    for (lane, word) in target.iter().enumerate() {
        let words = (0..4).rev().map(|k| u128::from(value[k * lanes + lane].get()));
        let ballot = words.fold(0, |ballot, word| ballot << 32 | word) & all(lanes);
        let below = (1_u128 << lane) - 1;
        word.set(match (code, kind) {
            (343, _) => ballot.trailing_zeros(),
            (344, _) => 127_u32.wrapping_sub(ballot.leading_zeros()),
            (_, 0) => ballot.count_ones(),
            (_, 1) => (ballot & (below | 1 << lane)).count_ones(),
            _ => (ballot & below).count_ones(),
        });
    }
}

/// Broadcast, Shuffle, ShuffleXor, ShuffleUp, ShuffleDown.
fn shuffle(code: u16, target: Row, (value, other): (Row, Row), active: u128) -> Result<(), Problem> {
    let uniform = lanes_of(active).next().map_or(0, |first| other[first].get());
    for lane in lanes_of(active) {
        let (own, given) = (lane as u32, other[lane].get());
        let from = match code {
            346 => own ^ given,
            347 => own.wrapping_sub(given),
            348 => own.wrapping_add(given),
            _ => given,
        };
        let problem = |text: String| Err((text, Some(own)));
        if code == 337 && given != uniform {
            return problem(format!("broadcasts from lane {given}, and in another lane from {uniform}"));
        }
        if from as usize >= target.len() || active >> from & 1 == 0 {
            return problem(format!("takes a value of lane {from}, which is not active"));
        }
        target[lane].set(value[from as usize].get());
    }
    Ok(())
}

/// Code of the operation on words, and its neutral element.
fn arithmetic(code: u16) -> (u16, u32) {
    match code {
        349 => (128, 0),
        350 => (129, 0),
        351 => (132, 1),
        352 => (133, 1.0_f32.to_bits()),
        353 => (2039, i32::MAX as u32),
        354 => (2038, u32::MAX),
        355 => (2037, f32::INFINITY.to_bits()),
        356 => (2042, i32::MIN as u32),
        357 => (2041, 0),
        358 => (2040, f32::NEG_INFINITY.to_bits()),
        359 => (199, u32::MAX),
        361 => (198, 0),
        362 => (167, 1),
        // BitwiseOr, LogicalOr; LogicalXor was refused before.
        _ => (197, 0),
    }
}

/// Sums, products, minima and maxima. kind: over all active lanes, over those up to this one, over those below.
fn reduce(code: u16, kind: u8, target: Row, value: Row, active: u128) {
    let (code, neutral) = arithmetic(code);
    let mut sum = neutral;
    for lane in lanes_of(active) {
        let before = sum;
        sum = binary(code, [sum, value[lane].get()]).unwrap_or(sum);
        target[lane].set(if kind == 1 { sum } else { before });
    }
    if kind == 0 {
        lanes_of(active).for_each(|lane| target[lane].set(sum));
    }
}
