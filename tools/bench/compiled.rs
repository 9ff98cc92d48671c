//! A compiler's figures of kernels: the schema `ashsplat-static/1`, which `profile --static` writes, and its tables.

use super::kernels;
use super::schema::{Device, Program};
use ashsplat::vk::{ConstantKind, Executable, PipelineStatistics};
use ashsplat::{Error, Result};
use ashsplat_files::regular_file;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The schema's name and version, first field of every file.
pub const SCHEMA: &str = "ashsplat-static/1";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compiled {
    /// [`SCHEMA`].
    pub schema: String,
    pub program: Program,
    pub device: Device,
    /// Which pipelines these are: "render", "train-step" or "all".
    pub what: String,
    pub pipelines: Vec<Pipeline>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pipeline {
    pub kernel: String,
    /// True for the form that reads texels.
    pub texels: bool,
    /// Subgroup size of the compilation; 0 if the driver does not say.
    pub subgroup_size: u32,
    pub workgroup_size: [u32; 3],
    pub constants: BTreeMap<String, String>,
    pub figures: Figures,
    /// All figures, under the driver's names.
    pub statistics: BTreeMap<String, f64>,
}

/// Figures that several drivers give, under common names. Null where the driver does not give them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Registers of an invocation: VGPRs (AMD), GPRs (NVIDIA), most live registers (Intel).
    pub registers: Option<f64>,
    /// SGPRs (AMD).
    pub scalar_registers: Option<f64>,
    /// Registers that were written to memory because there were too few, and read back. AMD's compiler gives only their sum.
    pub spills: Option<f64>,
    pub fills: Option<f64>,
    /// Bytes of memory of an invocation: arrays and spills. NVIDIA's drivers may report spills only here.
    pub scratch_bytes: Option<f64>,
    /// Shared memory of a workgroup.
    pub shared_bytes: Option<f64>,
    /// Subgroups that fit on a SIMD at a time; for NVIDIA, a quarter of the warps that fit on an SM.
    pub subgroups_per_simd: Option<f64>,
    /// Latency that the compiler estimates, cycles.
    pub latency: Option<f64>,
    /// Estimated cycles per subgroup when the machine is full.
    pub inverse_throughput: Option<f64>,
    pub instructions: Option<f64>,
    pub code_bytes: Option<f64>,
}

/// An NVIDIA SM has four partitions with their own scheduler and registers, like AMD's SIMDs.
const SIMDS_PER_SM: f64 = 4.0;

impl Figures {
    fn of(executable: &Executable) -> Self {
        // Names in Mesa's drivers for AMD, Intel and NVIDIA, in lower case.
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
            // max warps/sm counts a whole SM, whose parts compare with other drivers' SIMDs.
            subgroups_per_simd: any(&["subgroups per simd", "max waves"])
                .or_else(|| any(&["max warps/sm"]).map(|warps| warps / SIMDS_PER_SM)),
            latency: any(&["latency", "cycle count", "static cycle count"]),
            inverse_throughput: any(&["inverse throughput"]),
            instructions: any(&["instructions", "instruction count"]),
            code_bytes: any(&["code size"]),
        }
    }
}

impl Pipeline {
    /// Figures of a pipeline's largest program. Drivers that compile several choose among them at run time.
    pub fn of(statistics: &PipelineStatistics) -> Self {
        let kernel = kernels::all().into_iter().find(|kernel| kernel.name == statistics.kernel);
        let constants = kernel.map_or(&[][..], |kernel| kernel.constants);
        let named =
            statistics.constants.iter().map(|(id, bits)| match constants.iter().find(|c| c.id == *id) {
                Some(constant) => (constant.name.to_owned(), value(constant.kind, *bits)),
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

    /// Size of the workgroup: "16x16", "256".
    fn workgroup(&self) -> String {
        let size = self.workgroup_size.iter().map(u32::to_string).collect::<Vec<_>>();
        size.join("x").trim_end_matches("x1").to_owned()
    }

    /// Constants without the sizes, which have their own columns: "SH_DEGREE=3 ANTIALIAS".
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

/// Reads a file; refuses one of another schema.
pub fn read(path: &Path) -> Result<Compiled> {
    let text = regular_file::read_json(path)?;
    let remedy = "give a file that `ashsplat profile --static --json` wrote";
    let compiled: Compiled = serde_json::from_slice(&text)
        .map_err(|e| Error::input(path, format!("does not follow {SCHEMA}: {e}"), remedy))?;
    if compiled.schema != SCHEMA {
        let problem = format!("has schema '{}', this program reads '{SCHEMA}'", compiled.schema);
        return Err(Error::input(path, problem, remedy));
    }
    Ok(compiled)
}

/// Returns the heaviest variant of each kernel, and the number of its variants. Order: spills, scratch memory, registers, then
/// instructions, or bytes of code if the driver does not count instructions.
pub fn heaviest(compiled: &Compiled) -> BTreeMap<&str, (&Pipeline, usize)> {
    let weight = |p: &Pipeline| {
        let f = &p.figures;
        let size = f.instructions.or(f.code_bytes).unwrap_or(0.0);
        [f.spills, f.scratch_bytes, f.registers, Some(size)].map(|figure| figure.unwrap_or(0.0))
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

/// Formats a figure that may be missing.
pub fn shown(figure: Option<f64>) -> String {
    match figure {
        None => "-".to_owned(),
        Some(x) if x >= 10_000.0 => format!("{:.1}k", x / 1000.0),
        Some(x) if x.fract() == 0.0 => format!("{x}"),
        Some(x) => format!("{x:.1}"),
    }
}

/// Table of one device: a row per kernel, or per variant.
pub fn table(compiled: &Compiled, variants: bool) -> String {
    type Column = (&'static str, fn(&Figures) -> Option<f64>);
    let columns: [Column; 9] = [
        ("registers", |f| f.registers),
        ("scalar", |f| f.scalar_registers),
        ("spills", |f| f.spills),
        ("fills", |f| f.fills),
        ("scratch", |f| f.scratch_bytes),
        ("shared", |f| f.shared_bytes),
        ("per SIMD", |f| f.subgroups_per_simd),
        ("latency", |f| f.latency),
        ("code", |f| f.code_bytes.or(f.instructions)),
    ];
    let mut text = format!("{:<44} {:>5} {:>9}", "kernel", "lanes", "workgroup");
    columns.iter().for_each(|(name, _)| text += &format!(" {name:>9}"));
    let mut row = |name: &str, p: &Pipeline, rest: &str| {
        text += &format!("\n{name:<44} {:>5} {:>9}", p.subgroup_size, p.workgroup());
        columns.iter().for_each(|(_, figure)| text += &format!(" {:>9}", shown(figure(&p.figures))));
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

/// Table of several devices: registers, subgroups per SIMD, latency, spills and fills, and scratch memory of each kernel's
/// heaviest variant.
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
                    let has_spilled = [f.spills, f.fills].into_iter().flatten().any(|count| count > 0.0);
                    let mut rest = match has_spilled {
                        true => format!(", spills {}/{}", shown(f.spills), shown(f.fills)),
                        false => String::new(),
                    };
                    if f.scratch_bytes.is_some_and(|bytes| bytes > 0.0) {
                        rest += &format!(", scratch {}", shown(f.scratch_bytes));
                    }
                    let (fits, latency) = (shown(f.subgroups_per_simd), shown(f.latency));
                    format!(" w{}: {} / {fits} / {latency}{rest} |", p.subgroup_size, shown(f.registers))
                }
            };
        }
    }
    text + "\n\nw: lanes; registers / subgroups per SIMD / latency, cycles; scratch: bytes of memory of an invocation; each kernel's \
         heaviest variant."
}
