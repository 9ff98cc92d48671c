//! A module's control flow as a flat list: functions are inlined, and blocks that the specialization makes
//! unreachable are omitted.

use crate::arithmetic::evaluate;
use crate::module::{BINDING, BUILT_IN, Id, Instruction, Module, NON_WRITABLE, Variable, has_result};
use crate::program::{Edge, Kind, Memory, NO_SLOT, Operation, Slot};
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

/// Target of a pointer.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Space {
    /// Slots of the invocation.
    Local,
    Memory {
        index: u32,
        laid_out: bool,
    },
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Pointer {
    pub(crate) space: Space,
    pub(crate) place: u32,
    pub(crate) offset: Slot,
    pub(crate) of: Id,
}

#[derive(Clone, Debug)]
pub(crate) enum Value {
    Words(Rc<[Slot]>),
    Pointer(Pointer),
}

/// A function that is being inlined.
struct Frame {
    outline: Rc<Outline>,
    values: HashMap<Id, Value>,
    labels: HashMap<Id, u32>,
    reached: HashSet<Id>,
    block: Id,
    exit: u32,
    result: Rc<[Slot]>,
}

pub(crate) struct Builder<'m> {
    pub(crate) module: &'m Module<'m>,
    pub(crate) operations: Vec<Operation>,
    pub(crate) sources: Vec<(u32, u16)>,
    pub(crate) moves: Vec<(Slot, Slot)>,
    /// Words of constants. Slot order: temporary slots of a block, constants, kept slots.
    pub(crate) constants: Vec<u32>,
    constant_slots: HashMap<u32, Slot>,
    temporary: u32,
    pub(crate) max_temporary: u32,
    first_constant: Slot,
    pub(crate) first_kept: Slot,
    kept: Slot,
    pub(crate) max_kept: Slot,
    pub(crate) inputs: Vec<(u32, Slot)>,
    pub(crate) initials: Vec<(Slot, u32)>,
    pub(crate) memories: Vec<Memory>,
    globals: HashMap<Id, Value>,
    frames: Vec<Frame>,
    outlines: HashMap<Id, Rc<Outline>>,
    /// First operation of each label.
    labels: Vec<u32>,
    source: (u32, u16),
}

impl<'m> Builder<'m> {
    pub(crate) fn new(module: &'m Module<'m>, (temporary, constants): (u32, u32)) -> Self {
        Self {
            module,
            operations: Vec::new(),
            sources: Vec::new(),
            moves: Vec::new(),
            constants: Vec::new(),
            constant_slots: HashMap::new(),
            temporary: 0,
            max_temporary: 0,
            first_constant: temporary,
            first_kept: temporary + constants,
            kept: temporary + constants,
            max_kept: temporary + constants,
            inputs: Vec::new(),
            initials: Vec::new(),
            memories: Vec::new(),
            globals: HashMap::new(),
            frames: Vec::new(),
            outlines: HashMap::new(),
            labels: Vec::new(),
            source: (0, 0),
        }
    }

    pub(crate) fn build(mut self) -> Result<Self, String> {
        for variable in &self.module.variables {
            self.global(variable)?;
        }
        let exit = self.label();
        self.copy_function(self.module.entry, Vec::new(), exit, Rc::new([]))?;
        self.place(exit);
        self.emit(Operation::End);
        Ok(self)
    }

    fn global(&mut self, variable: &Variable) -> Result<(), String> {
        let module = self.module;
        let name = module.name(variable);
        let decoration = |which| module.decoration(variable.id, which);
        let kind = match variable.class {
            1 | 6 => {
                let words = module.size(variable.of)?;
                let base = self.keep(words);
                if let Some(number) = decoration(BUILT_IN) {
                    self.inputs.push((number, base));
                }
                if let Some((_, words)) = variable.initial.and_then(|id| module.constants.get(&id)) {
                    self.initials.extend((base..).zip(words.iter().copied()));
                }
                let pointer = Pointer { space: Space::Local, place: base, offset: NO_SLOT, of: variable.of };
                self.globals.insert(variable.id, Value::Pointer(pointer));
                return Ok(());
            }
            2 | 12 => Kind::Buffer {
                binding: decoration(BINDING).ok_or_else(|| format!("{name} has no binding"))?,
                writable: variable.class == 12 && decoration(NON_WRITABLE).is_none(),
            },
            9 => Kind::Push,
            4 => Kind::Shared { words: module.size(variable.of)? },
            // Images: their reads are refused.
            _ => return Ok(()),
        };
        let index = self.memories.len() as u32;
        self.memories.push(Memory { name, kind });
        let space = Space::Memory { index, laid_out: variable.class != 4 };
        let pointer = Pointer { space, place: 0, offset: NO_SLOT, of: variable.of };
        self.globals.insert(variable.id, Value::Pointer(pointer));
        Ok(())
    }

    // ---- slots ----

    pub(crate) fn temporary(&mut self, words: u32) -> Slot {
        let slot = self.temporary;
        self.temporary += words;
        self.max_temporary = self.max_temporary.max(self.temporary);
        slot
    }

    fn keep(&mut self, words: u32) -> Slot {
        let slot = self.kept;
        self.kept += words;
        self.max_kept = self.max_kept.max(self.kept);
        slot
    }

    pub(crate) fn constant(&mut self, word: u32) -> Slot {
        let next = self.first_constant + self.constants.len() as u32;
        let slot = *self.constant_slots.entry(word).or_insert(next);
        if slot == next {
            self.constants.push(word);
        }
        slot
    }

    pub(crate) fn known(&self, slot: Slot) -> Option<u32> {
        self.constants.get(slot.checked_sub(self.first_constant)? as usize).copied()
    }

    pub(crate) fn emit(&mut self, operation: Operation) {
        self.operations.push(operation);
        self.sources.push(self.source);
    }

    /// Emits an operation on words, or computes it if all operands are constants.
    pub(crate) fn compute(&mut self, code: u16, operands: &[Slot]) -> Result<Slot, String> {
        let known: Option<Vec<u32>> = operands.iter().map(|slot| self.known(*slot)).collect();
        if evaluate(code, &vec![1; operands.len()]).is_none() {
            return Err(format!("operation {code} is not supported"));
        }
        if let Some(word) = known.and_then(|words| evaluate(code, &words)) {
            return Ok(self.constant(word));
        }
        let target = self.temporary(1);
        self.emit(match *operands {
            [a] => Operation::Unary { code, target, a },
            [a, b] => Operation::Binary { code, target, a, b },
            [a, b, c] => Operation::Ternary { code, target, a, b, c },
            _ => return Err("operands".to_owned()),
        });
        Ok(target)
    }

    /// Copies a value for other blocks; constants and kept slots need no copy.
    fn kept_copy(&mut self, from: Slot) -> Slot {
        if from == NO_SLOT || from >= self.first_constant {
            return from;
        }
        let target = self.keep(1);
        self.emit(Operation::CopyActive { target, from });
        target
    }

    // ---- values ----

    fn frame(&mut self) -> Result<&mut Frame, String> {
        self.frames.last_mut().ok_or_else(|| "outside of a function".to_owned())
    }

    pub(crate) fn define(&mut self, id: Id, value: Value) -> Result<(), String> {
        let crosses = self.frame()?.outline.crossing.contains(&id);
        let value = if crosses { self.kept_value(value) } else { value };
        self.frame()?.values.insert(id, value);
        Ok(())
    }

    fn kept_value(&mut self, value: Value) -> Value {
        match value {
            Value::Words(slots) => Value::Words(slots.iter().map(|slot| self.kept_copy(*slot)).collect()),
            Value::Pointer(pointer) => {
                Value::Pointer(Pointer { offset: self.kept_copy(pointer.offset), ..pointer })
            }
        }
    }

    pub(crate) fn define_words(&mut self, id: Id, slots: Vec<Slot>) -> Result<(), String> {
        self.define(id, Value::Words(slots.into()))
    }

    fn value(&mut self, id: Id) -> Result<Value, String> {
        let local = self.frames.last().and_then(|frame| frame.values.get(&id));
        if let Some(value) = local.or_else(|| self.globals.get(&id)) {
            return Ok(value.clone());
        }
        let (_, words) = self.module.constants.get(&id).ok_or_else(|| format!("value {id} is not known"))?;
        Ok(Value::Words(words.iter().map(|word| self.constant(*word)).collect()))
    }

    pub(crate) fn words(&mut self, id: Id) -> Result<Rc<[Slot]>, String> {
        match self.value(id)? {
            Value::Words(slots) => Ok(slots),
            Value::Pointer(_) => Err(format!("value {id} is a pointer")),
        }
    }

    pub(crate) fn pointer(&mut self, id: Id) -> Result<Pointer, String> {
        match self.value(id)? {
            Value::Pointer(pointer) => Ok(pointer),
            Value::Words(_) => Err(format!("value {id} is no pointer")),
        }
    }

    // ---- control flow ----

    fn label(&mut self) -> u32 {
        self.labels.push(u32::MAX);
        self.labels.len() as u32 - 1
    }

    fn place(&mut self, label: u32) {
        self.labels[label as usize] = self.operations.len() as u32;
        self.temporary = 0;
    }

    /// Numbers blocks in the order of their operations, and renames branches accordingly. Returns each block's first
    /// operation.
    pub(crate) fn number_blocks(&mut self) -> Vec<u32> {
        let mut placed: Vec<u32> = self.labels.iter().copied().filter(|at| *at != u32::MAX).collect();
        placed.sort_unstable();
        placed.dedup();
        let number = |edge: &mut Edge| {
            let at = self.labels[edge.block as usize];
            edge.block = placed.binary_search(&at).unwrap_or(usize::MAX) as u32;
        };
        for operation in &mut self.operations {
            match operation {
                Operation::Jump(edge) => number(edge),
                Operation::Branch { yes, no, .. } => [yes, no].into_iter().for_each(number),
                _ => {}
            }
        }
        placed
    }

    fn outline(&mut self, id: Id) -> Result<Rc<Outline>, String> {
        if let Some(outline) = self.outlines.get(&id) {
            return Ok(outline.clone());
        }
        let body = &self.module.functions.get(&id).ok_or("a call of no function")?.body;
        let outline = Rc::new(Outline::new(body)?);
        self.outlines.insert(id, outline.clone());
        Ok(outline)
    }

    fn copy_function(
        &mut self,
        id: Id,
        arguments: Vec<Value>,
        exit: u32,
        result: Rc<[Slot]>,
    ) -> Result<(), String> {
        let outline = self.outline(id)?;
        let function = &self.module.functions[&id];
        let mut frame = Frame {
            outline,
            values: function.parameters.iter().copied().zip(arguments).collect(),
            labels: HashMap::new(),
            reached: HashSet::new(),
            block: 0,
            exit,
            result,
        };
        for instruction in function.body.iter().filter(|i| i.opcode == 248) {
            frame.labels.insert(instruction.operands[0], self.label());
        }
        frame.reached.extend(function.body.first().map(|first| first.operands[0]));
        self.frames.push(frame);
        let mut is_reached = false;
        for instruction in &function.body {
            self.source = (instruction.at, instruction.opcode);
            if instruction.opcode == 248 {
                let label = instruction.operands[0];
                let frame = self.frame()?;
                is_reached = frame.reached.contains(&label);
                frame.block = label;
                let number = frame.labels[&label];
                if is_reached {
                    self.place(number);
                }
            } else if is_reached {
                self.instruction(instruction).map_err(|problem| {
                    format!("word {} (opcode {}): {problem}", instruction.at, instruction.opcode)
                })?;
            }
        }
        self.frames.pop();
        Ok(())
    }

    fn instruction(&mut self, instruction: &Instruction<'m>) -> Result<(), String> {
        let o = instruction.operands;
        match instruction.opcode {
            // Line information, and structure that the order of blocks already gives.
            0 | 8 | 245..=247 | 317 => Ok(()),
            249 => {
                let edge = self.edge(o[0])?;
                self.emit(Operation::Jump(edge));
                Ok(())
            }
            250 => {
                let condition = self.words(o[0])?[0];
                let operation = match self.known(condition) {
                    Some(word) => Operation::Jump(self.edge(o[if word != 0 { 1 } else { 2 }])?),
                    None => Operation::Branch { condition, yes: self.edge(o[1])?, no: self.edge(o[2])? },
                };
                self.emit(operation);
                Ok(())
            }
            252 | 255 => {
                self.emit(Operation::End);
                Ok(())
            }
            253 | 254 => {
                if instruction.opcode == 254 {
                    let from = self.words(o[0])?;
                    let result = self.frame()?.result.clone();
                    for (&target, &from) in result.iter().zip(from.iter()) {
                        self.emit(Operation::CopyActive { target, from });
                    }
                }
                let block = self.frame()?.exit;
                self.emit(Operation::Jump(Edge { block, moves: (0, 0) }));
                Ok(())
            }
            57 => self.call(o),
            59 => {
                let of = self.pointee(o[0])?;
                let words = self.module.size(of)?;
                let place = self.keep(words);
                if let Some(initial) = o.get(3) {
                    for (target, &from) in (place..).zip(self.words(*initial)?.iter()) {
                        self.emit(Operation::CopyActive { target, from });
                    }
                }
                self.define(o[1], Value::Pointer(Pointer { space: Space::Local, place, offset: NO_SLOT, of }))
            }
            _ => self.values(instruction),
        }
    }

    fn call(&mut self, o: &[u32]) -> Result<(), String> {
        let words = self.module.size(o[0]).unwrap_or(0);
        let first = self.keep(words);
        let result: Rc<[Slot]> = (first..first + words).collect();
        let kept = self.kept;
        let arguments: Result<Vec<_>, _> = o[3..].iter().map(|id| self.value(*id)).collect();
        let arguments = arguments?.into_iter().map(|value| self.kept_value(value)).collect();
        let (exit, source) = (self.label(), self.source);
        self.copy_function(o[2], arguments, exit, result.clone())?;
        self.source = source;
        self.place(exit);
        self.kept = kept;
        self.define(o[1], Value::Words(result))
    }

    /// The branch to a block of the function, with the values of its phis.
    fn edge(&mut self, label: Id) -> Result<Edge, String> {
        let frame = self.frame()?;
        frame.reached.insert(label);
        let (block, here) = (frame.labels[&label], frame.block);
        let outline = frame.outline.clone();
        let begin = self.moves.len() as u32;
        for (phi, pairs) in outline.phis.get(&label).into_iter().flatten() {
            let pair =
                pairs.chunks_exact(2).find(|pair| pair[1] == here).ok_or("a phi without this block")?;
            let from = self.words(pair[0])?;
            if !self.frame()?.values.contains_key(phi) {
                let first = self.keep(from.len() as u32);
                let slots = (first..first + from.len() as u32).collect();
                self.frame()?.values.insert(*phi, Value::Words(slots));
            }
            let targets = self.words(*phi)?;
            self.moves.extend(targets.iter().copied().zip(from.iter().copied()));
        }
        Ok(Edge { block, moves: (begin, self.moves.len() as u32) })
    }
}

// ---- outlines ----

/// Values read outside their blocks, and the phis of blocks.
#[derive(Default)]
struct Outline {
    crossing: HashSet<Id>,
    phis: HashMap<Id, Vec<(Id, Vec<u32>)>>,
}

impl Outline {
    fn new(body: &[Instruction]) -> Result<Self, String> {
        check_order(body)?;
        Ok(outline_of(body))
    }
}

/// Checks that merge blocks follow their constructs and that only the ends of loops branch back. Waiting lanes then
/// always meet at the first block that any of them has reached.
fn check_order(body: &[Instruction]) -> Result<(), String> {
    let labels = body.iter().filter(|i| i.opcode == 248).map(|i| i.operands[0]);
    let places: HashMap<Id, usize> = labels.enumerate().map(|(place, label)| (label, place)).collect();
    let (mut here, mut ends) = (0, HashMap::new());
    for instruction in body {
        let o = instruction.operands;
        let place = |index: usize| places.get(&o[index]).copied().unwrap_or(0);
        let is_ordered = match instruction.opcode {
            248 => {
                here = place(0);
                true
            }
            247 => here < place(0),
            246 => {
                ends.insert(here, place(1)..place(0));
                here <= place(1) && place(1) < place(0)
            }
            249 | 250 => (usize::from(instruction.opcode == 250)..o.len().min(3)).all(|index| {
                let target = place(index);
                target > here || ends.get(&target).is_some_and(|end| end.contains(&here))
            }),
            _ => true,
        };
        if !is_ordered {
            return Err(format!("word {}: blocks in an order that is not supported", instruction.at));
        }
    }
    Ok(())
}

/// Values read outside their blocks (a call ends a block), and the phis of each block.
fn outline_of(body: &[Instruction]) -> Outline {
    let mut outline = Outline::default();
    let mut made: HashMap<Id, u32> = HashMap::new();
    let (mut part, mut block) = (0, 0);
    for instruction in body {
        let o = instruction.operands;
        match instruction.opcode {
            248 => (part, block) = (part + 1, o[0]),
            245 => {
                outline.crossing.extend(o[2..].chunks_exact(2).map(|pair| pair[0]));
                outline.phis.entry(block).or_default().push((o[1], o[2..].to_vec()));
            }
            opcode => {
                let read = if has_result(opcode) { &o[2..] } else { o };
                outline.crossing.extend(read.iter().filter(|id| made.get(id).is_some_and(|at| *at != part)));
                if has_result(opcode) {
                    // A call's result lies in kept slots.
                    part += u32::from(opcode == 57);
                    made.insert(o[1], part);
                }
            }
        }
    }
    outline
}
