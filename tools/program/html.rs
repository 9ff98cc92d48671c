//! Parts of self-contained pages: style, pictures, histograms.

use crate::output;
use ashsplat::Result;
use ashsplat_files::Photo;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use std::fmt::Write;

pub const STYLE: &str = "
:root { color-scheme: light dark; --line: #8884; --text: #222; --page: #fff; --soft: #666; }
@media (prefers-color-scheme: dark) { :root { --text: #ddd; --page: #181818; --soft: #999; } }
body { font: 14px/1.45 sans-serif; color: var(--text); background: var(--page); max-width: 1160px; margin: 1.5em auto; padding: 0 1em; }
h1 { font-size: 1.4em; margin-bottom: 0; } h2 { font-size: 1.1em; margin: 1.8em 0 .4em; }
p.note { color: var(--soft); margin: .2em 0 .6em; } svg { display: block; } svg text { fill: currentColor; font: 11px sans-serif; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; font-size: 12px; }
td, th { padding: 2px 7px; text-align: right; border-bottom: 1px solid var(--line); } td.name, th.name { text-align: left; }
.key { display: inline-block; margin-right: 1em; } .key i { display: inline-block; width: .8em; height: .8em; margin-right: .35em; }
.bar { width: 34%; } td.bar i { display: block; height: .75em; border-radius: 2px; background: #4e79a7; }
tr.sum td { font-weight: 600; border-bottom: none; }
.row { display: flex; flex-wrap: wrap; gap: 1.2em; } figure { margin: 0; } figcaption { color: var(--soft); font-size: 12px; }
";

pub fn section(out: &mut String, title: &str, note: &str) {
    let _ = writeln!(out, "<h2>{title}</h2><p class=\"note\">{note}</p>");
}

pub enum Cell {
    /// Text at the left.
    Name(String),
    /// Text at the right; HTML.
    Number(String),
    /// A bar, as a share of the column's width.
    Bar(f64),
}

impl Cell {
    /// A number with this number of digits after the point; a dash for none.
    pub fn number(value: impl Into<Option<f64>>, digits: usize) -> Cell {
        Cell::Number(value.into().map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}")))
    }

    fn class(&self) -> &'static str {
        match self {
            Cell::Name(_) => " class=\"name\"",
            Cell::Number(_) => "",
            Cell::Bar(_) => " class=\"name bar\"",
        }
    }

    fn html(&self) -> String {
        match self {
            Cell::Name(text) => escape(text),
            Cell::Number(text) => text.clone(),
            Cell::Bar(share) => format!("<i style=\"width:{:.1}%\"></i>", 100.0 * share),
        }
    }
}

/// A table. `sum` is its last row, set off from the others.
pub fn table(heads: &[&str], rows: &[Vec<Cell>], sum: Option<Vec<Cell>>) -> String {
    let first = rows.first().or(sum.as_ref()).map_or(&[][..], |row| row);
    let class = |column: usize| first.get(column).map_or("", Cell::class);
    let heads = heads.iter().enumerate().map(|(column, head)| format!("<th{}>{head}</th>", class(column)));
    let mut out = format!("<table><tr>{}</tr>\n", heads.collect::<String>());
    for (row, kind) in rows.iter().map(|row| (row, "")).chain(sum.iter().map(|row| (row, " class=\"sum\""))) {
        let cells = row.iter().map(|cell| format!("<td{}>{}</td>", cell.class(), cell.html()));
        let _ = writeln!(out, "<tr{kind}>{}</tr>", cells.collect::<String>());
    }
    out + "</table>\n"
}

/// A table of arenas and the most bytes that each ever held.
pub fn memory(arenas: &[(&str, u64)]) -> String {
    let max = arenas.iter().map(|(_, bytes)| *bytes).max().unwrap_or(1).max(1) as f64;
    let row = |&(name, bytes): &(&str, u64)| {
        let bytes = bytes as f64;
        vec![Cell::Name(name.to_owned()), Cell::number(bytes / 1_048_576.0, 2), Cell::Bar(bytes / max)]
    };
    table(&["arena", "MiB", ""], &arenas.iter().map(row).collect::<Vec<_>>(), None)
}

pub fn jpeg(photo: &Photo) -> Result<String> {
    Ok(format!("data:image/jpeg;base64,{}", BASE64_STANDARD.encode(output::to_jpeg(photo, 90)?)))
}

/// A colour from dark blue over purple and orange to light yellow. Its brightness rises, so it reads in grey too.
pub fn heat(share: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] = [
        [8.0, 8.0, 32.0],
        [80.0, 18.0, 123.0],
        [182.0, 54.0, 121.0],
        [251.0, 136.0, 97.0],
        [252.0, 253.0, 191.0],
    ];
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let below = (place as usize).min(STOPS.len() - 2);
    let part = place - below as f64;
    [0, 1, 2].map(|c| (STOPS[below][c] * (1.0 - part) + STOPS[below + 1][c] * part).round() as u8)
}

const BINS: usize = 40;

pub fn histogram(out: &mut String, name: &str, values: &[f64]) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for &value in values.iter().filter(|v| v.is_finite()) {
        low = low.min(value);
        high = high.max(value);
    }
    if low > high {
        return;
    }
    let step = ((high - low) / BINS as f64).max(1e-9);
    let mut bins = [0u32; BINS];
    for &value in values.iter().filter(|v| v.is_finite()) {
        bins[(((value - low) / step) as usize).min(BINS - 1)] += 1;
    }
    let max = f64::from(bins.iter().copied().max().unwrap_or(1).max(1));
    let _ = writeln!(
        out,
        "<svg width=\"262\" height=\"140\"><text x=\"131\" y=\"12\" text-anchor=\"middle\">{name}</text>"
    );
    for (i, &count) in bins.iter().enumerate() {
        let height = 95.0 * f64::from(count) / max;
        let from = low + step * i as f64;
        let _ = writeln!(
            out,
            "<rect x=\"{}\" y=\"{:.2}\" width=\"5\" height=\"{height:.2}\" fill=\"#4e79a7\"><title>{from:.3} to {:.3}: {count}</title></rect>",
            10 + 6 * i,
            118.0 - height,
            from + step
        );
    }
    let _ = writeln!(
        out,
        "<text x=\"10\" y=\"133\">{}</text><text x=\"250\" y=\"133\" text-anchor=\"end\">{}</text></svg>",
        short(low),
        short(high)
    );
}

fn short(value: f64) -> String {
    if value.fract() == 0.0 { format!("{value}") } else { format!("{value:.2}") }
}

pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

pub fn shown(stage: &str) -> &str {
    if stage.is_empty() { "read-back" } else { stage }
}
