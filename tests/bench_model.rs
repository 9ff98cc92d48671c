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
    assert_eq!(model["schema"], "ashsplat-model/1");
    let kernels = runs(&model)[0]["kernels"].as_array().expect("kernels");
    assert_eq!(kernels.len(), runs(&measured)[0]["kernels"].as_array().expect("kernels").len());
    let sum: f64 = kernels.iter().map(|kernel| number(&kernel["time_us"])).sum();
    assert!((sum - number(&runs(&model)[0]["total_us"])).abs() < 1e-6 * sum);
    assert!(kernels.iter().any(|kernel| kernel["arithmetic_us"].as_f64() > Some(0.0)), "{kernels:?}");
    // A dispatch that costs nothing leaves what is moved and computed.
    let free = succeed(&["bench", "model", text(&gpu), "--gpu", "rtx4090", "--dispatch-us", "0"]);
    assert!(!free.contains("  dispatches\n"), "{free}");
    measure("train-step", &["--backend", "processor", "--json", text(&processor)]);
    refuse(&["bench", "model", text(&processor), "--gpu", "h200"], &["processor.json", "--backend gpu"]);
    refuse(&["bench", "model", text(&gpu), "--gpu", "h200", "--dispatch-us=-1"], &["--dispatch-us"]);
}
