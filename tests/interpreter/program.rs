//! A module under a specialization, as one flat list of operations on slots. A slot has one word per lane.
//!
//! Calls are inlined. Blocks keep their order, in which a merge block follows all blocks of its construct.

use crate::builder::Builder;
use crate::module::Module;

pub(crate) type Slot = u32;

/// Marks a missing slot.
pub(crate) const NO_SLOT: Slot = u32::MAX;

/// Target of a branch: a block, and the moves for its phis (range in [`Program::moves`]).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Edge {
    pub(crate) block: u32,
    pub(crate) moves: (u32, u32),
}

/// A word in a memory: `place` words from its start, plus the value of the slot `offset`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Address {
    pub(crate) memory: u32,
    pub(crate) place: u32,
    pub(crate) offset: Slot,
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Operation {
    Unary {
        code: u16,
        target: Slot,
        a: Slot,
    },
    Binary {
        code: u16,
        target: Slot,
        a: Slot,
        b: Slot,
    },
    Ternary {
        code: u16,
        target: Slot,
        a: Slot,
        b: Slot,
        c: Slot,
    },
    /// Copies in all lanes, for slots that no other block reads; or in active lanes only.
    Copy {
        target: Slot,
        from: Slot,
    },
    CopyActive {
        target: Slot,
        from: Slot,
    },
    /// target = before + index * stride, if index is below the count.
    Index {
        target: Slot,
        before: Slot,
        index: Slot,
        stride: u32,
        count: u32,
    },
    LoadLocal {
        target: Slot,
        base: Slot,
        offset: Slot,
    },
    StoreLocal {
        base: Slot,
        offset: Slot,
        from: Slot,
    },
    Load {
        target: Slot,
        address: Address,
    },
    Store {
        from: Slot,
        address: Address,
    },
    Atomic {
        code: u16,
        target: Slot,
        value: Slot,
        address: Address,
    },
    Group {
        code: u16,
        kind: u8,
        target: Slot,
        value: Slot,
        other: Slot,
    },
    Barrier {
        of_workgroup: bool,
        semantics: u32,
    },
    MemoryBarrier {
        semantics: u32,
    },
    Jump(Edge),
    Branch {
        condition: Slot,
        yes: Edge,
        no: Edge,
    },
    End,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Buffer { binding: u32, writable: bool },
    Push,
    Shared { words: u32 },
}

/// A storage or uniform buffer, the push constants, or a shared variable.
#[derive(Clone, Debug)]
pub(crate) struct Memory {
    pub(crate) name: String,
    pub(crate) kind: Kind,
}

/// A kernel under a specialization and with a subgroup size, ready to [`run`](Program::run).
#[derive(Debug)]
pub struct Program {
    pub(crate) name: String,
    pub(crate) lanes: usize,
    pub(crate) workgroup_size: [u32; 3],
    pub(crate) operations: Vec<Operation>,
    /// Word in the module and opcode of each operation.
    pub(crate) sources: Vec<(u32, u16)>,
    /// Moves of phis: (target, from).
    pub(crate) moves: Vec<(Slot, Slot)>,
    /// First operation of each block.
    pub(crate) blocks: Vec<u32>,
    pub(crate) slots: usize,
    pub(crate) constants: Vec<(Slot, u32)>,
    /// Range of the slots that keep words from block to block.
    pub(crate) kept: (Slot, Slot),
    /// Built-in variables: number, first slot.
    pub(crate) inputs: Vec<(u32, Slot)>,
    /// Initial words of the invocations' variables.
    pub(crate) initials: Vec<(Slot, u32)>,
    pub(crate) memories: Vec<Memory>,
}

impl Program {
    /// Builds a program from a module. `specialization`: (constant_id, bits). `lanes`: subgroup size, a power of two
    /// from 1 to 128 that divides the workgroup.
    ///
    /// # Errors
    /// A module that is no SPIR-V, or unsupported instructions: images, 64-bit types, atomics on floats, and others
    /// that the kernels do not use.
    pub fn new(name: &str, words: &[u32], specialization: &[(u32, u32)], lanes: u32) -> Result<Self, String> {
        let in_kernel = |problem| format!("{name}: {problem}");
        if !lanes.is_power_of_two() || lanes > 128 {
            return Err(in_kernel(format!("subgroups of {lanes}: no power of two up to 128")));
        }
        let module = Module::new(words, specialization).map_err(in_kernel)?;
        let [x, y, z] = module.workgroup_size;
        if !(x * y * z).is_multiple_of(lanes) {
            return Err(in_kernel(format!(
                "a workgroup of {x} x {y} x {z} has no full subgroups of {lanes}"
            )));
        }
        // A first build counts the slots.
        let counted = Builder::new(&module, (1 << 20, 1 << 20)).build().map_err(in_kernel)?;
        let mut built = Builder::new(&module, (counted.max_temporary, counted.constants.len() as u32))
            .build()
            .map_err(in_kernel)?;
        let blocks = built.number_blocks();
        let first_constant = built.max_temporary;
        let constants = (first_constant..).zip(built.constants).collect();
        Ok(Self {
            name: name.to_owned(),
            lanes: lanes as usize,
            workgroup_size: module.workgroup_size,
            operations: built.operations,
            sources: built.sources,
            moves: built.moves,
            blocks,
            slots: built.max_kept as usize,
            constants,
            kept: (built.first_kept, built.max_kept),
            inputs: built.inputs,
            initials: built.initials,
            memories: built.memories,
        })
    }
}
