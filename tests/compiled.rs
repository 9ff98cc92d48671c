//! `ashsplat profile --static`: compiler statistics of the kernels, from a driver that compiles for absent GPUs.

use crate::bench::{number, read};
use crate::cli::{Finished, assert_refused, finish, program, refuse, succeed, text};
use crate::common::{assert_says, context, new_paths, root};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// One GPU each of RDNA2, GCN5 and RDNA3, with its names in all versions of Mesa: RDNA3's differs in Mesa 22.
const FAMILIES: [&[&str]; 3] = [&["navi21"], &["vega10"], &["gfx1100", "navi31"]];

const BLESS: &str = "run with ASHSPLAT_BLESS=1";

/// Mesa's driver for AMD, if installed: it compiles without hardware.
fn radv() -> Option<PathBuf> {
    let manifest = Path::new("/usr/share/vulkan/icd.d/radeon_icd.x86_64.json");
    if !manifest.exists() {
        eprintln!("skipped: no {}", manifest.display());
        return None;
    }
    Some(manifest.to_owned())
}

fn under(radv: &Path, family: &str, arguments: &[&str]) -> Finished {
    let mut program = program();
    program.env("VK_DRIVER_FILES", radv).env("VK_ICD_FILENAMES", radv).env("RADV_FORCE_FAMILY", family);
    program.env_remove("ASHSPLAT_DEVICE").env_remove("ASHSPLAT_BACKEND");
    finish(program.args(["profile", "--static"]).args(arguments))
}

fn compile(radv: &Path, family: &str, arguments: &[&str]) -> Finished {
    let run = under(radv, family, arguments);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    run
}

/// All kernels, compiled once for each family by the first of its names that the driver knows.
fn compiled(radv: &Path) -> &'static [(&'static str, Value)] {
    static COMPILED: OnceLock<Vec<(&str, Value)>> = OnceLock::new();
    COMPILED.get_or_init(|| {
        let (_folder, [json]) = new_paths(["all.json"]);
        let known = |family: &&'static str| {
            let run = under(radv, family, &["--json", text(&json)]);
            let is_known = run.code == Some(0);
            assert!(is_known || run.stderr.contains("Unknown family"), "{family}: {}", run.stderr);
            is_known.then(|| (*family, read(&json)))
        };
        FAMILIES.iter().filter_map(|names| names.iter().find_map(known)).collect()
    })
}

fn pipelines(compiled: &Value) -> &Vec<Value> {
    compiled["pipelines"].as_array().expect("pipelines")
}

/// Fewest subgroups per SIMD and largest latency of each kernel, over its variants.
fn worst(compiled: &Value) -> BTreeMap<String, (f64, f64)> {
    let mut kernels: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for pipeline in pipelines(compiled) {
        let figures = &pipeline["figures"];
        let kernel = pipeline["kernel"].as_str().expect("a name").to_owned();
        let worst = kernels.entry(kernel).or_insert((f64::INFINITY, 0.0));
        worst.0 = worst.0.min(number(&figures["subgroups_per_simd"]));
        worst.1 = worst.1.max(number(&figures["latency"]));
    }
    kernels
}

/// Driver, family and kernel.
type Key = (String, String, String);
/// A row of the table: also the fewest subgroups per SIMD, and the largest latency.
type Row = (Key, (f64, f64));

fn row(line: &str) -> Row {
    let words: Vec<&str> = line.split('\t').collect();
    let [driver, family, kernel, subgroups, latency] = words[..] else { panic!("no row: {line}") };
    let number = |word: &str| word.parse().unwrap_or_else(|_| panic!("no number: {line}"));
    ((driver.to_owned(), family.to_owned(), kernel.to_owned()), (number(subgroups), number(latency)))
}

/// No kernel spills with AMD's compilers. If the driver is the table's, the kernels are the same, and none is worse:
/// no subgroup less per SIMD, at most a tenth more estimated cycles.
#[test]
fn compiled_kernels_fit_into_registers() {
    let Some(radv) = radv() else { return };
    let path = root().join("tools/gpu_static.tsv");
    let mut made: Vec<Row> = Vec::new();
    for &(family, ref compiled) in compiled(&radv) {
        let pipelines = pipelines(compiled);
        assert!(pipelines.len() > 100, "{family}: {} pipelines", pipelines.len());
        for pipeline in pipelines {
            let figures = &pipeline["figures"];
            let spilled = number(&figures["spills"]) + number(&figures["scratch_bytes"]);
            assert!(spilled == 0.0, "{family}: {pipeline}");
        }
        let driver = compiled["device"]["driver"].as_str().expect("a driver");
        let row = |(kernel, figures)| ((driver.to_owned(), family.to_owned(), kernel), figures);
        made.extend(worst(compiled).into_iter().map(row));
    }
    assert!(!made.is_empty(), "the driver knows none of {FAMILIES:?}");
    if std::env::var_os("ASHSPLAT_BLESS").is_some() {
        let mut written = "driver\tfamily\tkernel\tsubgroups per SIMD\tlatency\n".to_owned();
        for ((driver, family, kernel), (subgroups, latency)) in &made {
            written += &format!("{driver}\t{family}\t{kernel}\t{subgroups}\t{latency}\n");
        }
        std::fs::write(&path, written).expect("written");
        return;
    }
    let table = std::fs::read_to_string(&path).expect("the table");
    let table: BTreeMap<_, _> = table.lines().skip(1).map(row).collect();
    let of_driver = |key: &Key| made.iter().any(|(ours, _)| ours.0 == key.0);
    if !table.keys().any(of_driver) {
        eprintln!("skipped: the table is of another driver");
        return;
    }
    for (key, (subgroups, latency)) in &made {
        let row = table.get(key);
        let (min, max) = row.unwrap_or_else(|| panic!("{key:?} is not in the table; {BLESS}"));
        let made = format!("{subgroups} subgroups, {latency} cycles");
        assert!(subgroups >= min && *latency <= 1.1 * max, "{key:?}: {made}; the table has {row:?}");
    }
    // A family that this driver does not know has no rows.
    let gone = table.keys().find(|key| of_driver(key) && !made.iter().any(|(ours, _)| ours == *key));
    assert!(gone.is_none(), "{gone:?} is in the table and was not compiled; {BLESS}");
}

/// The heaviest kernels have another subgroup size if the driver supports both: in the shader's constant, and as the
/// pipeline's required size.
#[test]
fn compiled_subgroups_have_the_size_that_is_asked_for() {
    const HEAVIEST: [&str; 3] =
        ["backward/blend_backward", "backward/project_backward", "forward/blend_auxiliary"];
    let Some(radv) = radv() else { return };
    for (family, heavy) in [("navi21", 32), ("vega10", 64)] {
        let of_family = compiled(&radv).iter().find(|(known, _)| *known == family);
        let (_, compiled) = of_family.expect("in all versions of Mesa");
        assert_eq!(compiled["device"]["heavy_subgroup_size"], heavy);
        let mut sizes = BTreeMap::new();
        for pipeline in pipelines(compiled) {
            let Some(constant) = pipeline["constants"]["SUBGROUP_SIZE"].as_str() else { continue };
            let kernel = pipeline["kernel"].as_str().expect("a name");
            let wanted = if HEAVIEST.contains(&kernel) { heavy } else { 64 };
            assert_eq!(constant, wanted.to_string(), "{family}: {kernel}");
            assert_eq!(pipeline["subgroup_size"], wanted, "{family}: {kernel}");
            *sizes.entry(wanted).or_insert(0) += 1;
        }
        assert_eq!(sizes.len(), if heavy == 64 { 1 } else { 2 }, "{family}: {sizes:?}");
    }
}

#[test]
fn compiled_files_stand_beside_each_other() {
    let Some(radv) = radv() else { return };
    let (_folder, [a, b, asm]) = new_paths(["a.json", "b.json", "asm"]);
    let run = under(&radv, "navi21", &["render", "--json", text(&a)]);
    assert!(run.code == Some(0) && run.stdout.contains("none of which has run"), "{}", run.stderr);
    assert_says(&run.stdout, &["forward/blend "]);
    assert!(!run.stdout.contains("optimizer/adam"), "{}", run.stdout);
    let others = ["render", "--json", text(&b), "--beside", text(&a), "--asm", text(&asm)];
    let run = compile(&radv, "vega10", &others);
    assert_says(run.stdout.lines().next().expect("a header"), &["VEGA10", "NAVI21"]);
    let texts = std::fs::read_dir(asm.join("forward")).expect("texts");
    let assembly = texts.filter_map(Result::ok).find(|file| {
        file.file_name().to_string_lossy().starts_with("blend.0.")
            && std::fs::read_to_string(file.path()).expect("text").contains("s_endpgm")
    });
    assert!(assembly.is_some(), "no machine code of blend");
    // If one kernel is requested, its variants are shown.
    let run = under(&radv, "navi21", &["--kernel", "forward/project"]);
    assert_says(&run.stdout, &["SH_DEGREE=3 SH_LOOPS"]);
    // Only this kernel in a comparison, too, although others have different pipelines.
    let run = under(&radv, "vega10", &["--kernel", "forward/project", "--beside", text(&a)]);
    let is_row = |line: &&str| line.starts_with("| forward/") || line.starts_with("| sort/");
    assert_eq!(run.stdout.lines().filter(is_row).count(), 1, "{}", run.stdout);
    assert_says(&run.stderr, &["warning: ", "a.json: has the pipelines of 'render'"]);
    // Kernels that a frame does not use, and kernels that neither uses.
    let run = under(&radv, "navi21", &["render", "--kernel", "optimizer"]);
    assert_refused(&run, &["--kernel optimizer", "'render' has no pipeline of it", "forward/blend, "]);
    let run = under(&radv, "navi21", &["--kernel", "lpips"]);
    assert_refused(&run, &["--kernel lpips", "neither frames nor training steps"]);
    std::fs::write(&b, "{\"schema\": \"ashsplat-static/2\"}").expect("written");
    refuse(&["profile", "--static", "--beside", text(&b)], &["b.json", "ashsplat-static/1"]);
}

#[test]
fn compiled_only_where_the_driver_tells() {
    if context().device_name().contains("llvmpipe") {
        refuse(&["profile", "--static"], &["VK_KHR_pipeline_executable_properties"]);
    } else {
        assert!(succeed(&["profile", "--static"]).contains("none of which has run"));
    }
    refuse(&["profile", "--static", "--trace", "x.json"], &["--static", "--trace"]);
    refuse(&["profile", "--json", "x.json"], &["--static"]);
}
