//! Views beside their photos, with their quality.

use ashsplat::{Frame, Result};
use ashsplat_files::{Photo, View};
use ashsplat_program::eval::{Evaluation, ViewResult};
use ashsplat_program::html::{self, Cell, escape, heat};
use ashsplat_program::output;
use std::fmt::Write;

/// Largest number of views on the contact sheet.
pub const SHOWN: usize = 12;
/// Width to which pictures are scaled down, pixels.
const WIDTH: u32 = 480;
/// Absolute difference, mean over the channels, with the brightest colour.
const BRIGHTEST: f64 = 0.25;

pub fn worst_first(views: &[ViewResult]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..views.len()).collect();
    order.sort_by(|&a, &b| views[a].psnr.total_cmp(&views[b].psnr));
    order
}

pub fn row(out: &mut String, view: &View, frame: &Frame, result: &ViewResult) -> Result<()> {
    let (photo, mask) = (view.photo.photo()?, view.photo.mask()?);
    let counts = |i: usize| mask.as_ref().is_none_or(|mask| mask[i] != 0);
    let mut shown = Photo::clone(&photo);
    for (i, rgb) in shown.rgb.as_chunks_mut::<3>().0.iter_mut().enumerate().filter(|(i, _)| !counts(*i)) {
        // Masked pixels are dimmed and striped.
        let stripe = (i % photo.width as usize + i / photo.width as usize) / 6;
        *rgb = rgb.map(|c| c / 4 + if stripe.is_multiple_of(2) { 24 } else { 0 });
    }
    let error = error(frame, &photo.to_f32(), counts);
    let pictures = [shown, output::to_photo(frame)?, error];
    let _ = write!(
        out,
        "<div class=\"view\"><p><b>{}</b> {:.2} dB, SSIM {:.4}</p>",
        escape(&result.name),
        result.psnr,
        result.ssim
    );
    for (picture, name) in pictures.into_iter().zip(["photo", "render", "error"]) {
        let address = html::jpeg(&output::narrowed(picture, WIDTH)?)?;
        let _ = write!(
            out,
            "<img alt=\"{name} of {}\" title=\"{name}\" src=\"{address}\">",
            escape(&result.name)
        );
    }
    out.push_str("</div>\n");
    Ok(())
}

fn error(frame: &Frame, photo: &[[f32; 3]], counts: impl Fn(usize) -> bool) -> Photo {
    let difference = |(i, (a, b)): (usize, (&[f32; 3], &[f32; 3]))| {
        let sum: f32 = a.iter().zip(b).map(|(a, b)| (a.clamp(0.0, 1.0) - b).abs()).sum();
        heat(if counts(i) { f64::from(sum) / 3.0 / BRIGHTEST } else { 0.0 })
    };
    let rgb = frame.color.iter().zip(photo).enumerate().flat_map(difference).collect();
    Photo { width: frame.width, height: frame.height, rgb }
}

pub fn key() -> String {
    let colors: Vec<String> = (0..=4)
        .map(|i| {
            let [r, g, b] = heat(f64::from(i) / 4.0);
            format!("rgb({r},{g},{b})")
        })
        .collect();
    format!(
        "<p class=\"note\">error: mean absolute difference of the channels, 0 <i class=\"scale\" style=\"background:linear-gradient(90deg,{})\"></i> {BRIGHTEST} and more</p>\n",
        colors.join(",")
    )
}

pub fn table(evaluation: &Evaluation) -> String {
    let best = evaluation.views.iter().map(|v| v.psnr).filter(|p| p.is_finite()).fold(1.0, f64::max);
    let row = |(rank, place): (usize, usize)| {
        let view = &evaluation.views[place];
        let mut cells = vec![
            Cell::Number((rank + 1).to_string()),
            Cell::Name(view.name.clone()),
            Cell::number(view.psnr, 2),
            Cell::Bar(view.psnr.clamp(0.0, best) / best),
        ];
        cells.extend([view.ssim].iter().chain(&view.lpips).map(|&value| Cell::number(value, 4)));
        cells
    };
    let rows: Vec<Vec<Cell>> = worst_first(&evaluation.views).into_iter().enumerate().map(row).collect();
    let mean = (!rows.is_empty()).then(|| {
        let none = || Cell::Number(String::new());
        let mut cells = vec![none(), Cell::Name("mean".into()), Cell::number(evaluation.psnr(), 2), none()];
        let lpips = evaluation.lpips().map(|(_, value)| value);
        cells.extend(std::iter::once(evaluation.ssim()).chain(lpips).map(|value| Cell::number(value, 4)));
        cells
    });
    let heads = [&["#", "view", "PSNR", "", "SSIM"], &evaluation.measures[..]].concat();
    html::table(&heads, &rows, mean)
}
