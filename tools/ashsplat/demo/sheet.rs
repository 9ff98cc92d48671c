//! The contact sheet: one row per held-out view, photo | render | difference, with captions.

use ashsplat_files::Photo;
use font8x8::{BASIC_FONTS, UnicodeFonts};

/// Differences are shown this many times brighter.
pub const DIFFERENCE_GAIN: u32 = 4;

/// Width of the margins around the pictures, pixels.
const MARGIN: u32 = 8;
/// Height of a caption strip above a picture, pixels.
const CAPTION: u32 = 14;
const PAPER: [u8; 3] = [24, 24, 28];
const INK: [u8; 3] = [225, 225, 225];

pub struct Row {
    pub photo: std::sync::Arc<Photo>,
    pub render: Photo,
    pub psnr: f64,
    pub ssim: f64,
}

/// Lays out the rows. Pictures of a row share a size; rows may differ.
pub fn contact_sheet(rows: &[Row]) -> Photo {
    let width = rows.iter().map(|r| 3 * r.photo.width + 4 * MARGIN).max().unwrap_or(MARGIN);
    let height = rows.iter().map(|r| r.photo.height + CAPTION + MARGIN).sum::<u32>() + MARGIN;
    let rgb = PAPER.repeat(width as usize * height as usize);
    let mut sheet = Photo { width, height, rgb };
    let mut top = MARGIN;
    for row in rows {
        let captions = [
            "PHOTO".to_owned(),
            format!("RENDER {:.2} DB  SSIM {:.3}", row.psnr, row.ssim),
            format!("DIFFERENCE X{DIFFERENCE_GAIN}"),
        ];
        let pictures = [&*row.photo, &row.render, &difference(&row.photo, &row.render)];
        for (column, (picture, caption)) in pictures.into_iter().zip(&captions).enumerate() {
            let left = MARGIN + column as u32 * (row.photo.width + MARGIN);
            write_text(&mut sheet, left, top, caption);
            paste(&mut sheet, picture, left, top + CAPTION);
        }
        top += row.photo.height + CAPTION + MARGIN;
    }
    sheet
}

/// `|a − b|` per channel, brightened; pictures of equal size.
fn difference(a: &Photo, b: &Photo) -> Photo {
    let brighten = |d: u8| (u32::from(d) * DIFFERENCE_GAIN).min(255) as u8;
    let rgb = a.rgb.iter().zip(&b.rgb).map(|(&a, &b)| brighten(a.abs_diff(b))).collect();
    Photo { width: a.width, height: a.height, rgb }
}

fn paste(sheet: &mut Photo, picture: &Photo, left: u32, top: u32) {
    let row_bytes = picture.width as usize * 3;
    for (y, row) in picture.rgb.chunks_exact(row_bytes).enumerate() {
        let start = ((top as usize + y) * sheet.width as usize + left as usize) * 3;
        sheet.rgb[start..start + row_bytes].copy_from_slice(row);
    }
}

fn write_text(sheet: &mut Photo, left: u32, top: u32, text: &str) {
    for (left, character) in (left..).step_by(8).zip(text.chars()) {
        let rows = BASIC_FONTS.get(character).unwrap_or_default();
        for (y, row) in (top..).zip(rows) {
            for x in (0..8).filter(|x| row >> x & 1 == 1).map(|x| left + x).filter(|x| *x < sheet.width) {
                let at = (y as usize * sheet.width as usize + x as usize) * 3;
                sheet.rgb[at..at + 3].copy_from_slice(&INK);
            }
        }
    }
}
