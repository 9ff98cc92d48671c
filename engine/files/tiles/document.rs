//! `tileset.json` of 3D Tiles 1.1 (OGC 22-025r4).
//!
//! Tiles are z-up. Viewers rotate the y-up glTF of a tile: (x, y, z) of glTF is (x, -z, y) of a tile. glTF's x and y
//! are opposite to those of this crate's frame.

use std::path::Path;

use glam::{DVec3, Vec3, dvec3, vec3};
use serde_json::{Value, json};

use crate::atomic;
use crate::splats::{EXTENSION, PACKED_EXTENSION};
use ashsplat::Result;
use ashsplat::scene::Bounds;

/// A tile with its children.
pub(super) struct Tile {
    /// Reach of the tile and its children, in this crate's frame.
    pub(super) bounds: Bounds,
    /// Geometric error, world units: 0 for the scene's own Gaussians.
    pub(super) error: f64,
    /// Number of levels from this tile to the finest.
    pub(super) levels: usize,
    /// The tile's JSON.
    json: Value,
}

impl Tile {
    /// The tile of the file `name`, with its children.
    pub(super) fn new(
        name: &str,
        gaussians: usize,
        (bounds, error): (Bounds, f64),
        children: Vec<Tile>,
    ) -> Tile {
        let mut json = json!({
            "boundingVolume": { "box": box_of(bounds) },
            "geometricError": error,
            "refine": "REPLACE",
            "content": { "uri": name },
            "extras": { "gaussians": gaussians },
        });
        let levels = 1 + children.iter().map(|tile| tile.levels).max().unwrap_or(0);
        if !children.is_empty() {
            json["children"] = children.into_iter().map(|tile| tile.json).collect();
        }
        Tile { bounds, error, levels, json }
    }
}

/// Converts a point from this crate's frame to that of tiles, and back.
pub(super) fn turned(point: Vec3) -> Vec3 {
    vec3(-point.x, -point.z, -point.y)
}

/// Same as [`turned`], in double precision.
pub(super) fn turned_origin(point: DVec3) -> DVec3 {
    dvec3(-point.x, -point.z, -point.y)
}

/// Centre and half axes of a box.
fn box_of(bounds: Bounds) -> [f64; 12] {
    let [a, b] = [bounds.min, bounds.max].map(|corner| turned(corner).as_dvec3());
    let (centre, half) = (0.5 * (a + b), 0.5 * (a - b).abs());
    [centre.x, centre.y, centre.z, half.x, 0.0, 0.0, 0.0, half.y, 0.0, 0.0, 0.0, half.z]
}

/// Writes the description of a tree whose tiles are relative to an origin.
pub(super) fn write(path: &Path, root: &Tile, origin: DVec3, packed: bool) -> Result<()> {
    // Error of drawing nothing at all.
    let nothing = root.bounds.max.as_dvec3().distance(root.bounds.min.as_dvec3()).max(root.error);
    // Viewers look here before they load the first tile.
    let mut used = json!({ "extensionsUsed": [EXTENSION] });
    if packed {
        let both = json!([EXTENSION, PACKED_EXTENSION]);
        used = json!({ "extensionsUsed": both, "extensionsRequired": both });
    }
    let mut document = json!({
        "asset": { "version": "1.1", "generator": concat!("ashsplat ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": { "3DTILES_content_gltf": used },
        "geometricError": nothing,
        "root": root.json,
    });
    if origin != DVec3::ZERO {
        let DVec3 { x, y, z } = turned_origin(origin);
        let columns = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0];
        document["root"]["transform"] = json!(columns);
    }
    atomic::write(path, |writer| writer.write_all(format!("{document:#}\n").as_bytes()))
}
