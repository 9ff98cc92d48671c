//! `--html FILE`: one self-contained page.

mod history;
mod tiles;
mod timeline;

use crate::measure::{Iteration, Measured, commands};
use crate::schema::{KernelResult, Run, Split, Spread};
use crate::table::describe;
use crate::workload::Scene;
use crate::{frames, machine};
use ashsplat::vk::Context;
use ashsplat::{RenderSettings, Result};
use ashsplat_program::html::{self, Cell, escape, section, shown};
use std::fmt::Write;

const STYLE: &str = "
img { image-rendering: pixelated; width: 350px; display: block; } .zoom { overflow-x: auto; border: 1px solid var(--line); }
";

/// The mouse wheel over the timeline zooms about the pointer.
const SCRIPT: &str = "
document.querySelectorAll('.zoom').forEach(box => { const svg = box.querySelector('svg'); const width = svg.clientWidth; let scale = 1;
  box.addEventListener('wheel', event => { if (event.shiftKey) return; event.preventDefault();
    const x = event.clientX - box.getBoundingClientRect().left, at = (box.scrollLeft + x) / scale;
    scale = Math.min(200, Math.max(1, scale * Math.exp(-event.deltaY / 400)));
    svg.setAttribute('width', width * scale); box.scrollLeft = at * scale - x;
    svg.querySelectorAll('text').forEach(text => { const place = +text.getAttribute('x');
      text.setAttribute('transform', `translate(${place * (1 - 1 / scale)} 0) scale(${1 / scale} 1)`); });
  }, { passive: false }); });
";

/// Stages in the order of their first command, with a colour each.
pub struct Stages(Vec<String>);

const COLORS: [&str; 16] = [
    "#4e79a7", "#f28e2b", "#e15759", "#76b7b2", "#59a14f", "#edc948", "#b07aa1", "#ff9da7", "#9c755f",
    "#7a8aa0", "#2ca02c", "#d62728", "#17becf", "#bcbd22", "#8c564b", "#e377c2",
];

impl Stages {
    fn new(run: &Run) -> Self {
        let mut names: Vec<String> = Vec::new();
        for kernel in &run.kernels {
            if !names.contains(&kernel.scope) {
                names.push(kernel.scope.clone());
            }
        }
        Self(names)
    }

    /// Colour of a stage.
    pub fn color(&self, stage: &str) -> &'static str {
        let index = self.0.iter().position(|name| name == stage).unwrap_or(0);
        COLORS[index % COLORS.len()]
    }

    /// Names of the stages; the name of commands outside all stages is empty.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }

    /// Milliseconds of a stage in an iteration.
    pub fn milliseconds(&self, stage: &str, iteration: &Iteration) -> f64 {
        commands(iteration).filter(|c| c.scope == stage).filter_map(|c| c.nanoseconds).sum::<f64>() * 1e-6
    }
}

/// The page of a measurement, with the constants of `--spec`. Renders the scene once more for the tiles.
pub fn page(
    context: &Context,
    scene: &Scene,
    (run, measured): (&Run, &Measured),
    constants: &[String],
) -> Result<String> {
    let stages = Stages::new(run);
    let mut renderer = frames::renderer(context, scene)?;
    let settings = RenderSettings::default();
    let picture = renderer.render(&scene.camera, &settings)?;
    let filled = renderer.render_with_tiles(&scene.camera, &settings)?.1;
    let title = format!("ashsplat profile: {}", run.name);
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><style>{1}{STYLE}</style></head>\n\
         <body><h1>{0}</h1>\n",
        escape(&title),
        html::STYLE
    );
    let device = context.description();
    let _ = writeln!(
        out,
        "<p class=\"note\">{}<br>{} ({}), {}, Vulkan {}, subgroups of {}</p>",
        escape(&describe(&run.workload)),
        escape(&device.name),
        device.kind,
        escape(&device.driver),
        escape(&device.api_version),
        context.limits().subgroup_size
    );
    let _ = writeln!(out, "<p class=\"note\">{}</p>", machine::program());
    if !constants.is_empty() {
        let _ = writeln!(out, "<p>with {}</p>", escape(&constants.join(", ")));
    }
    out.push_str(&split(&run.split));
    section(&mut out, "Timeline", "the last iteration; wheel zooms, the pointer shows names and times");
    out.push_str(&timeline::svg(&stages, measured.iterations.last()));
    section(&mut out, "Stages", "median of all iterations, with the 90th percentile");
    out.push_str(&stage_times(&stages, measured));
    section(
        &mut out,
        "Kernels",
        "bytes: inputs and outputs once; copy: share of this device's own copy bandwidth",
    );
    out.push_str(&kernels(run));
    section(&mut out, "History", "device time of each iteration by stage; the line is the wall time");
    out.push_str(&history::svg(&stages, measured));
    section(&mut out, "Memory", "most that each arena ever held");
    let arenas = run.memory.iter().map(|arena| (arena.name.as_str(), arena.peak_bytes));
    out.push_str(&html::memory(&arenas.collect::<Vec<_>>()));
    section(
        &mut out,
        "Tiles",
        "entries of each tile's list, and how many of them were blended before all pixels were full",
    );
    out.push_str(&tiles::pictures(&picture, &filled)?);
    section(&mut out, "Histograms", "");
    out.push_str(&tiles::histograms(&filled, &scene.gaussians));
    let _ = writeln!(out, "<script>{SCRIPT}</script></body></html>");
    Ok(out)
}

fn split(s: &Split) -> String {
    let part = |name: &str, ms: f64| format!("{name} {ms:.3} ms ({:.1} %)", 100.0 * ms / s.wall_ms.max(1e-9));
    let kernels = s.kernels_ms.map_or_else(|| "kernels unknown".to_owned(), |ms| part("kernels", ms));
    format!(
        "<p>mean wall time {:.3} ms = {kernels} + {} + {} + {} + {}</p>\n",
        s.wall_ms,
        part("recording", s.recording_ms),
        part("submitting", s.submitting_ms),
        part("waiting", s.waiting_ms),
        part("host", s.host_ms)
    )
}

fn kernels(run: &Run) -> String {
    let row = |k: &KernelResult| {
        let (time, groups) = (k.time_us, k.workgroups.map(|n| n as f64));
        let copy = k.share_of_copy_bandwidth.map(|share| format!("{:.0} %", 100.0 * share));
        vec![
            Cell::Name(shown(&k.scope).to_owned()),
            Cell::Name(k.kernel.clone()),
            Cell::Number(k.calls.to_string()),
            Cell::number(groups, 0),
            Cell::number(time.map(|t| t.median), 1),
            Cell::number(time.map(|t| t.min), 1),
            Cell::number(time.map(|t| t.p90), 1),
            Cell::number(k.bytes_read as f64 * 1e-6, 2),
            Cell::number(k.bytes_written as f64 * 1e-6, 2),
            Cell::number(k.gigabytes_per_second, 2),
            Cell::Number(copy.unwrap_or_else(|| "–".to_owned())),
        ]
    };
    let heads = [
        "stage",
        "kernel",
        "calls",
        "workgroups",
        "µs",
        "least",
        "p90",
        "MB read",
        "MB written",
        "GB/s",
        "copy",
    ];
    html::table(&heads, &run.kernels.iter().map(row).collect::<Vec<_>>(), None)
}

/// A table of the stages' times, milliseconds.
fn stage_times(stages: &Stages, measured: &Measured) -> String {
    let times = stages.iter().filter_map(|stage| {
        let times = measured.iterations.iter().map(|iteration| stages.milliseconds(stage, iteration));
        Some((stage, Spread::of(times.collect())?))
    });
    let times: Vec<(&str, Spread)> = times.collect();
    let most = times.iter().map(|(_, time)| time.median).fold(1e-12, f64::max);
    let row = |(stage, time): &(&str, Spread)| {
        let numbers = [time.median, time.p90].map(|time| Cell::number(time, 3));
        let first = std::iter::once(Cell::Name(shown(stage).to_owned()));
        first.chain(numbers).chain([Cell::Bar(time.median / most)]).collect()
    };
    html::table(&["stage", "ms", "p90", ""], &times.iter().map(row).collect::<Vec<_>>(), None)
}
