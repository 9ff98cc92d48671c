//! Heat maps of the tiles, and histograms.

use crate::bench::plot::escape;
use ashsplat::io::Photo;
use ashsplat::{Error, Frame, Gaussians, Result, TileReport};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use std::fmt::Write;

/// The frame, and how full its tiles are.
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

/// Dark blue, purple, orange, light yellow: rises in brightness, so it reads in grey too.
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

fn figure(out: &mut String, caption: &str, (width, height): (u32, u32), rgb: &[u8]) -> Result<()> {
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(rgb, width, height, ExtendedColorType::Rgb8)
        .map_err(|e| Error::argument("picture of the profile", format!("cannot be encoded: {e}")))?;
    let (data, caption) = (base64(&png), escape(caption));
    let _ = writeln!(
        out,
        "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption></figure>"
    );
    Ok(())
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |i: usize| u32::from(chunk.get(i).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for i in 0..4 {
            let letter = LETTERS[(word >> (18 - 6 * i) & 63) as usize];
            out.push(if i <= chunk.len() { char::from(letter) } else { '=' });
        }
    }
    out
}

/// Entries and blended per tile, opacities and sizes of the Gaussians.
pub fn histograms(tiles: &TileReport, gaussians: &Gaussians) -> String {
    let counts = |values: &[u32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let opacities = gaussians.opacity_logits.iter().map(|&o| 1.0 / (1.0 + (-f64::from(o)).exp())).collect();
    let largest =
        gaussians.log_scales.iter().map(|s| f64::from(s[0].max(s[1]).max(s[2])) / std::f64::consts::LN_10);
    let charts = [
        ("entries of a tile", counts(&tiles.entries)),
        ("blended of a tile", counts(&tiles.blended)),
        ("opacity of a Gaussian", opacities),
        ("log10 of its largest σ", largest.collect()),
    ];
    let mut out = String::from("<div class=\"row\">");
    for (name, values) in charts {
        histogram(&mut out, name, &values);
    }
    out.push_str("</div>\n");
    out
}

const BINS: usize = 40;

fn histogram(out: &mut String, name: &str, values: &[f64]) {
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
    let most = f64::from(bins.iter().copied().max().unwrap_or(1).max(1));
    let _ = writeln!(
        out,
        "<svg width=\"262\" height=\"140\"><text x=\"131\" y=\"12\" text-anchor=\"middle\">{name}</text>"
    );
    for (i, &count) in bins.iter().enumerate() {
        let height = 95.0 * f64::from(count) / most;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_in_the_standard() {
        // RFC 4648, section 10.
        let cases = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("foobar", "Zm9vYmFy"),
        ];
        for (plain, coded) in cases {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn heat_rises_in_brightness() {
        let brightness = |i: u32| heat(f64::from(i) / 20.0).iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!((0..20).all(|i| brightness(i) < brightness(i + 1)));
    }
}
