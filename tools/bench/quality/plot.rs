//! The curves as SVG, readable on light and dark pages: the mean over the seeds, and a band from least to most.

use super::summary::{Place, Range, Summary};
use ashsplat_program::axis::Axis;
use ashsplat_program::html::{COLORS, escape};
use std::fmt::Write;

const WIDTH: f64 = 470.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 18.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 44.0;
const HEAD: f64 = 56.0;

type Value = fn(&Place) -> Option<Range>;

/// One pair of axes.
struct Panel {
    title: &'static str,
    along: &'static str,
    x: Value,
    y: Value,
    /// True if both axes begin at 0, false if only x does.
    from_zero: bool,
    /// True if it shows the PSNRs to reach.
    shows_until: bool,
}

fn iteration(place: &Place) -> Option<Range> {
    Range::of(std::iter::once(f64::from(place.iteration)))
}

/// Draws four panels: PSNR, SSIM and Gaussians by processor seconds, and PSNR by iteration. Uses seconds if the system does not
/// report processor seconds.
pub fn svg(title: &str, summary: &Summary, until: &[f64]) -> String {
    let places = || summary.curves.iter().flat_map(|curve| &curve.places);
    let (along, cost): (_, Value) = match places().all(|place| place.cpu_seconds.is_some()) {
        true => ("CPU-seconds of training", |place| place.cpu_seconds),
        false => ("seconds of training", |place| Some(place.seconds)),
    };
    let psnr: Value = |place| Some(place.psnr);
    let panel = |title, along, (x, y): (Value, Value), from_zero| Panel {
        title,
        along,
        x,
        y,
        from_zero,
        shows_until: title == "PSNR, dB",
    };
    let panels = [
        panel("PSNR, dB", along, (cost, psnr), false),
        panel("PSNR, dB", "iteration", (iteration, psnr), false),
        panel("SSIM", along, (cost, |place| Some(place.ssim)), false),
        panel("Gaussians", along, (cost, |place| Some(place.gaussians)), true),
    ];
    let (width, height) = (2.0 * WIDTH, HEAD + 2.0 * HEIGHT);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"12\" fill=\"#222222\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n\
         <text x=\"{LEFT}\" y=\"20\">{}</text>\n",
        escape(title)
    );
    let mut x = LEFT;
    for (number, curve) in summary.curves.iter().enumerate() {
        let text = format!("{} ({} seeds)", curve.strategy, curve.seeds.len());
        let _ = writeln!(
            out,
            "<path d=\"M{x:.1} 40h22\" stroke=\"{}\" stroke-width=\"3\"/><text x=\"{:.1}\" y=\"44\">{}</text>",
            color(number),
            x + 28.0,
            escape(&text)
        );
        x += 52.0 + 7.2 * text.len() as f64;
    }
    for (number, panel) in panels.iter().enumerate() {
        let (column, row) = ((number % 2) as f64, (number / 2) as f64);
        let _ = writeln!(out, "<g transform=\"translate({} {})\">", column * WIDTH, HEAD + row * HEIGHT);
        panel.draw(&mut out, summary, until);
        out.push_str("</g>\n");
    }
    out + "</svg>\n"
}

/// Skips the first colour, which plots use for a total.
fn color(curve: usize) -> &'static str {
    COLORS[1 + curve % (COLORS.len() - 1)]
}

impl Panel {
    fn draw(&self, out: &mut String, summary: &Summary, until: &[f64]) {
        let points = |curve: usize| -> Vec<(Range, Range)> {
            let places = summary.curves[curve].places.iter();
            places.filter_map(|place| Some(((self.x)(place)?, (self.y)(place)?))).collect()
        };
        let all: Vec<(Range, Range)> = (0..summary.curves.len()).flat_map(points).collect();
        let (Some(right), Some(high), Some(low)) = (
            all.iter().map(|(x, _)| x.mean).reduce(f64::max),
            all.iter().map(|(_, y)| y.most).reduce(f64::max),
            all.iter().map(|(_, y)| y.least).reduce(f64::min),
        ) else {
            return;
        };
        let (x_axis, y_axis) =
            (Axis::new(0.0, right), Axis::new(if self.from_zero { 0.0 } else { low }, high));
        let place_x = |value: f64| LEFT + (WIDTH - LEFT - RIGHT) * x_axis.share(value);
        let place_y = |value: f64| HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * y_axis.share(value);
        let middle = (LEFT + WIDTH - RIGHT) / 2.0;
        let _ = writeln!(
            out,
            "<text x=\"{LEFT}\" y=\"20\" font-weight=\"bold\">{}</text>\
             <text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            self.title,
            HEIGHT - 8.0,
            self.along
        );
        for value in y_axis.marks() {
            let y = place_y(value);
            let _ = writeln!(
                out,
                "<path d=\"M{LEFT} {y:.1}H{}\" stroke=\"#dddddd\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                WIDTH - RIGHT,
                LEFT - 6.0,
                y + 4.0,
                y_axis.mark(value)
            );
        }
        for value in x_axis.marks() {
            let (x, bottom) = (place_x(value), HEIGHT - BOTTOM);
            let _ = writeln!(
                out,
                "<path d=\"M{x:.1} {TOP}V{bottom}\" stroke=\"#eeeeee\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                bottom + 16.0,
                x_axis.mark(value)
            );
        }
        for &psnr in until.iter().filter(|psnr| self.shows_until && (low..=high).contains(*psnr)) {
            let y = place_y(psnr);
            let right = WIDTH - RIGHT;
            let _ = writeln!(
                out,
                "<path d=\"M{LEFT} {y:.1}H{right}\" stroke=\"#888888\" stroke-dasharray=\"5 4\"/>"
            );
        }
        for (number, curve) in summary.curves.iter().enumerate() {
            let points = points(number);
            let line = |value: fn(&Range) -> f64, points: &mut dyn Iterator<Item = &(Range, Range)>| {
                points
                    .map(|(x, y)| format!("{:.1},{:.1}", place_x(x.mean), place_y(value(y))))
                    .collect::<Vec<_>>()
                    .join(" ")
            };
            let color = color(number);
            if points.iter().any(|(_, y)| y.most > y.least) {
                let above = line(|y| y.most, &mut points.iter());
                let below = line(|y| y.least, &mut points.iter().rev());
                let _ =
                    writeln!(out, "<polygon points=\"{above} {below}\" fill=\"{color}\" opacity=\".2\"/>");
            }
            let mean = line(|y| y.mean, &mut points.iter());
            let _ = writeln!(
                out,
                "<polyline points=\"{mean}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"><title>{}</title></polyline>",
                escape(&curve.strategy)
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::summary::tests::run;
    use super::*;

    #[test]
    fn every_curve_and_its_band_are_in_the_plot() {
        let runs = [run("a", 0, 1.0), run("b < c", 0, 4.0), run("a", 1, 3.0)];
        let names = ["a", "b < c"].map(str::to_owned);
        let text = svg("T & U", &Summary::new(&names, &runs, &[]), &[20.0, 99.0]);
        assert!(text.starts_with("<svg") && text.ends_with("</svg>\n") && text.contains("T &amp; U"));
        // Each strategy is in each of four panels. Both runs of a have the same values, so there is no band.
        assert_eq!((text.matches("<polyline").count(), text.matches("<polygon").count()), (8, 0));
        assert!(text.contains("b &lt; c (1 seeds)") && text.contains("a (2 seeds)"));
        assert_eq!(text.matches("stroke-dasharray").count(), 2, "within the picture only");
        let mut other = run("a", 2, 1.0);
        other.points.iter_mut().for_each(|point| point.psnr += 1.0);
        let text = svg("", &Summary::new(&names, &[runs[0].clone(), other], &[]), &[]);
        assert_eq!(text.matches("<polygon").count(), 2, "PSNR differs");
        for number in text.split(['"', ' ', ',']).filter_map(|word| word.parse::<f64>().ok()) {
            assert!(number.is_finite() && (-1.0..1000.0).contains(&number), "{number}");
        }
    }

    #[test]
    fn a_plot_of_nothing_is_a_plot() {
        assert!(svg("t", &Summary { curves: vec![] }, &[]).ends_with("</svg>\n"));
    }
}
