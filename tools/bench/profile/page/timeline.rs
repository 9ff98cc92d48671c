//! Host and device side by side, on one clock.

use super::Stages;
use crate::measure::Iteration;
use ashsplat::vk::Submission;
use ashsplat_program::html::{escape, shown};
use std::fmt::Write;
use std::time::Instant;

const WIDTH: f64 = 1120.0;
/// Left end of the bars, after the names of the rows.
const LEFT: f64 = 60.0;
const BAR: f64 = 34.0;
const HOST_Y: f64 = 24.0;
const DEVICE_Y: f64 = 70.0;

/// Draws the host and device rows of an iteration.
pub fn svg(stages: &Stages, iteration: Option<&Iteration>) -> String {
    let Some(iteration) = iteration else { return String::new() };
    let wall_ms = iteration.wall.as_secs_f64() * 1e3;
    let rows = Rows { origin: iteration.begun, scale: (WIDTH - LEFT - 5.0) / wall_ms.max(1e-9) };
    let mut out = format!(
        "<div class=\"zoom\"><svg width=\"{WIDTH}\" height=\"130\" viewBox=\"0 0 {WIDTH} 130\" preserveAspectRatio=\"none\">\n"
    );
    rows.axis(&mut out, wall_ms);
    let _ = writeln!(out, "<text x=\"4\" y=\"46\">host</text><text x=\"4\" y=\"92\">device</text>");
    rows.bar(&mut out, HOST_Y, (0.0, wall_ms), "#8883", &format!("iteration: {wall_ms:.3} ms"));
    for submission in &iteration.submissions {
        rows.host(&mut out, submission);
        rows.device(&mut out, stages, submission);
    }
    out.push_str("</svg></div>\n<p>");
    let host = [("recording", "#3a86c8"), ("submitting", "#e0a030"), ("waiting", "#b0b0b0")];
    let keys = host.into_iter().chain(stages.iter().map(|stage| (shown(stage), stages.color(stage))));
    for (name, color) in keys {
        let _ =
            write!(out, "<span class=\"key\"><i style=\"background:{color}\"></i>{}</span> ", escape(name));
    }
    out.push_str("</p>\n");
    out
}

struct Rows {
    origin: Instant,
    /// Pixels per millisecond.
    scale: f64,
}

impl Rows {
    fn at(&self, time: Instant) -> f64 {
        time.saturating_duration_since(self.origin).as_secs_f64() * 1e3
    }

    /// Draws a bar over (begin, duration), milliseconds.
    fn bar(&self, out: &mut String, y: f64, (begin, duration): (f64, f64), color: &str, title: &str) {
        let (x, width) = (LEFT + begin * self.scale, (duration * self.scale).max(0.05));
        let _ = writeln!(
            out,
            "<rect x=\"{x:.3}\" y=\"{y}\" width=\"{width:.3}\" height=\"{BAR}\" fill=\"{color}\"><title>{}</title></rect>",
            escape(title)
        );
    }

    fn host(&self, out: &mut String, s: &Submission) {
        let parts = [
            ("recording", s.begun, s.submitting, "#3a86c8"),
            ("submitting", s.submitting, s.submitted, "#e0a030"),
            ("waiting for", s.submitted, s.done, "#b0b0b0"),
        ];
        for (what, begin, end, color) in parts {
            let duration = (end - begin).as_secs_f64() * 1e3;
            let title = format!("{what} {}: {duration:.4} ms", s.label);
            self.bar(out, HOST_Y, (self.at(begin), duration), color, &title);
        }
    }

    fn device(&self, out: &mut String, stages: &Stages, s: &Submission) {
        let Some(begun) = s.device_begun else { return };
        let begun = self.at(begun);
        for command in &s.commands {
            let (Some(begin), Some(duration)) = (command.begin_ns, command.nanoseconds) else { continue };
            let groups =
                command.workgroups.map_or_else(String::new, |[x, y, z]| format!(", {x}x{y}x{z} workgroups"));
            let title =
                format!("{}: {} {:.1} µs{groups}", shown(&command.scope), command.name, duration * 1e-3);
            let place = (begun + begin * 1e-6, duration * 1e-6);
            self.bar(out, DEVICE_Y, place, stages.color(&command.scope), &title);
        }
    }

    fn axis(&self, out: &mut String, wall_ms: f64) {
        let step = 10f64.powf((wall_ms / 8.0).log10().ceil());
        let step = if wall_ms / step < 4.0 { step / 2.0 } else { step };
        let ticks = (wall_ms / step.max(1e-9)).floor() as usize;
        for tick in 0..=ticks {
            let time = tick as f64 * step;
            let x = LEFT + time * self.scale;
            let _ = writeln!(
                out,
                "<path d=\"M{x:.2} 16V112\" stroke=\"#8884\" vector-effect=\"non-scaling-stroke\"/><text x=\"{x:.2}\" y=\"124\" text-anchor=\"middle\">{time} ms</text>"
            );
        }
    }
}
