//! Learned exposures and lens effects of the photographs.

use ashsplat::scene::{Exposure, LensEffects};
use ashsplat_program::appearance::Appearances;
use ashsplat_program::html::{self, Cell, section};

/// A grey that no usual gain saturates.
const GRAY: f32 = 0.5;
/// Squared distance of a picture's corner from its middle.
const CORNER: f32 = 1.0;

/// Writes sections of exposures and lens effects, if they were learned.
pub fn sections(out: &mut String, appearances: &Appearances) {
    if !appearances.exposures.is_empty() {
        let note = "factors of a middle gray, from the darkest photograph to the brightest; the mean of all \
                    exposures is none. exposure.json has the matrices";
        section(out, "Exposures", note);
        exposures(out, appearances);
    }
    if !appearances.lenses.cameras.is_empty() {
        let note = "brightness of the corners as a share of the middle's, and exponents of the response; 1: no effect. \
                    lens.json has all numbers";
        section(out, "Lens effects", note);
        lenses(out, appearances);
    }
}

/// Effect of an exposure on a middle grey, as factors of the channels.
fn gains(exposure: &Exposure) -> [f32; 3] {
    exposure.of([GRAY; 3]).map(|c| c / GRAY)
}

fn exposures(out: &mut String, appearances: &Appearances) {
    let mut all: Vec<(&str, [f32; 3])> =
        appearances.exposures.iter().map(|(name, exposure)| (name.as_str(), gains(exposure))).collect();
    let mean = |gains: &[f32; 3]| gains.iter().sum::<f32>() / 3.0;
    all.sort_by(|(_, a), (_, b)| mean(a).total_cmp(&mean(b)));
    let max = all.iter().map(|(_, gains)| mean(gains)).fold(1.0, f32::max);
    let row = |(name, gains): &(&str, [f32; 3])| {
        let mean = mean(gains);
        let mut cells = vec![Cell::Name((*name).to_owned())];
        cells.extend(numbers(gains).chain(numbers(&[mean])));
        cells.push(Cell::Bar((mean / max).max(0.0).into()));
        cells
    };
    let rows: Vec<Vec<Cell>> = all.iter().map(row).collect();
    out.push_str(&html::table(&["photo", "red", "green", "blue", "mean", ""], &rows, None));
}

fn lenses(out: &mut String, appearances: &Appearances) {
    let row = |(camera, effects): (&u32, &LensEffects)| {
        let photos = appearances.lenses.photos.values().filter(|taker| *taker == camera).count();
        let mut cells = vec![Cell::Name(camera.to_string()), Cell::Number(photos.to_string())];
        cells.extend(numbers(&corner(effects)).chain(numbers(&effects.response())));
        cells
    };
    let rows: Vec<Vec<Cell>> = appearances.lenses.cameras.iter().map(row).collect();
    let heads = ["camera", "photos", "corner red", "green", "blue", "response red", "green", "blue"];
    out.push_str(&html::table(&heads, &rows, None));
}

fn corner(effects: &LensEffects) -> [f32; 3] {
    [0, 1, 2].map(|channel| effects.vignetting(channel, CORNER))
}

fn numbers(values: &[f32]) -> impl Iterator<Item = Cell> {
    values.iter().map(|&value| Cell::number(f64::from(value), 3))
}
