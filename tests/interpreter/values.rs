//! Instructions with results: arithmetic, composites, memory, subgroups.

use crate::arithmetic::{EXTENDED, MULTIPLY_HIGH};
use crate::builder::{Builder, Pointer, Space, Value};
use crate::module::{Id, Instruction, Type};
use crate::program::{Address, NO_SLOT, Operation, Slot};

const F_ADD: u16 = 129;
const F_SUBTRACT: u16 = 131;
const F_MULTIPLY: u16 = 133;
const F_DIVIDE: u16 = 136;
const SQRT: u16 = EXTENDED + 31;

impl Builder<'_> {
    pub(crate) fn pointee(&self, of: Id) -> Result<Id, String> {
        match self.module.kind(of) {
            Type::Pointer { to, .. } => Ok(*to),
            other => Err(format!("{other:?} is no pointer type")),
        }
    }

    pub(crate) fn values(&mut self, instruction: &Instruction) -> Result<(), String> {
        let o = instruction.operands;
        match instruction.opcode {
            61 => {
                let pointer = self.pointer(o[2])?;
                let slots = self.load(pointer)?;
                self.define_words(o[1], slots)
            }
            62 => {
                let (pointer, from) = (self.pointer(o[0])?, self.words(o[1])?);
                self.store(pointer, &from)
            }
            65 | 66 => {
                let pointer = self.pointer(o[2])?;
                let pointer = self.chain(pointer, &o[3..])?;
                self.define(o[1], Value::Pointer(pointer))
            }
            224 => {
                let [of, semantics] = [self.module.word(o[0])?, self.module.word(o[2])?];
                if !matches!(of, 2 | 3) {
                    return Err(format!("a barrier of scope {of}"));
                }
                self.emit(Operation::Barrier { of_workgroup: of == 2, semantics });
                Ok(())
            }
            225 => {
                let semantics = self.module.word(o[1])?;
                self.emit(Operation::MemoryBarrier { semantics });
                Ok(())
            }
            227..=242 => self.atomic(instruction),
            333..=363 => self.group(instruction),
            _ => {
                let slots = self.words_of(instruction)?;
                self.define_words(o[1], slots)
            }
        }
    }

    /// The words of an instruction that only computes.
    fn words_of(&mut self, instruction: &Instruction) -> Result<Vec<Slot>, String> {
        let o = instruction.operands;
        match instruction.opcode {
            1 => Ok((0..self.module.size(o[0])?).map(|_| self.constant(crate::arithmetic::POISON)).collect()),
            12 => self.extended(o[3] as u16, &o[4..]),
            77 => {
                let (vector, index) = (self.contiguous(o[2])?, self.words(o[3])?[0]);
                let count = self.words(o[2])?.len() as u32;
                let offset = self.index(NO_SLOT, index, 1, count);
                let target = self.temporary(1);
                self.emit(Operation::LoadLocal { target, base: vector, offset });
                Ok(vec![target])
            }
            79 => {
                let both = [self.words(o[2])?, self.words(o[3])?].concat();
                Ok(o[4..].iter().map(|&k| both.get(k as usize).copied().unwrap_or(both[0])).collect())
            }
            80 => {
                let parts: Result<Vec<_>, _> = o[2..].iter().map(|id| self.words(*id)).collect();
                Ok(parts?.concat())
            }
            81 => {
                let words = self.words(o[2])?;
                let (begin, end) = self.part_of(self.module.type_of(o[2]), &o[3..])?;
                Ok(words[begin..end].to_vec())
            }
            82 => {
                let (part, whole) = (self.words(o[2])?, self.words(o[3])?);
                let (begin, end) = self.part_of(o[0], &o[4..])?;
                Ok([&whole[..begin], &part[..], &whole[end..]].concat())
            }
            83 | 400 => Ok(self.words(o[2])?.to_vec()),
            84 => {
                let words = self.words(o[2])?;
                let (_, rows, columns) = self.module.elements(o[0], false)?;
                Ok((0..columns)
                    .flat_map(|c| (0..rows).map(move |r| (c, r)))
                    .map(|(c, r)| words[(r * columns + c) as usize])
                    .collect())
            }
            142 | 143 => {
                let factor = self.words(o[3])?[0];
                let words = self.words(o[2])?;
                words.iter().map(|word| self.compute(F_MULTIPLY, &[*word, factor])).collect()
            }
            144 => {
                let (vector, matrix) = (self.words(o[2])?, self.words(o[3])?);
                matrix.chunks(vector.len()).map(|column| self.dot(&vector, column)).collect()
            }
            145 => {
                let (matrix, vector) = (self.words(o[2])?, self.words(o[3])?);
                self.transformed(&matrix, &vector)
            }
            146 => {
                let (left, right) = (self.words(o[2])?, self.words(o[3])?);
                let (_, rows, _) = self.module.elements(o[0], false)?;
                let columns = right.chunks(left.len() / rows as usize);
                let columns: Result<Vec<_>, _> =
                    columns.map(|column| self.transformed(&left, column)).collect();
                Ok(columns?.concat())
            }
            148 => {
                let (a, b) = (self.words(o[2])?, self.words(o[3])?);
                Ok(vec![self.dot(&a, &b)?])
            }
            151 => {
                let (a, b) = (self.words(o[2])?, self.words(o[3])?);
                [132, MULTIPLY_HIGH].into_iter().map(|code| self.compute(code, &[a[0], b[0]])).collect()
            }
            // Any, All
            code @ (154 | 155) => {
                let words = self.words(o[2])?;
                let code = if code == 154 { 166 } else { 167 };
                let rest = &words[1..];
                let all: Result<Slot, String> =
                    rest.iter().try_fold(words[0], |all, word| self.compute(code, &[all, *word]));
                Ok(vec![all?])
            }
            code => self.by_component(code, &o[2..]),
        }
    }

    /// Applies an operation to each component. A scalar operand applies to all components.
    fn by_component(&mut self, code: u16, ids: &[Id]) -> Result<Vec<Slot>, String> {
        let operands: Result<Vec<_>, _> = ids.iter().map(|id| self.words(*id)).collect();
        let operands = operands?;
        let count = operands.iter().map(|words| words.len()).max().unwrap_or(0);
        let at = |k: usize| operands.iter().map(|words| words[k.min(words.len() - 1)]).collect::<Vec<_>>();
        // Also structures and arrays, which Select may choose.
        (0..count).map(at).map(|slots| self.compute(code, &slots)).collect()
    }

    fn dot(&mut self, a: &[Slot], b: &[Slot]) -> Result<Slot, String> {
        let mut sum = self.compute(F_MULTIPLY, &[a[0], b[0]])?;
        for (a, b) in a.iter().zip(b).skip(1) {
            let product = self.compute(F_MULTIPLY, &[*a, *b])?;
            sum = self.compute(F_ADD, &[sum, product])?;
        }
        Ok(sum)
    }

    fn transformed(&mut self, matrix: &[Slot], vector: &[Slot]) -> Result<Vec<Slot>, String> {
        let rows = matrix.len() / vector.len();
        let row = |row: usize| matrix.iter().skip(row).step_by(rows).copied().collect::<Vec<_>>();
        (0..rows).map(|k| self.dot(&row(k), vector)).collect()
    }

    fn extended(&mut self, code: u16, ids: &[Id]) -> Result<Vec<Slot>, String> {
        match code {
            // Length, Distance
            66 | 67 => {
                let mut difference = self.words(ids[0])?.to_vec();
                if code == 67 {
                    difference = self.by_component(F_SUBTRACT, ids)?;
                }
                let square = self.dot(&difference, &difference)?;
                Ok(vec![self.compute(SQRT, &[square])?])
            }
            // Cross
            68 => {
                let (a, b) = (self.words(ids[0])?, self.words(ids[1])?);
                (0..3)
                    .map(|k| {
                        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
                        let plus = self.compute(F_MULTIPLY, &[a[i], b[j]])?;
                        let minus = self.compute(F_MULTIPLY, &[a[j], b[i]])?;
                        self.compute(F_SUBTRACT, &[plus, minus])
                    })
                    .collect()
            }
            // Normalize
            69 => {
                let words = self.words(ids[0])?;
                let square = self.dot(&words, &words)?;
                let length = self.compute(SQRT, &[square])?;
                words.iter().map(|word| self.compute(F_DIVIDE, &[*word, length])).collect()
            }
            _ => self.by_component(EXTENDED + code, ids),
        }
    }

    /// Range of a part's words in a composite.
    fn part_of(&self, of: Id, indices: &[u32]) -> Result<(usize, usize), String> {
        let (mut begin, mut of) = (0, of);
        for index in indices {
            let (place, part) = self.module.part(of, *index, false)?;
            begin += place;
            of = part;
        }
        Ok((begin as usize, (begin + self.module.size(of)?) as usize))
    }

    /// Copies a value's words into contiguous slots.
    fn contiguous(&mut self, id: Id) -> Result<Slot, String> {
        let words = self.words(id)?;
        let first = self.temporary(words.len() as u32);
        for (target, &from) in (first..).zip(words.iter()) {
            self.emit(Operation::Copy { target, from });
        }
        Ok(first)
    }

    // ---- memory ----

    fn index(&mut self, before: Slot, index: Slot, stride: u32, count: u32) -> Slot {
        let target = self.temporary(1);
        self.emit(Operation::Index { target, before, index, stride, count });
        target
    }

    fn chain(&mut self, mut pointer: Pointer, indices: &[Id]) -> Result<Pointer, String> {
        let laid_out = matches!(pointer.space, Space::Memory { laid_out: true, .. });
        for id in indices {
            let index = self.words(*id)?[0];
            if let (Type::Struct(_), Some(member)) = (self.module.kind(pointer.of), self.known(index)) {
                let (place, of) = self.module.part(pointer.of, member, laid_out)?;
                pointer = Pointer { place: pointer.place + place, of, ..pointer };
                continue;
            }
            let (of, stride, count) = self.module.elements(pointer.of, laid_out)?;
            pointer.of = of;
            match self.known(index) {
                Some(index) if index < count && count < u32::MAX => pointer.place += index * stride,
                _ => pointer.offset = self.index(pointer.offset, index, stride, count),
            }
        }
        Ok(pointer)
    }

    fn load(&mut self, pointer: Pointer) -> Result<Vec<Slot>, String> {
        let places = self.places(pointer)?;
        let first = self.temporary(places.len() as u32);
        for (target, place) in (first..).zip(&places) {
            let (base, offset) = (pointer.place + place, pointer.offset);
            self.emit(match pointer.space {
                Space::Local if offset == NO_SLOT => Operation::Copy { target, from: base },
                Space::Local => Operation::LoadLocal { target, base, offset },
                Space::Memory { index: memory, .. } => {
                    Operation::Load { target, address: Address { memory, place: base, offset } }
                }
            });
        }
        Ok((first..first + places.len() as u32).collect())
    }

    fn store(&mut self, pointer: Pointer, words: &[Slot]) -> Result<(), String> {
        let places = self.places(pointer)?;
        for (&from, place) in words.iter().zip(&places) {
            let (base, offset) = (pointer.place + place, pointer.offset);
            self.emit(match pointer.space {
                Space::Local if offset == NO_SLOT => Operation::CopyActive { target: base, from },
                Space::Local => Operation::StoreLocal { base, offset, from },
                Space::Memory { index: memory, .. } => {
                    Operation::Store { from, address: Address { memory, place: base, offset } }
                }
            });
        }
        Ok(())
    }

    fn places(&self, pointer: Pointer) -> Result<Vec<u32>, String> {
        self.module.places(pointer.of, matches!(pointer.space, Space::Memory { laid_out: true, .. }))
    }

    fn atomic(&mut self, instruction: &Instruction) -> Result<(), String> {
        let o = instruction.operands;
        let code = instruction.opcode;
        // Load, Exchange, IAdd, ISub, SMin, UMin, SMax, UMax, And, Or, Xor
        if !matches!(code, 227 | 229 | 234..=242) {
            return Err("this atomic is not supported".to_owned());
        }
        let pointer = self.pointer(o[2])?;
        let Space::Memory { index: memory, .. } = pointer.space else {
            return Err("an atomic on a variable of the invocation".to_owned());
        };
        let value = o.get(5).map_or(Ok(NO_SLOT), |id| self.words(*id).map(|words| words[0]))?;
        let target = self.temporary(1);
        let address = Address { memory, place: pointer.place, offset: pointer.offset };
        self.emit(Operation::Atomic { code, target, value, address });
        self.define_words(o[1], vec![target])
    }

    // ---- subgroups ----

    fn group(&mut self, instruction: &Instruction) -> Result<(), String> {
        let (o, code) = (instruction.operands, instruction.opcode);
        let one = |builder: &mut Self, kind: u32, value: Slot, other: Slot| {
            let target = builder.temporary(if code == 339 { 4 } else { 1 });
            builder.emit(Operation::Group { code, kind: kind as u8, target, value, other });
            target
        };
        let slots = match code {
            333 => vec![one(self, 0, NO_SLOT, NO_SLOT)],
            // All, Any, BroadcastFirst
            334 | 335 | 338 => {
                let words = self.words(o[3])?;
                words.iter().map(|word| one(self, 0, *word, NO_SLOT)).collect()
            }
            339 => {
                let value = self.words(o[3])?[0];
                let first = one(self, 0, value, NO_SLOT);
                (first..first + 4).collect()
            }
            342 => {
                let value = self.contiguous(o[4])?;
                vec![one(self, o[3], value, NO_SLOT)]
            }
            // FindLSB, FindMSB
            343 | 344 => {
                let value = self.contiguous(o[3])?;
                vec![one(self, 0, value, NO_SLOT)]
            }
            // Broadcast, Shuffle, ShuffleXor, ShuffleUp, ShuffleDown
            337 | 345..=348 => {
                let (words, other) = (self.words(o[3])?, self.words(o[4])?[0]);
                words.iter().map(|word| one(self, 0, *word, other)).collect()
            }
            349..=363 if o[3] < 3 => {
                let words = self.words(o[4])?;
                words.iter().map(|word| one(self, o[3], *word, NO_SLOT)).collect()
            }
            _ => return Err("this operation of subgroups is not supported".to_owned()),
        };
        self.define_words(o[1], slots)
    }
}
