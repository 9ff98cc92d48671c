//! `bench` and `profile` of both forms of blending.

use serde_json::Value;
use tempfile::tempdir;

use crate::cli::{refuse, succeed, text};

const FRAME: [&str; 8] = ["--gaussians", "400", "--width", "72", "--height", "48", "--iterations", "3"];

/// Names of a run's kernels of the stage "blend".
fn blended(run: &Value) -> Vec<&str> {
    let kernels = run["kernels"].as_array().expect("kernels");
    kernels.iter().filter(|k| k["scope"] == "blend").filter_map(|k| k["kernel"].as_str()).collect()
}

#[test]
fn bench_blending_measures_both_forms_in_turn() {
    let folder = tempdir().expect("a temporary folder");
    let json = folder.path().join("a.json");
    let table = succeed(&[&["bench", "blending", "--json", text(&json)], &FRAME[..]].concat());
    let line = table.lines().last().expect("a line");
    assert!(
        line.starts_with("blending from shared memory takes ") && line.contains("400 Gaussians"),
        "{table}"
    );
    let report: Value = serde_json::from_str(&std::fs::read_to_string(&json).expect("a file")).expect("JSON");
    let runs = report["runs"].as_array().expect("runs");
    let of = |form: &str| {
        let name = format!("render-{form}");
        let run = runs.iter().find(|run| run["name"] == name.as_str()).unwrap_or_else(|| panic!("no {name}"));
        assert_eq!(run["workload"]["blending"], form);
        assert_eq!(run["iterations"], 3);
        let kernel = run["kernels"].as_array().expect("kernels").iter().find(|k| k["scope"] == "blend");
        assert!(kernel.is_some_and(|k| k["operations"].as_f64() > Some(0.0)), "{kernel:?}");
        let samples = kernel.and_then(|k| k["samples"].as_f64()).expect("samples");
        (run, samples)
    };
    let ((regions, few), (shared, many)) = (of("regions"), of("shared"));
    assert_eq!(runs.len(), 2);
    assert_eq!(regions["workload"]["hash"], shared["workload"]["hash"]);
    assert_eq!((blended(regions), blended(shared)), (vec!["forward/blend"], vec!["forward/blend_shared"]));
    assert!(0.0 < few && few < many);
    assert!(line.contains(&format!("for {:.2} times as many samples", many / few)), "{line}");
    // Without reading back the runs have another name, and the ratio is told as well.
    let drawn = succeed(&[&["bench", "blending", "--no-read-back"], &FRAME[..]].concat());
    assert!(drawn.contains("\ndraw-regions: ") && drawn.contains("\ndraw-shared: "), "{drawn}");
    assert!(drawn.lines().last().is_some_and(|line| line.starts_with("blending from shared")), "{drawn}");
    refuse(
        &[&["bench", "train-step", "--no-read-back"], &FRAME[..]].concat(),
        &["--no-read-back", "no picture"],
    );
    assert_eq!(runs[0]["workload"]["blending"], "regions");
    // By the host's clock no kernel has a time, and there is nothing to say about two of them.
    let table = succeed(&[&["bench", "blending", "--host-clock"], &FRAME[..]].concat());
    assert!(!table.contains("takes"), "{table}");
}

#[test]
fn bench_measures_the_form_that_is_asked_for_and_does_not_mix_them() {
    let folder = tempdir().expect("a temporary folder");
    let run = |what: &str, form: &str| {
        let json = folder.path().join(format!("{what}-{form}.json"));
        succeed(&[&["bench", what, "--blending", form, "--json", text(&json)], &FRAME[..]].concat());
        let report = std::fs::read_to_string(&json).expect("a file");
        (json, serde_json::from_str::<Value>(&report).expect("JSON"))
    };
    for what in ["render", "train-step"] {
        let [(a, regions), (b, shared)] = ["regions", "shared"].map(|form| run(what, form));
        for (report, form, kernel) in
            [(&regions, "regions", "forward/blend"), (&shared, "shared", "forward/blend_shared")]
        {
            let run = &report["runs"][0];
            assert_eq!((&run["name"], &run["workload"]["blending"]), (&what.into(), &form.into()));
            assert_eq!(blended(run), [kernel]);
            let blending = run["kernels"].as_array().expect("kernels").iter().find(|k| k["kernel"] == kernel);
            assert!(blending.is_some_and(|k| k["operations"].as_f64() > Some(0.0)));
        }
        let compared = succeed(&["bench", "compare", text(&a), text(&b)]);
        let said = format!("{what}: the form of blending is 'regions' in A, 'shared' in B");
        assert!(compared.contains(&said) && compared.contains("only in A: "), "{compared}");
        refuse(
            &["bench", "compare", text(&a), text(&b), "--fail-above", "9"],
            &["cannot be compared", "form of blending"],
        );
    }
    let profiled = ["profile", "render", "--blending", "shared", "--gaussians", "400", "--width", "72"];
    let table = succeed(&[&profiled[..], &["--height", "48", "--frames", "2"]].concat());
    assert!(table.contains("forward/blend_shared"), "{table}");
    refuse(&["bench", "render", "--blending", "tiles"], &["--blending", "regions", "shared"]);
    refuse(&["bench", "sort", "--blending", "shared"], &["--blending"]);
    refuse(&["bench", "blending", "--blending", "shared"], &["--blending"]);
}
