//! `report.html`: a run on one self-contained page.

mod appearances;
mod curves;
mod kernels;
mod views;

use super::Run;
use super::tracking::spread;
use ashsplat::Result;
use ashsplat::scene::{Gaussians, WorldFrame};
use ashsplat::train::TrainSettings;
use ashsplat_files::{View, quoted};
use ashsplat_program::child;
use ashsplat_program::config::{DataSettings, Settings};
use ashsplat_program::eval::{self, Evaluation, ExtraMeasures};
use ashsplat_program::html::{self, escape, section};
use ashsplat_program::output;
use ashsplat_program::progress::thousands;
use ashsplat_program::train_log::{LOG_FILE, Rows};
use std::fmt::Write;
use std::path::Path;

pub use kernels::KernelTimes;

pub const REPORT_FILE: &str = "report.html";

const SETTINGS_COLUMNS: usize = 3;

const STYLE: &str = "
:root { --a: #2563c9; --b: #1e8a5a; --c: #b4570f; --d: #7a3fb0; --card: #f5f6f8; --edge: #e2e5ea; }
@media (prefers-color-scheme: dark) { :root { --a: #6ea3ff; --b: #52c893; --c: #f0a05a; --d: #c08cf2; --card: #222327; --edge: #34363c; } }
body { font-family: system-ui, sans-serif; margin-bottom: 4em; } h1 { font-size: 1.6em; margin: 0; } h2 { font-size: 1.2em; margin-top: 2.4em; }
.badge { font-size: 12px; font-weight: 600; padding: 2px 9px; border-radius: 9px; margin-left: .7em; vertical-align: .35em; color: #fff; background: #1e8a5a; }
.badge.stopped { background: #b4570f; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(132px, 1fr)); gap: 10px; margin: 1.3em 0; }
.card { background: var(--card); border: 1px solid var(--edge); border-radius: 8px; padding: 9px 13px; }
.card b { display: block; font-size: 1.45em; font-weight: 600; font-variant-numeric: tabular-nums; white-space: nowrap; }
.card span { color: var(--soft); font-size: 12px; }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 14px; }
.chart { background: var(--card); border: 1px solid var(--edge); border-radius: 8px; padding: 10px 12px 4px; }
.chart svg { width: 100%; height: auto; } .chart figcaption { display: flex; gap: .8em; align-items: baseline; color: var(--text); }
.chart figcaption span { color: var(--soft); } .chart output { margin-left: auto; font-variant-numeric: tabular-nums; font-weight: 600; white-space: nowrap; }
.sheet { display: grid; grid-template-columns: repeat(auto-fit, minmax(480px, 1fr)); gap: 8px 18px; }
.view { display: grid; align-content: start; grid-template-columns: repeat(3, 1fr); gap: 4px; margin-bottom: 14px; } .view p { grid-column: 1 / -1; margin: 0; font-size: 12px; }
.view img { width: 100%; border-radius: 3px; display: block; } .scale { display: inline-block; width: 110px; height: .75em; border-radius: 2px; }
td.bar i { background: var(--a); opacity: .75; }
.settings td.name { white-space: nowrap; overflow-wrap: normal; } tr.own td { font-weight: 600; } td { overflow-wrap: anywhere; }
.settings { display: grid; grid-template-columns: repeat(auto-fit, minmax(320px, 1fr)); gap: 0 28px; align-items: start; } code { font-size: .93em; }
.histograms svg { background: var(--card); border: 1px solid var(--edge); border-radius: 8px; padding: 5px 0; }
@media print { .chart, .view { break-inside: avoid; } }
";

/// Shows the value under the pointer.
const SCRIPT: &str = "
document.querySelectorAll('.chart').forEach(chart => {
  const svg = chart.querySelector('svg'), data = svg.querySelector('script'), output = chart.querySelector('output');
  if (!data) return;
  const points = JSON.parse(data.textContent), last = output.textContent, [line, dot] = svg.querySelectorAll('.cursor');
  svg.addEventListener('pointermove', event => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse()).x;
    const [x, y, iteration, value] = points.reduce((a, b) => Math.abs(b[0] - at) < Math.abs(a[0] - at) ? b : a);
    line.setAttribute('d', `M${x} 12V192`); dot.setAttribute('cx', x); dot.setAttribute('cy', y); dot.setAttribute('r', 4);
    output.textContent = `${iteration}: ${value}${svg.dataset.unit}`;
  });
  svg.addEventListener('pointerleave', () => { line.setAttribute('d', ''); dot.setAttribute('r', 0); output.textContent = last; });
});
";

/// Writes the page of a run that has ended or was stopped.
pub fn write(run: &mut Run, interrupted: bool) -> Result<()> {
    let path = run.settings.data.model_path.join(REPORT_FILE);
    let rows = Rows::read(&run.settings.data.model_path.join(LOG_FILE))?;
    let page = page(run, &rows, interrupted)?;
    output::write_text(&path, &page)
}

impl Run {
    pub fn report(&self) {
        for tested in &self.evaluations {
            outln!("{}", self.describe(tested));
        }
        if let Some(first) = self.first {
            outln!("first {} iterations: {first}", first.iterations);
        }
        if let Some(total) = self.total {
            outln!("all {} iterations: {total}, {:.1} s", total.iterations, total.seconds);
        }
        if let Ok(Some(moved)) = self.pose_movement() {
            outln!("{}", moved.describe());
        }
        if let Some(lenses) = self.describe_lenses() {
            outln!("{lenses}");
        }
        if self.skipped > 0 {
            outln!(
                "{} iterations were left out: their frames were too large",
                thousands(self.skipped.into())
            );
        }
        if self.non_finite > 0 {
            outln!("{} updates with a gradient that is not finite were skipped", thousands(self.non_finite));
        }
    }
}

fn page(run: &mut Run, rows: &Rows, interrupted: bool) -> Result<String> {
    let iteration = run.trainer.iteration();
    let tested = run.evaluations.last().filter(|tested| tested.iteration == iteration);
    let (chosen, evaluation) = match tested {
        Some(tested) => (run.views.test.clone(), tested.evaluation.clone()),
        // After an interruption, the user does not want to wait for all views.
        None => measure_some(run)?,
    };
    let kind = if run.views.held_out { "held-out" } else { "training" };
    let gaussians = run.trainer.gaussians()?;
    let mut out = head(run, interrupted);
    out.push_str(&cards(run, rows, &evaluation, gaussians.len())?);
    section(
        &mut out,
        "Curves",
        "the line is the mean of neighbouring iterations, the band goes from the least to the most of them",
    );
    out.push_str(&curves::charts(rows, kind, &run.tracking.describe(kind)));
    sheet(&mut out, run, &evaluation, &chosen)?;
    let note = format!("{} {kind} views, worst first", evaluation.views.len());
    section(&mut out, "Views", &note);
    out.push_str(&views::table(&evaluation));
    let note = match evaluation.measures.is_empty() {
        true => {
            "LPIPS is not computed: it needs the weights of a network, which do not come with this program: \
             <code>--lpips-weights FILE</code>."
        }
        false => {
            "LPIPS by the weights that were given: lpips_alex of AlexNet on values from −1 to 1, lpips_vgg_unscaled of \
             VGG16 on values from 0 to 1."
        }
    };
    let _ = writeln!(out, "<p class=\"note\">{note}</p>");
    appearances::sections(&mut out, &run.appearances()?);
    histograms(&mut out, &gaussians, &run.views.frame);
    section(&mut out, "Kernels", &run.kernels.note());
    out.push_str(&run.kernels.table());
    memory(&mut out, run);
    section(&mut out, "Settings", "bold: not the default; settings.toml has them for <code>--config</code>");
    out.push_str(&settings(&run.settings)?);
    let _ = writeln!(out, "<script>{SCRIPT}</script></body></html>");
    Ok(out)
}

/// Measures a few of the views, evenly spread.
fn measure_some(run: &mut Run) -> Result<(Vec<View>, Evaluation)> {
    let views = spread(&run.views.test, views::SHOWN);
    let settings = run.trainer.render_settings();
    let protocol = run.protocol()?;
    let evaluation = eval::evaluate(views.iter().map(Ok), &protocol, ExtraMeasures::default(), |camera| {
        run.trainer.render(camera, &settings)
    })?;
    Ok((views, evaluation))
}

fn head(run: &Run, interrupted: bool) -> String {
    let data = &run.settings.data;
    let name = |path: &std::path::Path| {
        path.file_name().map_or_else(|| path.to_owned(), Into::into).display().to_string()
    };
    let title = format!("Training of {}", name(&data.source_path));
    let (done, of) = (run.trainer.iteration(), run.settings.train.iterations);
    let (class, state) = match (interrupted, done < of) {
        (false, false) => ("", format!("{} iterations", thousands(done.into()))),
        _ => (
            " stopped",
            format!("stopped after {} of {} iterations", thousands(done.into()), thousands(of.into())),
        ),
    };
    let device = run.kernels.device();
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{0}</title><style>{1}{STYLE}</style></head>\n<body><h1>{0}<span class=\"badge{class}\">{state}</span></h1>\n\
         <p class=\"note\">{2} → {3}<br>{4}<br>ashsplat {5}</p>\n",
        escape(&title),
        html::STYLE,
        escape(&data.source_path.display().to_string()),
        escape(&data.model_path.display().to_string()),
        escape(&device),
        env!("CARGO_PKG_VERSION"),
    )
}

fn cards(run: &Run, rows: &Rows, evaluation: &Evaluation, gaussians: usize) -> Result<String> {
    let kind = if run.views.held_out { "held out" } else { "on training views" };
    let seconds = rows.milliseconds.iter().sum::<f64>() * 1e-3;
    let speed = rows.milliseconds.len() as f64 / seconds.max(1e-9);
    let peak = rows.peak_bytes.iter().copied().fold(0.0, f64::max) / 1_048_576.0;
    let time = match seconds as u64 {
        s if s >= 3600 => format!("{}:{:02}:{:02} h", s / 3600, s / 60 % 60, s % 60),
        s if s >= 60 => format!("{}:{:02} min", s / 60, s % 60),
        _ => format!("{seconds:.1} s"),
    };
    let measured = |value: String| if evaluation.views.is_empty() { "not measured".into() } else { value };
    let mut cards = vec![
        (measured(format!("{:.2} dB", evaluation.psnr())), format!("PSNR, {kind}")),
        (measured(format!("{:.4}", evaluation.ssim())), format!("SSIM, {kind}")),
        (thousands(gaussians as u64), "Gaussians".into()),
        (time, "in iterations".into()),
        (format!("{speed:.1} it/s"), "on average".into()),
        (format!("{peak:.0} MiB"), "device memory, peak".into()),
    ];
    if let [worst, _, ..] = views::worst_first(&evaluation.views)[..] {
        let worst = &evaluation.views[worst];
        let below = evaluation.psnr() - worst.psnr;
        let label = format!("PSNR of the worst view, {}: {below:.2} dB below the mean", escape(&worst.name));
        cards.push((format!("{:.2} dB", worst.psnr), label));
    }
    if run.settings.train.exposure {
        cards.push((
            measured(format!("{:.2} dB", evaluation.cc_psnr())),
            format!("CC-PSNR (colour-corrected), {kind}"),
        ));
    }
    let lpips = evaluation.lpips().map(|(name, value)| (format!("{value:.4}"), format!("{name}, {kind}")));
    cards.extend(lpips.filter(|_| !evaluation.views.is_empty()));
    if let Some(bytes) = evaluation.scene.and_then(|scene| scene.bytes) {
        cards.push((format!("{:.2} MB", bytes as f64 * 1e-6), "file of the scene".into()));
    }
    cards.extend(
        evaluation.frame_ms().map(|time| (format!("{time:.2} ms"), "frame, median of the views".into())),
    );
    if let Some(moved) = run.pose_movement()? {
        let ([degrees, max], [share, max_share]) = (moved.degrees, moved.shares);
        cards.push((format!("{degrees:.3}°"), format!("poses turned, mean (most {max:.3}°)")));
        let max_share = 100.0 * max_share;
        cards.push((
            format!("{:.3} %", 100.0 * share),
            format!("of the extent moved, mean (most {max_share:.3} %)"),
        ));
        let last = run.evaluations.last().and_then(|tested| tested.evaluation.aligned.as_ref());
        if let Some(aligned) = last.filter(|aligned| !aligned.views.is_empty()) {
            cards.push((format!("{:.2} dB", aligned.psnr()), "PSNR, held out, cameras aligned".into()));
        }
    }
    let mut out = String::from("<div class=\"cards\">");
    for (value, label) in cards {
        let _ = write!(out, "<div class=\"card\"><b>{value}</b><span>{label}</span></div>");
    }
    out.push_str("</div>\n");
    Ok(out)
}

fn sheet(out: &mut String, run: &mut Run, evaluation: &Evaluation, all: &[View]) -> Result<()> {
    let order = views::worst_first(&evaluation.views);
    let shown = spread(&order, views::SHOWN);
    let note = match (shown.len(), order.len()) {
        (some, all) if some < all => {
            format!("{some} of {all} views from the worst to the best: photo, render, error")
        }
        _ => "photo, render, error, worst first; striped: hidden by a mask".to_owned(),
    };
    section(out, "Contact sheet", &note);
    out.push_str(&views::key());
    out.push_str("<div class=\"sheet\">\n");
    let settings = run.trainer.render_settings();
    for result in shown.into_iter().map(|place| &evaluation.views[place]) {
        let Some(view) = all.iter().find(|view| view.name == result.name) else { continue };
        let frame = run.trainer.render(&view.camera, &settings)?;
        views::row(out, view, &frame, result)?;
    }
    out.push_str("</div>\n");
    Ok(())
}

fn histograms(out: &mut String, gaussians: &Gaussians, frame: &WorldFrame) {
    section(out, "Gaussians", "how many have which opacity, size (σ, the data set's units) and shape");
    let opacities: Vec<f64> =
        gaussians.opacity_logits.iter().map(|&o| 1.0 / (1.0 + (-f64::from(o)).exp())).collect();
    let log10 = |log: f32| f64::from(log) / std::f64::consts::LN_10 + frame.unit.log10();
    let ends = |s: &[f32; 3]| (s[0].min(s[1]).min(s[2]), s[0].max(s[1]).max(s[2]));
    let largest: Vec<f64> = gaussians.log_scales.iter().map(|s| log10(ends(s).1)).collect();
    let smallest: Vec<f64> = gaussians.log_scales.iter().map(|s| log10(ends(s).0)).collect();
    let ratio: Vec<f64> = gaussians.log_scales.iter().map(|s| log10(ends(s).1) - log10(ends(s).0)).collect();
    out.push_str("<div class=\"row histograms\">");
    html::histogram(out, "opacity", &opacities);
    html::histogram(out, "log10 of the largest σ", &largest);
    html::histogram(out, "log10 of the smallest σ", &smallest);
    html::histogram(out, "log10 of largest : smallest", &ratio);
    out.push_str("</div>\n");
}

fn memory(out: &mut String, run: &Run) {
    let (mut arenas, sums): (Vec<_>, Vec<_>) =
        (run.trainer.memory().into_iter()).partition(|arena| !["total", "offloaded"].contains(&arena.name));
    let offloaded = sums.iter().find(|sum| sum.name == "offloaded").map_or_else(String::new, |sum| {
        format!(
            "; scene, moments, scratch and surroundings, {} MiB, lie in the machine's memory",
            sum.peak_bytes >> 20
        )
    });
    section(out, "Device memory", &format!("most that each arena ever held{offloaded}"));
    arenas.sort_by_key(|arena| std::cmp::Reverse(arena.peak_bytes));
    let held = arenas.iter().filter(|arena| arena.peak_bytes > 0);
    let held: Vec<(&str, u64)> = held.map(|arena| (arena.name, arena.peak_bytes)).collect();
    out.push_str(&html::memory(&held));
}

fn settings(settings: &Settings) -> Result<String> {
    let usual = Settings { data: DataSettings::default(), train: TrainSettings::default() };
    let (text, usual) = (settings.to_toml()?, usual.to_toml()?);
    let rows: Vec<String> = text
        .lines()
        .filter_map(|line| {
            let (name, value) = line.split_once(" = ")?;
            let class = if usual.lines().any(|other| other == line) { "" } else { " class=\"own\"" };
            let (name, value) = (escape(name), escape(value));
            Some(format!("<tr{class}><td class=\"name\">{name}</td><td>{value}</td></tr>\n"))
        })
        .collect();
    let mut out = String::from("<div class=\"settings\">");
    for part in rows.chunks(rows.len().div_ceil(SETTINGS_COLUMNS).max(1)) {
        let _ = writeln!(out, "<table>{}</table>", part.concat());
    }
    out.push_str("</div>\n");
    Ok(out)
}

pub fn print_complete(settings: &Settings) -> Result<()> {
    outln!("{} is trained to its end already", settings.data.model_path.display());
    Ok(())
}

/// Prints the next commands for a trained scene. `measured` is true if held-out photographs were measured.
pub fn print_next_steps(model: &Path, measured: bool) {
    let name = quoted(&model.to_string_lossy());
    outln!("look at it      ashsplat view {name}");
    // A GIF is many times as large.
    let film = if child::has("ffmpeg") { "film.mp4" } else { "film.gif" };
    outln!("make a film     ashsplat render {name} -o {film}");
    outln!("the report      {}", model.join(REPORT_FILE).display());
    if !measured {
        outln!("how good it is  train with --eval: every eighth photograph is held out, and measured");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_in_the_units_of_the_data_set() {
        let of = |log_scales: Vec<[f32; 3]>, unit: f64| {
            let (gaussians, mut out) = (Gaussians { log_scales, ..Gaussians::default() }, String::new());
            histograms(&mut out, &gaussians, &WorldFrame { unit, ..WorldFrame::default() });
            out
        };
        let log = |size: f32| [size.ln(); 3];
        assert!(of(vec![log(2.0), log(30.0)], 0.01) == of(vec![log(0.02), log(0.3)], 1.0));
    }
}
