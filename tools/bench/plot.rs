//! Log-log plots as SVG, readable on light and dark pages.

use ashsplat_program::html::{COLORS, escape};
use std::fmt::Write;

/// A curve.
pub struct Series {
    pub name: String,
    pub points: Vec<(f64, f64)>,
}

/// One pair of axes.
pub struct Panel {
    pub title: String,
    /// Quantity along x; y is milliseconds.
    pub axis: String,
    pub series: Vec<Series>,
}

const WIDTH: f64 = 470.0;
const HEIGHT: f64 = 400.0;
const MARGIN: f64 = 60.0;
const LEGEND_WIDTH: f64 = 150.0;
const PANELS_PER_ROW: usize = 2;

/// Draws the panels, two in a row, with one legend for all.
pub fn svg(subtitle: &str, panels: &[Panel]) -> String {
    let names = names(panels);
    let columns = panels.len().min(PANELS_PER_ROW) as f64;
    let width = WIDTH * columns + LEGEND_WIDTH;
    let rows_height = HEIGHT * panels.len().div_ceil(PANELS_PER_ROW) as f64;
    let total_height = 30.0 + rows_height.max(50.0 + 20.0 * names.len() as f64);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {total_height}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{width}\" height=\"{total_height}\" fill=\"#ffffff\"/>\n\
         <text x=\"{}\" y=\"20\" text-anchor=\"middle\" font-size=\"13\">Time of each stage on {}</text>\n",
        width / 2.0,
        escape(subtitle)
    );
    for (i, panel) in panels.iter().enumerate() {
        let (x, y) = (WIDTH * (i % PANELS_PER_ROW) as f64, 30.0 + HEIGHT * (i / PANELS_PER_ROW) as f64);
        let _ = writeln!(out, "<g transform=\"translate({x} {y})\">");
        one_panel(&mut out, panel, &names);
        out.push_str("</g>\n");
    }
    for (i, name) in names.iter().enumerate() {
        let (x, y) = (WIDTH * columns, 60.0 + 20.0 * i as f64);
        let color = COLORS[i % COLORS.len()];
        let _ = writeln!(
            out,
            "<path d=\"M{x} {y}h24\" stroke=\"{color}\" stroke-width=\"2\"/><text x=\"{}\" y=\"{}\">{}</text>",
            x + 30.0,
            y + 4.0,
            escape(name)
        );
    }
    out.push_str("</svg>\n");
    out
}

fn names(panels: &[Panel]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for series in panels.iter().flat_map(|panel| &panel.series) {
        if !names.contains(&series.name.as_str()) {
            names.push(&series.name);
        }
    }
    names
}

/// Powers of ten around all values.
fn decades(values: impl Iterator<Item = f64>) -> (i32, i32) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values.filter(|v| *v > 0.0) {
        low = low.min(value.log10());
        high = high.max(value.log10());
    }
    if low > high {
        return (0, 1);
    }
    let (low, high) = ((low + 1e-9).floor() as i32, (high - 1e-9).ceil() as i32);
    (low, high.max(low + 1))
}

fn one_panel(out: &mut String, panel: &Panel, names: &[&str]) {
    let points = || panel.series.iter().flat_map(|series| &series.points);
    let ((x0, x1), (y0, y1)) = (decades(points().map(|p| p.0)), decades(points().map(|p| p.1)));
    let (w, h) = (WIDTH - MARGIN - 25.0, HEIGHT - 100.0);
    let place_x = |x: f64| MARGIN + w * (x.log10() - f64::from(x0)) / f64::from(x1 - x0);
    let place_y = |y: f64| 40.0 + h * (1.0 - (y.log10() - f64::from(y0)) / f64::from(y1 - y0));
    let middle = MARGIN + w / 2.0;
    let _ = writeln!(
        out,
        "<text x=\"{middle}\" y=\"25\" text-anchor=\"middle\">{}</text>\
         <text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>\
         <text transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">milliseconds</text>",
        escape(&panel.title),
        80.0 + h,
        escape(&panel.axis),
        40.0 + h / 2.0
    );
    for decade in x0..=x1 {
        let x = place_x(10f64.powi(decade));
        let _ = writeln!(
            out,
            "<path d=\"M{x:.1} 40v{h}\" stroke=\"#dddddd\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            56.0 + h,
            power(decade)
        );
    }
    for decade in y0..=y1 {
        let y = place_y(10f64.powi(decade));
        let _ = writeln!(
            out,
            "<path d=\"M{MARGIN} {y:.1}h{w}\" stroke=\"#dddddd\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            MARGIN - 5.0,
            y + 4.0,
            power(decade)
        );
    }
    for (number, series) in panel.series.iter().enumerate() {
        let index = names.iter().position(|name| *name == series.name).unwrap_or(0);
        let color = COLORS[index % COLORS.len()];
        let mut path = String::new();
        for &(x, y) in series.points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0) {
            let (x, y) = (place_x(x), place_y(y));
            let _ = write!(path, "{}{x:.1} {y:.1}", if path.is_empty() { "M" } else { "L" });
            let _ = writeln!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.5\" fill=\"{color}\"/>");
        }
        // The first curve of a panel is the total.
        let thick = if number == 0 { 3.0 } else { 1.5 };
        let _ = writeln!(
            out,
            "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{thick}\"><title>{}</title></path>",
            escape(&series.name)
        );
    }
}

/// Formats a power of ten for people.
fn power(decade: i32) -> String {
    match decade {
        0..=2 => 10i32.pow(decade as u32).to_string(),
        3..=5 => format!("{}k", 10i32.pow(decade as u32 - 3)),
        6..=8 => format!("{}M", 10i32.pow(decade as u32 - 6)),
        -3..=-1 => format!("{:.*}", -decade as usize, 10f64.powi(decade)),
        _ => format!("1e{decade}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_span_whole_decades() {
        assert_eq!(decades([10_000.0, 1e6].into_iter()), (4, 6));
        assert_eq!(decades([0.5, 12.0].into_iter()), (-1, 2));
        assert_eq!(decades([0.0].into_iter()), (0, 1));
        assert_eq!([-2, 0, 4, 6].map(power), ["0.01", "1", "10k", "1M"]);
    }

    #[test]
    fn every_series_is_in_the_plot() {
        let series = |name: &str| Series { name: name.into(), points: vec![(1e4, 0.1), (1e5, 2.0)] };
        let panel =
            Panel { title: "t".into(), axis: "x < y".into(), series: vec![series("a"), series("b & c")] };
        let text = svg("device", &[panel]);
        assert!(text.contains("b &amp; c") && text.contains("x &lt; y"));
        assert_eq!(text.matches("<circle").count(), 4);
    }
}
