//! `ashsplat bench model`: least times on GPUs that are not at hand.

use crate::bench::{measure, number, read, runs};
use crate::cli::{refuse, succeed, text};
use tempfile::tempdir;

/// The kernels of GPUs, measured here, and their least times on a GPU that is not here.
#[test]
fn bench_model_bounds_every_kernel() {
    let folder = tempdir().expect("a temporary folder");
    let [gpu, processor, json] =
        ["gpu.json", "processor.json", "model.json"].map(|name| folder.path().join(name));
    measure("train-step", &["--backend", "gpu", "--json", text(&gpu)]);
    let table = succeed(&["bench", "model", text(&gpu), "--gpu", "rtx4090", "--json", text(&json)]);
    for word in ["no measurement", "RTX 4090", "blend_backward", "set by", "dispatches"] {
        assert!(table.contains(word), "no '{word}' in {table}");
    }
    let (model, measured) = (read(&json), read(&gpu));
    check_measured(&measured);
    assert_eq!(model["schema"], "ashsplat-model/1");
    let kernels = runs(&model)[0]["kernels"].as_array().expect("kernels");
    assert_eq!(kernels.len(), runs(&measured)[0]["kernels"].as_array().expect("kernels").len());
    let sum: f64 = kernels.iter().map(|kernel| number(&kernel["time_us"])).sum();
    assert!((sum - number(&runs(&model)[0]["total_us"])).abs() < 1e-6 * sum);
    assert!(kernels.iter().any(|kernel| kernel["arithmetic_us"].as_f64() > Some(0.0)), "{kernels:?}");
    // A dispatch that costs nothing leaves what is moved and computed.
    let told = succeed(&["bench", "model", text(&gpu), "--gpu", "h200", "--target-ms", "100"]);
    assert!(
        told.contains("for 100 ms: every kernel has to reach") && told.contains("wait behind a barrier"),
        "{told}"
    );
    let free = succeed(&["bench", "model", text(&gpu), "--gpu", "rtx4090", "--dispatch-us", "0"]);
    assert!(!free.contains("  dispatches\n"), "{free}");
    measure("train-step", &["--backend", "processor", "--json", text(&processor)]);
    let refused = ["processor.json", "kernels for a processor", "--backend gpu"];
    refuse(&["bench", "model", text(&processor), "--gpu", "h200"], &refused);
    // Files of older programs do not say it.
    let mut old = measured;
    old["device"].as_object_mut().expect("a device").remove("backend");
    std::fs::write(&gpu, old.to_string()).expect("written");
    let refused = ["gpu.json", "does not say for which backend", "--backend gpu"];
    refuse(&["bench", "model", text(&gpu), "--gpu", "h200"], &refused);
    refuse(&["bench", "model", text(&gpu), "--gpu", "h200", "--dispatch-us=-1"], &["--dispatch-us"]);
}

/// What only files of newer programs have: whose kernels ran, which of them wait, and what those that gather and scatter touch.
fn check_measured(report: &serde_json::Value) {
    let device = &report["device"];
    assert_eq!(device["backend"], "gpu");
    assert!(number(&device["heavy_subgroup_size"]) >= 4.0);
    let run = &runs(report)[0];
    let kernels = run["kernels"].as_array().expect("kernels");
    for kernel in kernels {
        assert!(number(&kernel["waits"]) <= number(&kernel["calls"]), "{kernel}");
    }
    let of = |scope: &str, name: &str| {
        let found = kernels.iter().find(|kernel| kernel["scope"] == scope && kernel["kernel"] == name);
        found.unwrap_or_else(|| panic!("no {name} in {scope}"))
    };
    // Each pass of a sort waits for the one before.
    let scatter = of("depth sort", "sort/sort_downsweep");
    assert_eq!([number(&scatter["calls"]), number(&scatter["waits"])], [4.0, 4.0]);
    let visible = number(&run["workload"]["visible"]);
    assert_eq!(number(&scatter["transactions"]["bytes"]), 4.0 * 8.0 * visible);
    let gathers = [
        ("tile sort", "sort/sort_downsweep"),
        ("count", "forward/count"),
        ("blend", "forward/blend"),
        ("blend backward", "backward/blend_backward"),
    ];
    for (scope, name) in gathers {
        let counted = &of(scope, name)["transactions"];
        assert!(number(&counted["array_bytes"]) > 0.0, "{name}");
        for segments in counted["by_lanes"].as_array().expect("sizes of subgroups") {
            let [a, b, c] = ["of_32", "of_64", "of_128"].map(|size| number(&segments[size]));
            assert!(
                a >= b && b >= c && c > 0.0 && 32.0 * a >= number(&counted["bytes"]) / 4.0,
                "{name}: {segments}"
            );
        }
    }
    assert!(of("cull", "forward/cull")["transactions"].is_null());
}
