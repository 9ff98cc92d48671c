//! `ashsplat profile`, run as users run it.

use crate::bench::{number, read};
use crate::cli::{refuse, succeed, text};
use crate::common::{assert_says, new_paths};
use serde_json::Value;

const SMALL: [&str; 10] =
    ["--gaussians", "300", "--width", "80", "--height", "48", "--frames", "3", "--warmup", "1"];

fn profile(arguments: &[&str]) -> String {
    succeed(&[&["profile"], arguments, &SMALL[..]].concat())
}

#[test]
fn profile_prints_a_table_of_one_kernel_or_folder() {
    let all = profile(&[]);
    assert!(all.contains("forward/blend") && all.contains("sort/sort_"), "{all}");
    let sorts = profile(&["--kernel", "sort"]);
    assert!(!sorts.contains("forward/blend") && sorts.contains("sort/sort_"), "{sorts}");
    let steps = profile(&["train-step", "--kernel", "optimizer"]);
    assert!(steps.contains("adam") && !steps.contains("sort/sort_"), "{steps}");
}

#[test]
fn profile_marks_one_iteration_for_a_capture() {
    let small = &SMALL[..6];
    let said = succeed(&[&["profile", "--capture", "--warmup", "1"], small].concat());
    assert_says(&said, &["one render was marked as a capture"]);
    refuse(&["profile", "--capture", "--trace", "t.json"], &["--capture", "--trace"]);
}

#[test]
fn profile_refuses_options_that_would_not_be_used() {
    let unused: [&[&str]; 5] = [
        &["--ab", "-", "-", "--trace", "x"],
        &["--watch", "--trace", "x"],
        &["--watch", "--kernel", "sort"],
        &["--capture", "--frames", "2"],
        &["--watch-for", "3"],
    ];
    for arguments in unused {
        refuse(&[&["profile"], arguments].concat(), &["--"]);
    }
}

#[test]
fn profile_trace_nests_and_keeps_one_clock() {
    let (_folder, [path]) = new_paths(["trace.json"]);
    profile(&["--trace", text(&path)]);
    let trace = read(&path);
    let events = trace["traceEvents"].as_array().expect("events");
    for event in events {
        assert!(event["name"].is_string() && event["pid"].is_u64() && event["tid"].is_u64(), "{event}");
        assert!(["X", "M", "s", "f"].contains(&event["ph"].as_str().expect("a phase")), "{event}");
    }
    for process in [1, 2] {
        let own = |event: &&Value| event["ph"] == "X" && event["pid"] == process;
        let span = |event: &Value| (number(&event["ts"]), number(&event["dur"]));
        let mut spans: Vec<(f64, f64)> = events.iter().filter(own).map(span).collect();
        assert!(spans.len() > 9, "process {process}");
        assert!(spans.iter().all(|(begin, duration)| *begin >= 0.0 && *duration >= 0.0));
        spans.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
        let mut open: Vec<f64> = Vec::new();
        for (begin, duration) in spans {
            open.retain(|end| *end > begin + 0.002);
            let inside = open.last().is_none_or(|end| begin + duration <= end + 0.01);
            assert!(inside, "process {process}: a span crosses another's end at {begin} µs");
            open.push(begin + duration);
        }
    }
    // Three iterations on the host, each containing the device's work.
    let count = |field: &str, value: &str| events.iter().filter(|event| event[field] == value).count();
    assert_eq!((count("cat", "iteration"), count("name", "forward/blend")), (3, 3));
    assert_eq!(count("ph", "s"), count("ph", "f"));
}

#[test]
fn profile_compares_two_settings() {
    let table = profile(&["--ab", "sort.ITEMS=8", "-"]);
    assert_says(&table, &["A: sort.ITEMS=8   B: -", "wall", "largest difference of the pictures: 0"]);
    let other = profile(&["--ab", "-", "forward/project.SH_DEGREE=0"]);
    let last = other.lines().last().expect("a line");
    let difference: f32 = last.rsplit(' ').next().and_then(|n| n.parse().ok()).expect("a number");
    assert!(difference > 0.0, "{last}");
}

#[test]
fn profile_lists_what_exists_when_a_name_is_wrong() {
    refuse(&["profile", "--kernel", "sorting"], &["sorting", "sort/sort_downsweep"]);
    refuse(&["profile", "--spec", "sort.WHAT=1"], &["WHAT", "ITEMS", "WORKGROUP_SIZE"]);
    refuse(&["profile", "--spec", "sorting.ITEMS=1"], &["sorting", "sort/sort_downsweep"]);
    refuse(&["profile", "--spec", "sort.ITEMS=x"], &["'x'"]);
    refuse(&["profile", "--ab", "-", "sort.WHAT=1"], &["WHAT"]);
    refuse(&["profile", "--ab", "", "-"], &["--ab", "write - for none"]);
    refuse(&["profile", "--ab", ",", "-"], &["--ab", "setting is empty"]);
    refuse(&["profile", "--spec", "sort.ITEMS=4", "--spec", "sort.ITEMS=8"], &["sort.ITEMS=8", "twice"]);
    refuse(&["profile", "--spec", "arithmetic.ROUNDS=0"], &["arithmetic", "yardstick"]);
    refuse(&["profile", "--spec", "ROUNDS=0"], &["no constant 'ROUNDS'"]);
    refuse(&["profile", "--gaussians", "4294967295"], &["--gaussians", "67108864"]);
}

#[cfg(not(feature = "hot-reload"))]
#[test]
fn profile_says_how_to_get_hot_reload() {
    refuse(&["profile", "--watch", "--gaussians", "10"], &["--features hot-reload"]);
}
