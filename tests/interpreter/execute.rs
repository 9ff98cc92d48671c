//! Runs a program: one workgroup after another, and within each its subgroups from barrier to barrier.

use crate::arithmetic::POISON;
use crate::lockstep::{Problem, Subgroup};
use crate::memory::{Arrivals, Words};
use crate::program::{Kind, Memory, Program};
use std::cell::Cell;
use std::fmt;

/// Order of workgroups, and of a workgroup's subgroups between barriers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Ascending.
    Forward,
    /// Descending.
    Reverse,
    /// Random with this seed.
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
    /// Number of workgroups per axis.
    pub workgroups: [u32; 3],
    /// Push constants.
    pub push: &'a [u8],
    /// Order of workgroups and subgroups.
    pub order: Order,
    /// Allows reads of unwritten shared memory, as NaN. For kernels that drop the values.
    pub accepts_unwritten_shared: bool,
}

/// A violation of the specifications, and its location.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The kernel.
    pub kernel: String,
    /// Description of the violation.
    pub problem: String,
    /// Word of the instruction in the module.
    pub word: u32,
    /// Opcode of the instruction.
    pub opcode: u16,
    /// The workgroup.
    pub workgroup: [u32; 3],
    /// Subgroup in the workgroup.
    pub subgroup: u32,
    /// Lane in the subgroup; None for all.
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

impl Program {
    /// Runs a dispatch over buffers (binding, words) in place.
    ///
    /// # Errors
    /// The kernel's first violation of the specifications. Buffers are then unchanged.
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
        let [x, y, z] = dispatch.workgroups;
        let arrivals: Arrivals = vec![Cell::new(0); (x * y * z) as usize].into();
        let memory = |memory: &Memory| Words::new(memory, words(memory.kind), accepts, arrivals.clone());
        let mut memories: Vec<Words> = self.memories.iter().map(memory).collect();
        let count = self.workgroup_size.iter().product::<u32>() / self.lanes as u32;
        let mut subgroups: Vec<Subgroup> = (0..count).map(|number| Subgroup::new(self, number)).collect();
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
        let fault = |subgroup: &Subgroup, operation: usize, (problem, lane): Problem| {
            let (word, opcode) = self.sources[operation];
            let (kernel, subgroup) = (self.name.clone(), subgroup.number);
            Fault { kernel, problem, word, opcode, workgroup: at, subgroup, lane }
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
