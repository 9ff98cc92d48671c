//! `--dump DIR`: the SPIR-V of each kernel, with counts of its instructions.

use crate::kernels;
use ashsplat::Result;
use ashsplat::vk::is_kernel_of;
use ashsplat_files::atomic;
use ashsplat_program::output;
use std::collections::BTreeMap;
use std::path::Path;

/// Classes of instructions, in the table's order.
const CLASSES: [&str; 8] =
    ["memory", "atomic", "subgroup", "transcend.", "arithmetic", "composite", "control", "barrier"];

/// Counts a module's instructions by class, as written: a loop's body counts once. A truncated module is counted up to its end.
fn count(spirv: &[u32]) -> BTreeMap<&'static str, u32> {
    let mut counts = BTreeMap::new();
    let mut at = 5;
    while let Some(&word) = spirv.get(at) {
        let (opcode, length) = (word & 0xffff, (word >> 16) as usize);
        if length == 0 {
            break;
        }
        let class = match opcode {
            // OpLoad, OpStore, OpCopyMemory, OpAccessChain …, OpArrayLength; images.
            61..=70 | 86..=107 => "memory",
            227..=242 | 6035 => "atomic",
            333..=366 | 4421..=4432 => "subgroup",
            // OpExtInst of GLSL.std.450: sin to exp2, pow, log2, sqrt, inversesqrt.
            12 if spirv.get(at + 4).is_some_and(|i| (13..=32).contains(i)) => "transcend.",
            // Additions, multiplications, comparisons, conversions, bit operations, and the other extended instructions.
            12 | 109..=168 | 170..=205 => "arithmetic",
            // Splitting and assembling of vectors, selections.
            77..=84 | 169 => "composite",
            // Branches, loops, merges, calls, returns.
            57 | 245..=255 => "control",
            224 | 225 => "barrier",
            _ => "",
        };
        *counts.entry(class).or_default() += 1;
        at += length;
    }
    counts
}

/// Writes DIR/sort/sort_upsweep.spv and so on, DIR/forward/blend.texels.spv for another form, and
/// DIR/instructions.txt. Returns that table. `name` selects a kernel or folder.
pub fn dump(folder: &Path, name: Option<&str>) -> Result<String> {
    output::check_folder(folder)?;
    let mut table = format!("{:<36} {:>7}", "kernel", "words");
    CLASSES.iter().for_each(|class| table += &format!(" {class:>10}"));
    table.push('\n');
    let chosen =
        kernels::all().into_iter().filter(|kernel| name.is_none_or(|name| is_kernel_of(kernel.name, name)));
    let modules = chosen.flat_map(|kernel| {
        kernel.forms.iter().map(move |form| {
            let [texels, lenses] = [(form.texels, ".texels"), (form.lenses, ".lenses")]
                .map(|(has, name)| if has { name } else { "" });
            (format!("{}{texels}{lenses}", kernel.name), form.spirv)
        })
    });
    for (name, spirv) in modules {
        let path = folder.join(format!("{name}.spv"));
        let bytes: Vec<u8> = spirv.iter().flat_map(|word| word.to_le_bytes()).collect();
        output::in_folder(&path, |path| atomic::write(path, |out| out.write_all(&bytes)))?;
        table += &format!("{name:<36} {:>7}", spirv.len());
        let counts = count(spirv);
        CLASSES.iter().for_each(|class| table += &format!(" {:>10}", counts.get(class).unwrap_or(&0)));
        table.push('\n');
    }
    output::write_text(&folder.join("instructions.txt"), &table)?;
    Ok(table)
}
