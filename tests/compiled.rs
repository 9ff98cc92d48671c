//! `ashsplat profile --static`: what compilers say of the kernels, on a driver that compiles for GPUs that are not there.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::tempdir;

use crate::cli::{Finished, finish, program, refuse, succeed, text};
use crate::common::context;

/// Those that Mesa 22 and newer ones know.
const FAMILIES: [&str; 3] = ["navi21", "vega10", "gfx1100"];

/// Mesa's driver for AMD, where it is installed: it compiles without hardware.
fn radv() -> Option<PathBuf> {
    let manifest = Path::new("/usr/share/vulkan/icd.d/radeon_icd.x86_64.json");
    let found = manifest.exists().then(|| manifest.to_owned());
    if found.is_none() {
        eprintln!("skipped: no {}", manifest.display());
    }
    found
}

fn under(radv: &Path, family: &str, arguments: &[&str]) -> Finished {
    let mut program = program();
    program.env("VK_DRIVER_FILES", radv).env("VK_ICD_FILENAMES", radv).env("RADV_FORCE_FAMILY", family);
    finish(program.env_remove("ASHSPLAT_DEVICE").args(["profile", "--static"]).args(arguments))
}

fn read(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a file")).expect("JSON")
}

fn number(figures: &Value, name: &str) -> f64 {
    figures[name].as_f64().unwrap_or_else(|| panic!("{name}: {figures}"))
}

/// Kernel → fewest subgroups per SIMD, largest latency, of all its variants.
fn worst(compiled: &Value) -> BTreeMap<String, (f64, f64)> {
    let mut kernels: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for pipeline in compiled["pipelines"].as_array().expect("pipelines") {
        let figures = &pipeline["figures"];
        let kernel = pipeline["kernel"].as_str().expect("a name").to_owned();
        let worst = kernels.entry(kernel).or_insert((f64::INFINITY, 0.0));
        worst.0 = worst.0.min(number(figures, "subgroups_per_simd"));
        worst.1 = worst.1.max(number(figures, "latency"));
    }
    kernels
}

/// No kernel spills on AMD's compilers. Where the driver is the table's, none has become worse than the table: not one subgroup
/// less per SIMD, at most a tenth more estimated cycles.
#[test]
fn compiled_kernels_fit_into_registers() {
    let Some(radv) = radv() else { return };
    let folder = tempdir().expect("a temporary folder");
    let bless = std::env::var_os("ASHSPLAT_BLESS").is_some();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../gpu_static.tsv");
    let table = std::fs::read_to_string(&path).unwrap_or_default();
    let (mut written, mut compared) = ("driver\tfamily\tkernel\tsubgroups per SIMD\tlatency\n".to_owned(), 0);
    for family in FAMILIES {
        let json = folder.path().join(family);
        let run = under(&radv, family, &["--json", text(&json)]);
        assert_eq!(run.code, Some(0), "{family}: {}", run.stderr);
        let compiled = read(&json);
        let pipelines = compiled["pipelines"].as_array().expect("pipelines");
        assert!(pipelines.len() > 100, "{family}: {} pipelines", pipelines.len());
        for pipeline in pipelines {
            let figures = &pipeline["figures"];
            let spilled = number(figures, "spills") + number(figures, "scratch_bytes");
            assert!(spilled == 0.0, "{family}: {pipeline}");
        }
        let driver = compiled["device"]["driver"].as_str().expect("a driver");
        for (kernel, (subgroups, latency)) in worst(&compiled) {
            written += &format!("{driver}\t{family}\t{kernel}\t{subgroups}\t{latency}\n");
            let key = format!("{driver}\t{family}\t{kernel}\t");
            let Some(row) = table.lines().find_map(|line| line.strip_prefix(&key)) else { continue };
            let (least, most) = row.split_once('\t').expect("two figures");
            let (least, most): (f64, f64) =
                (least.parse().expect("a number"), most.parse().expect("a number"));
            assert!(
                bless || (subgroups >= least && latency <= 1.1 * most),
                "{family} {kernel}: {subgroups} subgroups, {latency} cycles; the table has {least}, {most}"
            );
            compared += 1;
        }
    }
    if bless {
        std::fs::write(&path, written).expect("written");
    } else if compared == 0 {
        eprintln!("skipped: the table is of another driver");
    } else {
        assert!(compared > 100, "{compared} rows compared");
    }
}

#[test]
fn compiled_files_stand_beside_each_other_and_are_compared() {
    let Some(radv) = radv() else { return };
    let folder = tempdir().expect("a temporary folder");
    let [a, b, worse, asm] = ["a.json", "b.json", "worse.json", "asm"].map(|name| folder.path().join(name));
    let run = under(&radv, "navi21", &["render", "--json", text(&a)]);
    assert!(run.code == Some(0) && run.stdout.contains("none of which has run"), "{}", run.stderr);
    assert!(
        run.stdout.contains("forward/blend ") && !run.stdout.contains("optimizer/adam"),
        "{}",
        run.stdout
    );
    let others = ["render", "--json", text(&b), "--beside", text(&a), "--asm", text(&asm)];
    let run = under(&radv, "vega10", &others);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let header = run.stdout.lines().next().expect("a header");
    assert!(header.contains("VEGA10") && header.contains("NAVI21"), "{header}");
    let texts = std::fs::read_dir(asm.join("forward")).expect("texts");
    let assembly = texts.filter_map(Result::ok).find(|file| {
        file.file_name().to_string_lossy().starts_with("blend.0.")
            && std::fs::read_to_string(file.path()).expect("text").contains("s_endpgm")
    });
    assert!(assembly.is_some(), "no machine code of blend");
    // Variants are shown where one kernel is asked for.
    let run = under(&radv, "navi21", &["--kernel", "forward/project"]);
    assert!(run.stdout.contains("SH_DEGREE=3 SH_LOOPS"), "{}", run.stdout);

    let compare =
        |to: &Path| finish(program().args(["bench", "compare", text(&a), text(to), "--fail-above", "1.05"]));
    assert_eq!(compare(&a).code, Some(0));
    let mut changed = read(&a);
    let latency = &mut changed["pipelines"][3]["figures"]["latency"];
    *latency = Value::from(latency.as_f64().expect("a number") * 2.0);
    std::fs::write(&worse, changed.to_string()).expect("written");
    let run = compare(&worse);
    assert_eq!(run.code, Some(1));
    assert!(run.stdout.contains("latency"), "{}", run.stdout);
    std::fs::write(&worse, "{\"schema\": \"ashsplat-static/2\"}").expect("written");
    refuse(&["profile", "--static", "--beside", text(&worse)], &["worse.json", "ashsplat-static/1"]);
}

#[test]
fn compiled_only_where_the_driver_tells() {
    if context().device_name().contains("llvmpipe") {
        refuse(&["profile", "--static"], &["VK_KHR_pipeline_executable_properties"]);
    } else {
        assert!(succeed(&["profile", "--static"]).contains("none of which has run"));
    }
    refuse(&["profile", "--static", "--html", "x.html"], &["--static", "--html"]);
    refuse(&["profile", "--json", "x.json"], &["--static"]);
}
