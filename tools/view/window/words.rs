//! Texts of the window, line by line.

use super::super::protocol::Mode;
use super::keys::HELP;
use ashsplat::{FrameStats, PixelReport};
use ashsplat_program::progress::thousands;
use serde_json::Value;

/// Most Gaussians listed for a pixel.
const LISTED: usize = 16;
/// Most letters of a line of running text.
const WIDEST: usize = 64;

#[derive(Clone, Debug, Default)]
pub struct Measurements {
    /// Size of the picture, pixels.
    pub size: [u32; 2],
    /// Time from its start, or from the end of the previous frame if later, to its end, ms.
    pub milliseconds: f64,
    pub stats: FrameStats,
    /// Values of the lowest and the highest colour.
    pub legend: Option<[f32; 2]>,
}

/// Permanent text: scene, frame, stages, device.
pub fn status(scene: &str, device: &str, mode: Mode, rate: f64, frame: &Measurements) -> Vec<String> {
    let [width, height] = frame.size;
    let rate = if rate > 0.0 { format!(" · {rate:.1} frames/s") } else { String::new() };
    let mut lines =
        vec![scene.to_owned(), format!("{width}×{height} · {:.1} ms{rate} · {mode:?}", frame.milliseconds)];
    let FrameStats { gaussians, visible, instances, scopes, .. } = &frame.stats;
    if *gaussians > 0 {
        let [visible, all, instances] =
            [visible, gaussians, instances].map(|count| thousands(u64::from(*count)));
        lines.push(format!("{visible} of {all} Gaussians visible, {instances} instances"));
    }
    let stages: Vec<_> = scopes.iter().filter(|stage| stage.depth == 0).collect();
    if !stages.is_empty() {
        let sum: f64 = stages.iter().map(|stage| stage.nanoseconds).sum();
        lines.push(format!("{:16}{:8.2} ms", "device", sum * 1e-6));
        lines.extend(stages.iter().map(|s| format!("  {:14}{:8.2} ms", s.name, s.nanoseconds * 1e-6)));
    }
    if let Some([low, high]) = frame.legend {
        lines.push(match mode {
            Mode::Depth => format!("red {low:.3} … blue {high:.3} units of the scene"),
            _ => format!("blue {low:.0} … red {high:.0} Gaussians per tile"),
        });
    }
    lines.push(format!("{device} · ? lists the keys"));
    lines
}

/// How complete a tree's picture is, and what is still being read.
pub fn tree(shown: &Value) -> Option<String> {
    let number = |key: &str| shown[key].as_u64().map(thousands);
    let mut line = format!("{} tiles of a tree of {} Gaussians", number("drawn")?, number("of")?);
    if let Some(missing) = number("missing").filter(|missing| missing != "0") {
        line += &format!(", {missing} to come");
    }
    Some(line)
}

/// Message when exposure and lens effects of photos are switched on or off.
pub fn photo_appearance(on: bool, known: bool) -> &'static str {
    match (on, known) {
        (_, false) => "as photographed: training has learned no exposures and no lens effects",
        (true, true) => "as photographed: on, in the photos' views",
        (false, true) => "as photographed: off",
    }
}

/// Message that no display can be opened: winit's words without the place in its sources.
pub fn no_display(message: &str) -> String {
    let place = message.starts_with("os error at ").then(|| message.split_once(": ")).flatten();
    let message = place.map_or(message, |(_, rest)| rest).trim_end_matches('.');
    format!("no display can be opened ({message})")
}

/// Breaks a text into lines of bounded width.
pub fn wrapped(text: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let Some(line) = lines.last_mut() else { break };
        if !line.is_empty() && line.chars().count() + word.chars().count() >= WIDEST {
            lines.push(word.to_owned());
        } else {
            line.push_str(if line.is_empty() { "" } else { " " });
            line.push_str(word);
        }
    }
    lines
}

pub fn help() -> Vec<String> {
    let widest = HELP.iter().map(|(key, _)| key.chars().count()).max().unwrap_or(0);
    HELP.iter().map(|(key, meaning)| format!("{key:widest$}  {meaning}")).collect()
}

/// Lines about the Gaussians blended at a pixel.
pub fn picked([x, y]: [u32; 2], report: &PixelReport) -> Vec<String> {
    let [r, g, b] = report.color;
    let opaque = 100.0 * (1.0 - report.transmittance);
    let mut lines = vec![
        format!("pixel {x}, {y} · {} Gaussians", report.samples.len()),
        format!("{r:.3} {g:.3} {b:.3}, {opaque:.1} % opaque"),
        format!("{:>9} {:>9} {:>7} {:>7} {:>7}", "id", "depth", "alpha", "weight", "left"),
    ];
    lines.extend(report.samples.iter().take(LISTED).map(|s| {
        let left = s.transmittance_after;
        format!("{:9} {:9.3} {:7.3} {:7.4} {left:7.4}", s.gaussian, s.depth, s.alpha, s.weight)
    }));
    if report.samples.len() > LISTED {
        lines.push(format!("{:>9} {} more", "", report.samples.len() - LISTED));
    }
    lines
}
