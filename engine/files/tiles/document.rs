//! `tileset.json` of 3D Tiles 1.1 (OGC 22-025r4).
//!
//! Tiles are z-up. Viewers turn the y-up glTF of a tile so: (x, y, z) of glTF is (x, -z, y) of a tile. glTF's x and y are those of
//! this crate's frame the other way round.

use std::path::Path;

use glam::{DVec3, Vec3, dvec3, vec3};
use serde_json::{Value, json};

use crate::atomic;
use crate::splats::{EXTENSION, PACKED_EXTENSION};
use ashsplat::Result;
use ashsplat::scene::Bounds;

/// One tile, with those below it.
pub(super) struct Tile {
    /// What it and the tiles below it reach, in this crate's frame.
    pub(super) bounds: Bounds,
    /// Geometric error, world units: 0 for the scene's own Gaussians.
    pub(super) error: f64,
    /// Tiles from here to the finest, one below another.
    pub(super) levels: usize,
    /// Its description.
    json: Value,
}

impl Tile {
    /// The tile of a file, with so many Gaussians, above others.
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

/// A point of this crate's frame in that of tiles, and the other way.
pub(super) fn turned(point: Vec3) -> Vec3 {
    vec3(-point.x, -point.z, -point.y)
}

/// Same as [`turned`], in double precision.
pub(super) fn turned_origin(point: DVec3) -> DVec3 {
    dvec3(-point.x, -point.z, -point.y)
}

/// Centre and half axes.
fn box_of(bounds: Bounds) -> [f64; 12] {
    let [a, b] = [bounds.min, bounds.max].map(|corner| turned(corner).as_dvec3());
    let (centre, half) = (0.5 * (a + b), 0.5 * (a - b).abs());
    [centre.x, centre.y, centre.z, half.x, 0.0, 0.0, 0.0, half.y, 0.0, 0.0, 0.0, half.z]
}

/// Writes the description of a tree, whose tiles are relative to an origin.
pub(super) fn write(path: &Path, root: &Tile, origin: DVec3, packed: bool) -> Result<()> {
    // Of drawing nothing at all.
    let nothing = root.bounds.max.as_dvec3().distance(root.bounds.min.as_dvec3()).max(root.error);
    // Viewers look here before the first tile is there.
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
