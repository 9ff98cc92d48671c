//! Lines of text as a picture to blend over another: letters of 8 by 8 dots on a dark ground.

use font8x8::{BASIC_FONTS, GREEK_FONTS, LATIN_FONTS, UnicodeFonts};

/// Width and height of a letter, dots.
const LETTER: u32 = 8;
/// Distance between lines, and margin around all lines, dots.
const LINE: u32 = 11;
const MARGIN: u32 = 5;
/// Premultiplied colour, and transmittance.
const GROUND: [f32; 4] = [0.02, 0.025, 0.035, 0.42];
const LETTERS: [f32; 4] = [0.93, 0.95, 0.97, 0.0];
/// Replacements of letters that the font lacks.
const SIMILAR: [(char, char); 4] = [('−', '-'), ('…', '-'), ('–', '-'), ('’', '\'')];

/// A picture of text. Texels are those of the engine's frames: premultiplied colour and transmittance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Text {
    pub width: u32,
    pub height: u32,
    pub texels: Vec<[f32; 4]>,
}

/// Text or a picture over the frame, with its corner, pixels.
pub struct Overlay<'a> {
    pub picture: &'a Text,
    pub corner: [u32; 2],
}

fn dots(letter: char) -> [u8; 8] {
    let similar = SIMILAR.iter().find(|(odd, _)| *odd == letter).map_or(letter, |(_, plain)| *plain);
    let found = BASIC_FONTS.get(similar).or_else(|| LATIN_FONTS.get(similar));
    found.or_else(|| GREEK_FONTS.get(similar)).or_else(|| BASIC_FONTS.get('?')).unwrap_or_default()
}

/// Draws lines of text, `scale` pixels per dot, and cuts off what exceeds `max` pixels.
pub fn text(lines: &[String], scale: u32, max: [u32; 2]) -> Text {
    let columns = lines.iter().map(|line| line.chars().count() as u32).max().unwrap_or(0);
    if columns == 0 {
        return Text::default();
    }
    let width = (columns.saturating_mul(LETTER) + 2 * MARGIN).saturating_mul(scale).min(max[0]);
    let height = ((lines.len() as u32).saturating_mul(LINE) + 2 * MARGIN).saturating_mul(scale).min(max[1]);
    let mut texels = vec![GROUND; width as usize * height as usize];
    for (row, line) in (0..).zip(lines) {
        for (column, letter) in (0..).zip(line.chars()) {
            let corner = [MARGIN + column * LETTER, MARGIN + row * LINE];
            for (y, bits) in (0..).zip(dots(letter)) {
                for x in (0..LETTER).filter(|x| bits >> x & 1 == 1) {
                    let [left, top] = [(corner[0] + x) * scale, (corner[1] + y) * scale];
                    for y in top.min(height)..(top + scale).min(height) {
                        let at = (y * width) as usize;
                        let [from, to] = [left.min(width), (left + scale).min(width)];
                        texels[at + from as usize..at + to as usize].fill(LETTERS);
                    }
                }
            }
        }
    }
    Text { width, height, texels }
}
