//! `--trace FILE`: Chrome's trace event format, which Perfetto and chrome://tracing open.
//!
//! Host and device are two processes on the host's clock, in microseconds since the first iteration began. A submission is
//! assumed to end on the device when the host noticed it.

use crate::measure::Iteration;
use ashsplat::vk::{CommandRecord, Submission};
use serde_json::{Value, json};
use std::time::Instant;

const HOST: u32 = 1;
const DEVICE: u32 = 2;

/// The whole trace. `device` is the device's name.
pub fn trace(device: &str, iterations: &[Iteration]) -> Value {
    let Some(first) = iterations.first() else { return json!({ "traceEvents": [] }) };
    let origin = first.begun;
    let mut events = vec![
        named("process_name", HOST, 0, "host"),
        named("process_name", DEVICE, 0, device),
        named("thread_name", HOST, 1, "iterations and submissions"),
        named("thread_name", DEVICE, 1, "stages and kernels"),
    ];
    let mut flow = 0;
    for (number, iteration) in iterations.iter().enumerate() {
        let name = format!("iteration {number}");
        events.push(span(
            &name,
            "iteration",
            HOST,
            (at(origin, iteration.begun), iteration.wall.as_secs_f64() * 1e6),
        ));
        for submission in &iteration.submissions {
            flow += 1;
            host_events(&mut events, origin, submission);
            device_events(&mut events, origin, submission, flow);
        }
    }
    json!({
        "traceEvents": events,
        "displayTimeUnit": "ms",
        "otherData": { "program": concat!("ashsplat ", env!("CARGO_PKG_VERSION")), "device": device },
    })
}

/// Time in microseconds since the origin.
fn at(origin: Instant, time: Instant) -> f64 {
    time.saturating_duration_since(origin).as_secs_f64() * 1e6
}

/// A complete event: (begin, duration), microseconds.
fn span(name: &str, category: &str, process: u32, (ts, dur): (f64, f64)) -> Value {
    json!({ "name": name, "cat": category, "ph": "X", "ts": ts, "dur": dur, "pid": process, "tid": 1 })
}

fn named(what: &str, process: u32, thread: u32, name: &str) -> Value {
    json!({ "name": what, "ph": "M", "pid": process, "tid": thread, "args": { "name": name } })
}

fn host_events(events: &mut Vec<Value>, origin: Instant, s: &Submission) {
    let parts = [
        ("record", s.begun, s.submitting),
        ("submit", s.submitting, s.submitted),
        ("wait", s.submitted, s.done),
    ];
    for (what, begin, end) in parts {
        let times = (at(origin, begin), (end - begin).as_secs_f64() * 1e6);
        events.push(span(&format!("{what} {}", s.label), "submission", HOST, times));
    }
}

fn device_events(events: &mut Vec<Value>, origin: Instant, s: &Submission, flow: u32) {
    let (Some(begun), Some(whole)) = (s.device_begun, s.nanoseconds) else { return };
    let begun = at(origin, begun);
    let mut submission = span(s.label, "submission", DEVICE, (begun, whole * 1e-3));
    submission["args"] = json!({ "commands": s.commands.len() });
    events.push(submission);
    // An arrow from the host's submission to the device's begin.
    let arrow = |phase: &str, process: u32, ts: f64| json!({ "name": "submission", "cat": "flow", "ph": phase, "id": flow, "ts": ts, "pid": process, "tid": 1, "bp": "e" });
    events.push(arrow("s", HOST, at(origin, s.submitting)));
    events.push(arrow("f", DEVICE, begun));
    for stage in s.commands.chunk_by(|a, b| a.scope == b.scope) {
        let (Some((begin, _)), Some((last, duration))) = (times(&stage[0]), times(&stage[stage.len() - 1]))
        else {
            continue;
        };
        if !stage[0].scope.is_empty() {
            let end = last + duration;
            events.push(span(stage[0].scope, "stage", DEVICE, (begun + begin * 1e-3, (end - begin) * 1e-3)));
        }
        for command in stage {
            let Some((begin, duration)) = times(command) else { continue };
            let mut event = span(command.name, "kernel", DEVICE, (begun + begin * 1e-3, duration * 1e-3));
            event["args"] = json!({
                "stage": command.scope,
                "workgroups": command.workgroups,
                "bound bytes": command.buffers.iter().map(|b| b.bytes).sum::<u64>(),
            });
            events.push(event);
        }
    }
}

fn times(command: &CommandRecord) -> Option<(f64, f64)> {
    Some((command.begin_ns?, command.nanoseconds?))
}
