//! Heat maps of the tiles, and histograms.

use ashsplat::{Frame, Gaussians, Result, TileReport};
use ashsplat_files::Photo;
use ashsplat_program::html::{self, escape, heat};
use std::fmt::Write;

/// The frame, and heat maps of its tiles.
pub fn pictures(frame: &Frame, tiles: &TileReport) -> Result<String> {
    let photo = Photo::from_f32(frame.width, frame.height, &frame.color)?;
    let most = tiles.entries.iter().copied().max().unwrap_or(0).max(1);
    let mut out = String::from("<div class=\"row\">");
    figure(&mut out, "the picture", (photo.width, photo.height), &photo.rgb)?;
    let maps = [("entries of each tile", &tiles.entries), ("blended of each tile", &tiles.blended)];
    for (name, values) in maps {
        let rgb: Vec<u8> =
            values.iter().flat_map(|&value| heat(f64::from(value) / f64::from(most))).collect();
        let largest = values.iter().copied().max().unwrap_or(0);
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64;
        let text = format!("{name}: {mean:.0} on average, {largest} at most");
        figure(&mut out, &text, (tiles.columns, tiles.rows), &rgb)?;
    }
    out.push_str("</div>\n<p class=\"note\">");
    for i in 0..=4u32 {
        let [r, g, b] = heat(f64::from(i) / 4.0);
        let value = most * i / 4;
        let _ =
            write!(out, "<span class=\"key\"><i style=\"background:rgb({r},{g},{b})\"></i>{value}</span>");
    }
    out.push_str("</p>\n");
    Ok(out)
}

fn figure(out: &mut String, caption: &str, (width, height): (u32, u32), rgb: &[u8]) -> Result<()> {
    let (address, caption) = (html::png(width, height, rgb)?, escape(caption));
    let _ = writeln!(
        out,
        "<figure><img alt=\"{caption}\" src=\"{address}\"><figcaption>{caption}</figcaption></figure>"
    );
    Ok(())
}

/// Histograms of entries and blended Gaussians per tile, and of the Gaussians' opacities and sizes.
pub fn histograms(tiles: &TileReport, gaussians: &Gaussians) -> String {
    let counts = |values: &[u32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let opacities = gaussians.opacity_logits.iter().map(|&o| 1.0 / (1.0 + (-f64::from(o)).exp())).collect();
    let largest =
        gaussians.log_scales.iter().map(|s| f64::from(s[0].max(s[1]).max(s[2])) / std::f64::consts::LN_10);
    let charts = [
        ("entries of a tile", counts(&tiles.entries)),
        ("blended of a tile", counts(&tiles.blended)),
        ("opacity of a Gaussian", opacities),
        ("log10 of its largest σ, world units", largest.collect()),
    ];
    let mut out = String::from("<div class=\"row\">");
    for (name, values) in charts {
        html::histogram(&mut out, name, &values);
    }
    out.push_str("</div>\n");
    out
}
