//! Analysis of a function before it is inlined: values used by other blocks, phis, and a check of the order of
//! blocks.

use std::collections::{HashMap, HashSet};

use crate::module::{Id, Instruction, has_result};

/// Values read outside their blocks, and the phis of blocks.
#[derive(Default)]
pub(crate) struct Outline {
    pub(crate) crossing: HashSet<Id>,
    pub(crate) phis: HashMap<Id, Vec<(Id, Vec<u32>)>>,
}

impl Outline {
    pub(crate) fn new(body: &[Instruction]) -> Result<Self, String> {
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
