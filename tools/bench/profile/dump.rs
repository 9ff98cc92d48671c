//! `--dump DIR`: the SPIR-V of each kernel, with counts of its instructions.

use ashsplat::Result;
use ashsplat::kernels::visit_all;
use ashsplat::vk::{KernelInterface, KernelVisitor, is_kernel_of};
use ashsplat_files::atomic;
use ashsplat_program::output;
use std::path::Path;

/// Number of instructions of a module by class, as written: a loop's body counts once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Loads, stores, address computations of variables and buffers.
    pub memory: u32,
    /// Atomic operations.
    pub atomic: u32,
    /// Operations across a subgroup.
    pub subgroup: u32,
    /// exp, log, sin, pow, sqrt and the like.
    pub transcendental: u32,
    /// Additions, multiplications, comparisons, conversions, bit operations, and the other extended instructions.
    pub arithmetic: u32,
    /// Splitting and assembling of vectors, selections.
    pub composite: u32,
    /// Branches, loops, merges, calls, returns.
    pub control: u32,
    /// Barriers.
    pub barrier: u32,
}

const CLASSES: [&str; 8] =
    ["memory", "atomic", "subgroup", "transcend.", "arithmetic", "composite", "control", "barrier"];

impl Counts {
    fn all(&self) -> [u32; 8] {
        let c = self;
        [c.memory, c.atomic, c.subgroup, c.transcendental, c.arithmetic, c.composite, c.control, c.barrier]
    }
}

/// Counts the instructions of a module; a truncated module is counted up to its end.
pub fn count(spirv: &[u32]) -> Counts {
    let mut counts = Counts::default();
    let mut at = 5;
    while let Some(&word) = spirv.get(at) {
        let (opcode, length) = (word & 0xffff, (word >> 16) as usize);
        if length == 0 {
            break;
        }
        match opcode {
            // OpLoad, OpStore, OpCopyMemory, OpAccessChain …, OpArrayLength; images.
            61..=70 | 86..=107 => counts.memory += 1,
            227..=242 | 6035 => counts.atomic += 1,
            333..=366 | 4421..=4432 => counts.subgroup += 1,
            // OpExtInst of GLSL.std.450: sin to exp2, pow, log2, sqrt, inversesqrt.
            12 if spirv.get(at + 4).is_some_and(|i| (13..=32).contains(i)) => counts.transcendental += 1,
            12 | 109..=168 | 170..=205 => counts.arithmetic += 1,
            77..=84 | 169 => counts.composite += 1,
            57 | 245..=255 => counts.control += 1,
            224 | 225 => counts.barrier += 1,
            _ => {}
        }
        at += length;
    }
    counts
}

/// Kernel name, name of its form, SPIR-V.
struct Modules(Vec<(&'static str, &'static str, &'static [u32])>);

impl KernelVisitor for Modules {
    fn visit<K: KernelInterface>(&mut self) {
        self.0.push((K::NAME, "", K::SPIRV));
        self.0.extend(K::TEXELS.map(|form| (K::NAME, ".texels", form.spirv)));
    }
}

/// Writes DIR/sort/sort_upsweep.spv and so on, DIR/forward/blend.texels.spv for a form that reads texels, and
/// DIR/instructions.txt. Returns that table. `name` selects a kernel or folder.
pub fn dump(folder: &Path, name: Option<&str>) -> Result<String> {
    output::check_folder(folder)?;
    let mut modules = Modules(Vec::new());
    visit_all(&mut modules);
    modules.0.retain(|(kernel, ..)| name.is_none_or(|name| is_kernel_of(kernel, name)));
    let mut table = format!("{:<36} {:>7}", "kernel", "words");
    CLASSES.iter().for_each(|class| table += &format!(" {class:>10}"));
    table.push('\n');
    for (kernel, form, spirv) in modules.0 {
        let name = format!("{kernel}{form}");
        let path = folder.join(format!("{name}.spv"));
        let bytes: Vec<u8> = spirv.iter().flat_map(|word| word.to_le_bytes()).collect();
        output::in_folder(&path, |path| atomic::write(path, |out| out.write_all(&bytes)))?;
        table += &format!("{name:<36} {:>7}", spirv.len());
        count(spirv).all().iter().for_each(|count| table += &format!(" {count:>10}"));
        table.push('\n');
    }
    output::write_text(&folder.join("instructions.txt"), &table)?;
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instructions_are_counted_by_class() {
        let header = [0x0723_0203, 0x0001_0600, 0, 10, 0];
        let one = |opcode: u32, length: u32| -> Vec<u32> {
            let mut words = vec![length << 16 | opcode];
            words.resize(length as usize, 0);
            words
        };
        let exp = vec![6 << 16 | 12, 1, 2, 3, 27, 4];
        let min = vec![6 << 16 | 12, 1, 2, 3, 37, 4];
        let parts = [
            one(61, 4),
            one(62, 3),
            one(234, 7),
            one(349, 6),
            exp,
            min,
            one(129, 5),
            one(80, 5),
            one(250, 4),
            one(224, 4),
        ];
        let module: Vec<u32> = header.into_iter().chain(parts.into_iter().flatten()).collect();
        let expected = Counts {
            memory: 2,
            atomic: 1,
            subgroup: 1,
            transcendental: 1,
            arithmetic: 2,
            composite: 1,
            control: 1,
            barrier: 1,
        };
        assert_eq!(count(&module), expected);
        assert_eq!(count(&[]), Counts::default());
    }
}
