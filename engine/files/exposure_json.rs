//! `exposure.json`, the exposures of the photographs that the reference implementation writes next to a model: an
//! object from each photograph's name to three rows of four numbers.

use std::collections::BTreeMap;
use std::path::Path;

use super::{atomic, text};
use ashsplat::scene::Exposure;
use ashsplat::{Error, Result};

/// Name of the file in a model folder.
pub const EXPOSURE_FILE: &str = "exposure.json";

/// Writes exposures by the names of their photographs.
pub fn write<'a>(
    path: impl AsRef<Path>,
    exposures: impl IntoIterator<Item = (&'a str, &'a Exposure)>,
) -> Result<()> {
    let rows: BTreeMap<&str, [[f32; 4]; 3]> =
        exposures.into_iter().map(|(name, exposure)| (name, exposure.rows)).collect();
    atomic::write(path, |writer| Ok(serde_json::to_writer_pretty(writer, &rows)?))
}

/// Reads the exposures of [`write()`] or of the reference implementation.
pub fn read(path: impl AsRef<Path>) -> Result<BTreeMap<String, Exposure>> {
    let path = path.as_ref();
    let remedy = "expected {\"photo.jpg\": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], …}";
    let rows: BTreeMap<String, [[f32; 4]; 3]> = text::json(path, "a list of exposures", remedy)?;
    let is_finite = |rows: &[[f32; 4]; 3]| rows.as_flattened().iter().all(|x| x.is_finite());
    if let Some((name, _)) = rows.iter().find(|(_, rows)| !is_finite(rows)) {
        return Err(Error::input(path, format!("{name} has a number that is not finite"), remedy));
    }
    Ok(rows.into_iter().map(|(name, rows)| (name, Exposure { rows })).collect())
}
