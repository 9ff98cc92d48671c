//! What a compiler says of kernels: the schema `ashsplat-static/1`, which `profile --static` writes, its table, and two such
//! files compared.

use super::schema::{Device, Program};
use ashsplat::vk::{ConstantKind, Executable, KernelInterface, KernelVisitor, PipelineStatistics};
use ashsplat::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The schema's name and version, first field of every file.
pub const SCHEMA: &str = "ashsplat-static/1";

/// What one device's compiler makes of the kernels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compiled {
    /// [`SCHEMA`].
    pub schema: String,
    pub program: Program,
    pub device: Device,
    /// "render", "train-step" or "all": whose pipelines these are.
    pub what: String,
    pub pipelines: Vec<Pipeline>,
}

/// A kernel with its constants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pipeline {
    pub kernel: String,
    /// Whether it is the form that reads texels.
    pub texels: bool,
    /// The subgroup size that was compiled for; 0: the driver does not say.
    pub subgroup_size: u32,
    pub workgroup_size: [u32; 3],
    /// Specialization constants by name.
    pub constants: BTreeMap<String, String>,
    pub figures: Figures,
    /// All figures in the driver's words.
    pub statistics: BTreeMap<String, f64>,
}

/// Figures that several drivers give, under one name. Null where the driver does not give them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Registers of an invocation: AMD's VGPRs, NVIDIA's GPRs, Intel's most live ones.
    pub registers: Option<f64>,
    /// AMD's SGPRs.
    pub scalar_registers: Option<f64>,
    /// Registers that were written to memory for lack of room, and read back. AMD's compiler does not tell the two apart.
    pub spills: Option<f64>,
    pub fills: Option<f64>,
    /// Bytes of memory of an invocation: arrays, and what was spilled.
    pub scratch_bytes: Option<f64>,
    /// Shared memory of a workgroup.
    pub shared_bytes: Option<f64>,
    /// Subgroups that fit on a SIMD at a time.
    pub subgroups_per_simd: Option<f64>,
    /// The compiler's estimate, cycles.
    pub latency: Option<f64>,
    /// Cycles per subgroup with all others beside it, estimated.
    pub inverse_throughput: Option<f64>,
    pub instructions: Option<f64>,
    pub code_bytes: Option<f64>,
}

impl Figures {
    fn of(executable: &Executable) -> Self {
        // As Mesa's drivers for AMD, Intel and NVIDIA call them, small letters.
        let any = |names: &[&str]| {
            let known = |name: &str| names.contains(&name.to_lowercase().as_str());
            let found: Vec<f64> =
                executable.statistics.iter().filter(|s| known(&s.name)).map(|s| s.value).collect();
            (!found.is_empty()).then(|| found.iter().sum())
        };
        Self {
            registers: any(&["vgprs", "max live registers", "number of gprs", "gprs"]),
            scalar_registers: any(&["sgprs"]),
            spills: any(&[
                "spilled vgprs",
                "spilled sgprs",
                "spill count",
                "spills to memory",
                "num spills to memory",
            ]),
            fills: any(&["fill count", "fills from memory", "num fills from memory"]),
            scratch_bytes: any(&["scratch size", "scratch memory size", "slm size", "local memory size"]),
            shared_bytes: any(&["lds size", "workgroup memory size", "shared memory size"]),
            subgroups_per_simd: any(&["subgroups per simd", "max waves"]),
            latency: any(&["latency", "cycle count"]),
            inverse_throughput: any(&["inverse throughput"]),
            instructions: any(&["instructions", "instruction count"]),
            code_bytes: any(&["code size"]),
        }
    }

    /// Whether anything had no room in registers.
    pub fn has_spilled(&self) -> bool {
        [self.spills, self.fills].into_iter().flatten().any(|count| count > 0.0)
    }
}

/// The constants' names and kinds of a kernel.
struct Constants<'a> {
    kernel: &'a str,
    found: BTreeMap<u32, (&'static str, ConstantKind)>,
}

impl KernelVisitor for Constants<'_> {
    fn visit<K: KernelInterface>(&mut self) {
        if K::NAME == self.kernel {
            self.found.extend(K::CONSTANTS.iter().map(|c| (c.id, (c.name, c.kind))));
        }
    }
}

impl Pipeline {
    /// Of a pipeline's largest program: drivers that compile several choose among them when it runs.
    pub fn of(statistics: &PipelineStatistics) -> Self {
        let mut constants = Constants { kernel: statistics.kernel, found: BTreeMap::new() };
        ashsplat::kernels::visit_all(&mut constants);
        let named = statistics.constants.iter().map(|(id, bits)| match constants.found.get(id) {
            Some((name, kind)) => ((*name).to_owned(), value(*kind, *bits)),
            None => (format!("constant {id}"), bits.to_string()),
        });
        let executable = statistics.executables.iter().max_by_key(|e| e.subgroup_size);
        let known = executable.map_or(0, |e| e.subgroup_size);
        Self {
            kernel: statistics.kernel.to_owned(),
            texels: statistics.texels,
            subgroup_size: if known > 0 { known } else { statistics.subgroup_size.unwrap_or(0) },
            workgroup_size: statistics.workgroup_size,
            constants: named.collect(),
            figures: executable.map(Figures::of).unwrap_or_default(),
            statistics: (executable.iter().flat_map(|e| &e.statistics))
                .map(|statistic| (statistic.name.clone(), statistic.value))
                .collect(),
        }
    }

    /// The constants but for the sizes, which have columns of their own: "SH_DEGREE=3 ANTIALIAS".
    pub fn variant(&self) -> String {
        let sizes = ["WORKGROUP_SIZE", "SUBGROUP_SIZE"];
        let shown = self.constants.iter().filter(|(name, _)| !sizes.contains(&name.as_str()));
        let mut words: Vec<String> = shown
            .filter(|(_, value)| *value != "false")
            .map(|(name, value)| if value == "true" { name.clone() } else { format!("{name}={value}") })
            .collect();
        words.extend(self.texels.then(|| "texels".to_owned()));
        words.join(" ")
    }
}

fn value(kind: ConstantKind, bits: u32) -> String {
    match kind {
        ConstantKind::Uint => bits.to_string(),
        ConstantKind::Int => (bits as i32).to_string(),
        ConstantKind::Float => f32::from_bits(bits).to_string(),
        ConstantKind::Bool => (bits != 0).to_string(),
    }
}

/// Whether a file is of this schema; for what reads files of several.
pub fn is_one(path: &Path) -> bool {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let value = serde_json::from_str::<serde_json::Value>(&text).unwrap_or_default();
    value.get("schema").and_then(|schema| schema.as_str()) == Some(SCHEMA)
}

/// Reads a file; one of another schema is refused.
pub fn read(path: &Path) -> Result<Compiled> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
    let remedy = "give a file that `ashsplat profile --static --json` wrote";
    let compiled: Compiled = serde_json::from_str(&text)
        .map_err(|e| Error::input(path, format!("does not follow {SCHEMA}: {e}"), remedy))?;
    if compiled.schema != SCHEMA {
        let problem = format!("has schema '{}', this program reads '{SCHEMA}'", compiled.schema);
        return Err(Error::input(path, problem, remedy));
    }
    Ok(compiled)
}

/// The heaviest variant of each kernel: that with the most registers, then instructions or bytes of code.
pub fn heaviest(compiled: &Compiled) -> BTreeMap<&str, (&Pipeline, usize)> {
    let weight = |p: &Pipeline| {
        let f = &p.figures;
        let size = f.instructions.or(f.code_bytes).unwrap_or(0.0);
        [f.spills.unwrap_or(0.0), f.registers.unwrap_or(0.0), size]
    };
    let mut kernels: BTreeMap<&str, (&Pipeline, usize)> = BTreeMap::new();
    for pipeline in &compiled.pipelines {
        let place = kernels.entry(&pipeline.kernel).or_insert((pipeline, 0));
        place.1 += 1;
        if weight(pipeline) > weight(place.0) {
            place.0 = pipeline;
        }
    }
    kernels
}

/// A figure that may be missing.
pub fn shown(figure: Option<f64>) -> String {
    match figure {
        None => "-".to_owned(),
        Some(x) if x >= 10_000.0 => format!("{:.1}k", x / 1000.0),
        Some(x) if x.fract() == 0.0 => format!("{x}"),
        Some(x) => format!("{x:.1}"),
    }
}

/// What has become worse from A to B, a line each; and what only one of them has.
pub fn worse(a: &Compiled, b: &Compiled, limit: f64) -> (Vec<String>, Vec<String>) {
    let (mut lines, mut unpaired) = (Vec::new(), Vec::new());
    let key =
        |p: &Pipeline| (p.kernel.clone(), p.texels, p.subgroup_size, p.workgroup_size, p.constants.clone());
    let mut of_a: BTreeMap<_, &Pipeline> = a.pipelines.iter().map(|p| (key(p), p)).collect();
    for new in &b.pipelines {
        let Some(old) = of_a.remove(&key(new)) else {
            unpaired.push(format!("only in B: {} {}", new.kernel, new.variant()));
            continue;
        };
        let (f, g) = (&old.figures, &new.figures);
        let figures = [
            ("spills", f.spills, g.spills),
            ("fills", f.fills, g.fills),
            ("scratch bytes", f.scratch_bytes, g.scratch_bytes),
            ("shared bytes", f.shared_bytes, g.shared_bytes),
            ("latency", f.latency, g.latency),
            ("inverse throughput", f.inverse_throughput, g.inverse_throughput),
            // More is better: what is compared is what falls.
            ("subgroups per SIMD", g.subgroups_per_simd, f.subgroups_per_simd),
        ];
        for (name, least, most) in figures {
            let (Some(least), Some(most)) = (least, most) else { continue };
            if most > least * limit {
                let (from, to) = if name.starts_with("subgroups") { (most, least) } else { (least, most) };
                let (from, to) = (shown(Some(from)), shown(Some(to)));
                lines.push(format!("{} {}: {name} {from} -> {to}", new.kernel, new.variant()));
            }
        }
    }
    unpaired.extend(of_a.values().map(|old| format!("only in A: {} {}", old.kernel, old.variant())));
    (lines, unpaired)
}

/// One device: a row per kernel, or per variant.
pub fn table(compiled: &Compiled, variants: bool) -> String {
    let names =
        ["registers", "scalar", "spills", "fills", "scratch", "shared", "per SIMD", "latency", "code"];
    let mut text = format!("{:<44} {:>5} {:>9}", "kernel", "lanes", "workgroup");
    names.iter().for_each(|name| text += &format!(" {name:>9}"));
    let mut row = |name: &str, p: &Pipeline, rest: &str| {
        let f = &p.figures;
        let size = p.workgroup_size.iter().map(u32::to_string).collect::<Vec<_>>();
        let size = size.join("x").trim_end_matches("x1").to_owned();
        text += &format!("\n{name:<44} {:>5} {size:>9}", p.subgroup_size);
        let figures = [
            f.registers,
            f.scalar_registers,
            f.spills,
            f.fills,
            f.scratch_bytes,
            f.shared_bytes,
            f.subgroups_per_simd,
            f.latency,
            f.code_bytes.or(f.instructions),
        ];
        figures.iter().for_each(|figure| text += &format!(" {:>9}", shown(*figure)));
        text += rest;
    };
    if variants {
        for pipeline in &compiled.pipelines {
            row(&pipeline.kernel, pipeline, &format!("  {}", pipeline.variant()));
        }
    } else {
        for (kernel, (pipeline, count)) in heaviest(compiled) {
            let rest = if count > 1 { format!("  the heaviest of {count}") } else { String::new() };
            row(kernel, pipeline, &rest);
        }
    }
    text
}

/// Several devices beside each other: registers, spills and fills, subgroups per SIMD, latency of each kernel's heaviest
/// variant.
pub fn beside(all: &[Compiled]) -> String {
    let each: Vec<_> = all.iter().map(heaviest).collect();
    let kernels: std::collections::BTreeSet<&str> = each.iter().flat_map(|e| e.keys().copied()).collect();
    let mut text = "| kernel |".to_owned();
    all.iter().for_each(|compiled| text += &format!(" {} |", compiled.device.name));
    text += "\n|---|";
    all.iter().for_each(|_| text += "---|");
    for kernel in kernels {
        text += &format!("\n| {kernel} |");
        for of_device in &each {
            text += &match of_device.get(kernel) {
                None => " |".to_owned(),
                Some((p, _)) => {
                    let f = &p.figures;
                    let spilled = match f.has_spilled() {
                        true => format!(", spills {}/{}", shown(f.spills), shown(f.fills)),
                        false => String::new(),
                    };
                    let (fits, latency) = (shown(f.subgroups_per_simd), shown(f.latency));
                    format!(" w{}: {} / {fits} / {latency}{spilled} |", p.subgroup_size, shown(f.registers))
                }
            };
        }
    }
    text + "\n\nw: lanes; registers / subgroups per SIMD / latency, cycles; each kernel's heaviest variant."
}
