//! The contact sheet: one row per held-out view, photo | render | difference, with captions.

use ashsplat_files::Photo;

/// Differences are shown this many times brighter.
pub const DIFFERENCE_GAIN: u32 = 4;

/// Width of the margins around the pictures, pixels.
const MARGIN: u32 = 8;
/// Height of a caption strip above a picture, pixels.
const CAPTION: u32 = 14;
const PAPER: [u8; 3] = [24, 24, 28];
const INK: [u8; 3] = [225, 225, 225];

/// One held-out view.
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

/// Writes capitals, digits and points in a 3×5 font at twice its size; other characters are blank.
fn write_text(sheet: &mut Photo, left: u32, top: u32, text: &str) {
    for (index, character) in text.chars().enumerate() {
        let bits = glyph(character);
        for y in 0..10 {
            for x in 0..6 {
                if bits >> (14 - (y / 2 * 3 + x / 2)) & 1 == 1 {
                    put(sheet, left + index as u32 * 8 + x, top + y);
                }
            }
        }
    }
}

fn put(sheet: &mut Photo, x: u32, y: u32) {
    if x < sheet.width && y < sheet.height {
        let at = (y as usize * sheet.width as usize + x as usize) * 3;
        sheet.rgb[at..at + 3].copy_from_slice(&INK);
    }
}

/// Five rows of three bits, the top left one highest.
fn glyph(character: char) -> u16 {
    match character {
        '0' => 0b111_101_101_101_111,
        '1' => 0b010_110_010_010_111,
        '2' => 0b111_001_111_100_111,
        '3' => 0b111_001_111_001_111,
        '4' => 0b101_101_111_001_001,
        '5' => 0b111_100_111_001_111,
        '6' => 0b111_100_111_101_111,
        '7' => 0b111_001_010_010_010,
        '8' => 0b111_101_111_101_111,
        '9' => 0b111_101_111_001_111,
        'B' => 0b110_101_110_101_110,
        'C' => 0b011_100_100_100_011,
        'D' => 0b110_101_101_101_110,
        'E' => 0b111_100_110_100_111,
        'F' => 0b111_100_110_100_100,
        'H' => 0b101_101_111_101_101,
        'I' => 0b111_010_010_010_111,
        'M' => 0b101_111_111_101_101,
        'N' => 0b110_101_101_101_101,
        'O' => 0b010_101_101_101_010,
        'P' => 0b110_101_110_100_100,
        'R' => 0b110_101_110_101_101,
        'S' => 0b011_100_010_001_110,
        'T' => 0b111_010_010_010_010,
        'X' => 0b101_101_010_101_101,
        '.' => 0b000_000_000_000_010,
        _ => 0,
    }
}
