//! Declarations of a module: types, constants under a specialization, variables, functions.

use crate::arithmetic::{POISON, evaluate};
use std::collections::HashMap;

pub(crate) type Id = u32;

/// An instruction: its position in words from the module's start, its opcode, and its other words.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instruction<'m> {
    pub(crate) at: u32,
    pub(crate) opcode: u16,
    pub(crate) operands: &'m [u32],
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Type {
    /// Bool, 32-bit int or float.
    Scalar,
    Vector {
        of: Id,
        count: u32,
    },
    Matrix {
        of: Id,
        count: u32,
    },
    Array {
        of: Id,
        count: u32,
    },
    /// Its length depends on the bound buffer.
    Runtime {
        of: Id,
    },
    Struct(Vec<Id>),
    Pointer {
        class: u32,
        to: Id,
    },
    /// Void, functions, and types that are refused where they are used.
    Other,
}

/// A variable outside of functions.
#[derive(Clone, Debug)]
pub(crate) struct Variable {
    pub(crate) id: Id,
    pub(crate) class: u32,
    pub(crate) of: Id,
    pub(crate) initial: Option<Id>,
}

pub(crate) struct Function<'m> {
    pub(crate) parameters: Vec<Id>,
    /// Instructions from the first label on.
    pub(crate) body: Vec<Instruction<'m>>,
}

#[derive(Default)]
pub(crate) struct Module<'m> {
    pub(crate) types: HashMap<Id, Type>,
    /// Type and words of each constant; composites are flattened.
    pub(crate) constants: HashMap<Id, (Id, Vec<u32>)>,
    pub(crate) variables: Vec<Variable>,
    pub(crate) functions: HashMap<Id, Function<'m>>,
    pub(crate) entry: Id,
    pub(crate) workgroup_size: [u32; 3],
    names: HashMap<Id, String>,
    member_names: HashMap<Id, String>,
    decorations: HashMap<(Id, u32), u32>,
    member_decorations: HashMap<(Id, u32, u32), u32>,
    types_of_values: HashMap<Id, Id>,
}

const SPEC_ID: u32 = 1;
const ARRAY_STRIDE: u32 = 6;
const OFFSET: u32 = 35;
pub(crate) const BUILT_IN: u32 = 11;
pub(crate) const NON_WRITABLE: u32 = 24;
pub(crate) const BINDING: u32 = 33;

fn text(words: &[u32]) -> String {
    let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).take_while(|&b| b != 0).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}

/// The instructions of a module, behind its header.
fn instructions(words: &[u32]) -> Result<Vec<Instruction<'_>>, String> {
    if words.first() != Some(&0x0723_0203) {
        return Err("no SPIR-V".to_owned());
    }
    let (mut at, mut found) = (5, Vec::new());
    while let Some(&word) = words.get(at) {
        let (opcode, count) = (word as u16, (word >> 16) as usize);
        let Some(operands) = words.get(at + 1..at + count.max(1)) else {
            return Err(format!("truncated at word {at}"));
        };
        found.push(Instruction { at: at as u32, opcode, operands });
        at += count.max(1);
    }
    Ok(found)
}

/// True if an instruction within a function has a result: its type and id come first.
pub(crate) fn has_result(opcode: u16) -> bool {
    !matches!(opcode, 0 | 8 | 62 | 63 | 224 | 225 | 228 | 246..=255 | 317)
}

impl<'m> Module<'m> {
    pub(crate) fn new(words: &'m [u32], specialization: &[(u32, u32)]) -> Result<Self, String> {
        let mut module = Module { workgroup_size: [1; 3], ..Module::default() };
        let mut size_ids = None;
        let mut function: Option<(Id, Function<'m>)> = None;
        for instruction in instructions(words)? {
            let o = instruction.operands;
            match (instruction.opcode, &mut function) {
                (54, _) => function = Some((o[1], Function { parameters: Vec::new(), body: Vec::new() })),
                (55, Some((_, function))) => {
                    function.parameters.push(o[1]);
                    module.types_of_values.insert(o[1], o[0]);
                }
                (56, open) => module.functions.extend(open.take()),
                (opcode, Some((_, function))) => {
                    if has_result(opcode) {
                        module.types_of_values.insert(o[1], o[0]);
                    }
                    function.body.push(instruction);
                }
                (15, _) => module.entry = o[1],
                (16, _) if o[1] == 17 => module.workgroup_size = [o[2], o[3], o[4]],
                (331, _) if o[1] == 38 => size_ids = Some([o[2], o[3], o[4]]),
                _ => module.declare(instruction, specialization)?,
            }
        }
        if function.is_some() {
            return Err("truncated: a function without an end".to_owned());
        }
        for (axis, id) in size_ids.into_iter().flatten().enumerate() {
            module.workgroup_size[axis] = module.word(id)?;
        }
        Ok(module)
    }

    fn declare(&mut self, instruction: Instruction<'m>, specialization: &[(u32, u32)]) -> Result<(), String> {
        let o = instruction.operands;
        let specialized = |module: &Self, id: Id, usual: u32| {
            let wanted = module.decorations.get(&(id, SPEC_ID));
            let found = wanted.and_then(|wanted| specialization.iter().find(|(id, _)| id == wanted));
            found.map_or(usual, |found| found.1)
        };
        match instruction.opcode {
            5 => drop(self.names.insert(o[0], text(&o[1..]))),
            6 if o[1] == 0 => drop(self.member_names.insert(o[0], text(&o[2..]))),
            71 => drop(self.decorations.insert((o[0], o[1]), o.get(2).copied().unwrap_or(1))),
            72 => drop(self.member_decorations.insert((o[0], o[1], o[2]), o.get(3).copied().unwrap_or(1))),
            20 => self.put_type(o[0], Type::Scalar),
            21 | 22 => {
                let is_word = o[1] == 32;
                self.put_type(o[0], if is_word { Type::Scalar } else { Type::Other });
            }
            23 => self.put_type(o[0], Type::Vector { of: o[1], count: o[2] }),
            24 => self.put_type(o[0], Type::Matrix { of: o[1], count: o[2] }),
            28 => {
                let count = self.word(o[2])?;
                self.put_type(o[0], Type::Array { of: o[1], count });
            }
            29 => self.put_type(o[0], Type::Runtime { of: o[1] }),
            30 => self.put_type(o[0], Type::Struct(o[1..].to_vec())),
            32 => self.put_type(o[0], Type::Pointer { class: o[1], to: o[2] }),
            19 | 25..=27 | 33 => self.put_type(o[0], Type::Other),
            41 | 42 => self.put(o, vec![u32::from(instruction.opcode == 41)]),
            43 => self.put(o, o[2..].to_vec()),
            44 | 51 => {
                let parts: Result<Vec<_>, _> = o[2..].iter().map(|id| self.constant(*id)).collect();
                self.put(o, parts?.concat());
            }
            46 => {
                let words = self.size(o[0])?;
                self.put(o, vec![0; words as usize]);
            }
            1 => {
                let words = self.size(o[0])?;
                self.put(o, vec![POISON; words as usize]);
            }
            48 | 49 => self.put(o, vec![specialized(self, o[1], u32::from(instruction.opcode == 48))]),
            50 => self.put(o, vec![specialized(self, o[1], o[2])]),
            52 => {
                let value = self.operation(o)?;
                self.put(o, value);
            }
            59 => {
                let Some(Type::Pointer { class, to }) = self.types.get(&o[0]) else {
                    return Err(format!("variable {} has no pointer type", o[1]));
                };
                let (class, of) = (*class, *to);
                self.variables.push(Variable { id: o[1], class, of, initial: o.get(3).copied() });
            }
            _ => {}
        }
        Ok(())
    }

    fn put_type(&mut self, id: Id, of: Type) {
        self.types.insert(id, of);
    }

    fn put(&mut self, operands: &[u32], words: Vec<u32>) {
        self.constants.insert(operands[1], (operands[0], words));
    }

    /// Evaluates OpSpecConstantOp, component by component.
    fn operation(&self, o: &[u32]) -> Result<Vec<u32>, String> {
        let (code, ids) = (o[2] as u16, &o[3..]);
        if code == 81 {
            let words = self.constant(ids[0])?;
            return Ok(vec![words[ids[1] as usize]]);
        }
        let parts: Result<Vec<_>, _> = ids.iter().map(|id| self.constant(*id)).collect();
        let parts = parts?;
        let word = |part: &Vec<u32>, k: usize| part[if part.len() == 1 { 0 } else { k }];
        let value = |k| evaluate(code, &parts.iter().map(|part| word(part, k)).collect::<Vec<u32>>());
        let values: Option<Vec<u32>> = (0..self.size(o[0])? as usize).map(value).collect();
        values.ok_or_else(|| format!("constant {}: operation {code} is not supported", o[1]))
    }

    fn constant(&self, id: Id) -> Result<Vec<u32>, String> {
        self.constants.get(&id).map(|(_, words)| words.clone()).ok_or_else(|| format!("{id} is no constant"))
    }

    /// A constant of one word.
    pub(crate) fn word(&self, id: Id) -> Result<u32, String> {
        self.constant(id).map(|words| words[0])
    }

    pub(crate) fn type_of(&self, id: Id) -> Id {
        let constant = || self.constants.get(&id).map(|(of, _)| *of);
        self.types_of_values.get(&id).copied().or_else(constant).unwrap_or(0)
    }

    pub(crate) fn kind(&self, id: Id) -> &Type {
        self.types.get(&id).unwrap_or(&Type::Other)
    }

    /// Size of a type in words, packed.
    pub(crate) fn size(&self, id: Id) -> Result<u32, String> {
        match self.kind(id) {
            Type::Scalar => Ok(1),
            Type::Vector { of, count } | Type::Matrix { of, count } | Type::Array { of, count } => {
                Ok(self.size(*of)? * count)
            }
            Type::Struct(members) => members.iter().map(|member| self.size(*member)).sum(),
            other => Err(format!("type {id} ({other:?}) has no size here")),
        }
    }

    /// Offset in words and type of member or element `index`. `laid_out`: the offset follows the decorations, as the
    /// host sees it; otherwise it is packed.
    pub(crate) fn part(&self, id: Id, index: u32, laid_out: bool) -> Result<(u32, Id), String> {
        match self.kind(id) {
            Type::Struct(members) => {
                let of = *members.get(index as usize).ok_or("no such member")?;
                if laid_out {
                    let offset = self.member_decorations.get(&(id, index, OFFSET)).ok_or("no offset")?;
                    return Ok((offset / 4, of));
                }
                let before: Result<u32, String> =
                    members[..index as usize].iter().map(|member| self.size(*member)).sum();
                Ok((before?, of))
            }
            _ => {
                let (of, stride, _) = self.elements(id, laid_out)?;
                Ok((index.wrapping_mul(stride), of))
            }
        }
    }

    /// Type, stride in words and number of elements. A runtime array has the largest possible number.
    pub(crate) fn elements(&self, id: Id, laid_out: bool) -> Result<(Id, u32, u32), String> {
        let stride = |of: Id| match self.decorations.get(&(id, ARRAY_STRIDE)) {
            Some(bytes) if laid_out => Ok(bytes / 4),
            _ if laid_out => Err(format!("array {id} has no stride")),
            _ => self.size(of),
        };
        match self.kind(id) {
            Type::Vector { of, count } => Ok((*of, 1, *count)),
            Type::Matrix { .. } if laid_out => Err("matrices in buffers are not supported".to_owned()),
            Type::Matrix { of, count } => Ok((*of, self.size(*of)?, *count)),
            Type::Array { of, count } => Ok((*of, stride(*of)?, *count)),
            Type::Runtime { of } => Ok((*of, stride(*of)?, u32::MAX)),
            other => Err(format!("type {id} ({other:?}) has no elements")),
        }
    }

    /// Offsets of a type's words from its first.
    pub(crate) fn places(&self, id: Id, laid_out: bool) -> Result<Vec<u32>, String> {
        let count = match self.kind(id) {
            Type::Scalar => return Ok(vec![0]),
            Type::Struct(members) => members.len() as u32,
            _ => self.elements(id, laid_out)?.2,
        };
        let mut places = Vec::new();
        for index in 0..count {
            let (begin, of) = self.part(id, index, laid_out)?;
            places.extend(self.places(of, laid_out)?.iter().map(|place| begin + place));
        }
        Ok(places)
    }

    pub(crate) fn decoration(&self, id: Id, decoration: u32) -> Option<u32> {
        self.decorations.get(&(id, decoration)).copied()
    }

    /// Name of a variable. A block without a name has that of its first member.
    pub(crate) fn name(&self, variable: &Variable) -> String {
        let own = self.names.get(&variable.id).filter(|name| !name.is_empty());
        own.or_else(|| self.member_names.get(&variable.of)).cloned().unwrap_or_default()
    }
}
