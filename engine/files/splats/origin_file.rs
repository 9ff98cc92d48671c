//! `NAME.origin.json`, the origin of the positions of a file `NAME` whose format has no field for it.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{atomic, regular_file};
use ashsplat::{Error, Result};

/// Farthest origin, source units: the square of a coordinate must not overflow in single precision.
pub(crate) const FARTHEST: f64 = 1e18;

/// Largest such file, bytes.
const MOST_BYTES: u64 = 4096;

#[derive(Serialize, Deserialize)]
struct OriginJson {
    origin: [f64; 3],
}

/// Path of the file with the origin.
pub(super) fn path_of(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".origin.json");
    path.with_file_name(name)
}

/// Reads the origin of a file's positions; zero without such a file.
pub(super) fn read(path: &Path) -> Result<DVec3> {
    let path = path_of(path);
    if !path.is_file() {
        return Ok(DVec3::ZERO);
    }
    let text = regular_file::read_at_most(&path, MOST_BYTES)?.unwrap_or_default();
    let json = serde_json::from_slice::<OriginJson>(&text).map_err(|e| e.to_string());
    let origin = json.and_then(|json| match DVec3::from_array(json.origin) {
        origin if origin.abs().max_element() <= FARTHEST => Ok(origin),
        _ => Err(format!("it may be up to {FARTHEST:e}")),
    });
    origin.map_err(|problem| {
        let remedy = "expected {\"origin\": [x, y, z]}; remove the file if positions are absolute";
        Error::input(&path, format!("is no origin: {problem}"), remedy)
    })
}

/// Writes the origin of a newly written file. A zero origin removes an earlier origin file.
pub(super) fn write(path: &Path, origin: DVec3) -> Result<()> {
    let beside = path_of(path);
    if origin == DVec3::ZERO {
        return match fs::remove_file(&beside) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::io(&beside, "remove", e)),
            _ => Ok(()),
        };
    }
    let json = OriginJson { origin: origin.to_array() };
    let written = atomic::write(&beside, |writer| Ok(serde_json::to_writer(writer, &json)?));
    // Positions without their origin would be silently wrong, so the scene is removed too.
    written.inspect_err(|_| drop(fs::remove_file(path)))
}
