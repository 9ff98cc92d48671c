//! Which blocks of voxels lie near a surface.

use super::pinholes::PinholeView;
use crate::error::{Error, Result};
use crate::kernels::constants::{FIELD_SIDE, FIELD_VOXELS, NO_BLOCK};
use crate::render::Surface;
use crate::scene::{Camera, NEAR_PLANE};
use crate::vk::Context;
use glam::{DVec3, Vec3};
use std::collections::HashSet;

/// Resolution and reach of a distance field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldSettings {
    /// Distance between voxels, world units; positive.
    pub voxel: f32,
    /// Largest distance that is stored, and depth behind a surface up to which it counts, world units.
    pub truncation: f32,
    /// Depths beyond this one do not count, world units.
    pub max_depth: f32,
    /// Number of views that must have seen a voxel, at least 1; one that fewer have seen counts as unseen.
    pub least_views: u32,
}

impl FieldSettings {
    /// A field of these voxels and depths, with a truncation of six voxels. Every voxel that some view has seen counts.
    pub fn new(voxel: f32, max_depth: f32) -> Self {
        Self { voxel, truncation: 6.0 * voxel, max_depth, least_views: 1 }
    }
}

/// Distance from a surface up to which a field has voxels, in voxels. A cube at the surface has its corners within √3.
const MARGIN: f32 = 2.0;
/// Largest coordinate of a block.
const FARTHEST: f32 = 1_048_576.0;
/// Bytes of a voxel on the device: distance, weight and views, colour, count, and places of its vertices and of its triangles.
const VOXEL_BYTES: u64 = 8 + 8 + 3 * 4;

/// Blocks of 8³ voxels near the surfaces of some views.
pub struct FieldBlocks {
    pub(super) settings: FieldSettings,
    found: HashSet<[i32; 3]>,
    /// Most bytes of the field, and of its largest buffer, each with its name.
    limits: [(u64, &'static str); 2],
}

impl FieldBlocks {
    /// No blocks yet, of a field on this device. Refuses settings that are not positive and finite.
    pub fn new(context: &Context, settings: FieldSettings) -> Result<Self> {
        let FieldSettings { voxel, truncation, max_depth, .. } = settings;
        for (name, value) in [("voxel", voxel), ("truncation", truncation), ("max_depth", max_depth)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::argument(name, format!("is {value}, must be positive and finite")));
            }
        }
        let whole = context.memory_limit().unwrap_or((u64::MAX, "memory"));
        let range = (context.limits().max_storage_buffer_range, "maxStorageBufferRange");
        Ok(Self { settings, found: HashSet::new(), limits: [whole, range] })
    }

    /// Adds the blocks near the surface that a view shows where its pixels count.
    ///
    /// # Errors
    /// [`Error::Argument`] for a surface or counts of another size than the camera's, a camera that is no pinhole, or voxels that are too
    /// small for the distance from the origin; [`Error::TooLarge`] if the device cannot hold the field, besides frames and the mesh.
    pub fn add(&mut self, view: &PinholeView, surface: &Surface) -> Result<()> {
        check_view(view)?;
        let camera = &view.camera;
        let [width, height] = [camera.width, camera.height];
        if surface.depth.len() as u64 != u64::from(width) * u64::from(height) {
            return Err(Error::argument("surface", format!("has not {width}x{height} pixels")));
        }
        let (points, mut last) = (camera.points(), None);
        let block = self.settings.voxel * FIELD_SIDE as f32;
        let margin = Vec3::splat(MARGIN / FIELD_SIDE as f32);
        for (index, &depth) in surface.depth.iter().enumerate() {
            let counts = view.counts.as_ref().is_none_or(|counts| counts[index]);
            if !(counts && depth > 0.0 && depth < self.settings.max_depth) {
                continue;
            }
            let pixel = [index as u32 % width, index as u32 / width].map(|at| at as f32 + 0.5);
            let at = points(pixel, depth) / block;
            if !at.abs().cmplt(Vec3::splat(FARTHEST)).all() {
                let problem =
                    format!("is {}, too small for surfaces so far from the origin", self.settings.voxel);
                return Err(Error::argument("voxel", problem));
            }
            let range =
                [at - margin, at + margin].map(|corner| corner.to_array().map(|at| at.floor() as i32));
            // Neighbouring pixels mostly show the same blocks.
            if last.replace(range) != Some(range) {
                let [low, high] = range;
                for (z, y) in (low[2]..=high[2]).flat_map(|z| (low[1]..=high[1]).map(move |y| (z, y))) {
                    self.found.extend((low[0]..=high[0]).map(|x| [x, y, z]));
                }
                self.check()?;
            }
        }
        Ok(())
    }

    /// Returns the number of blocks.
    pub fn len(&self) -> usize {
        self.found.len()
    }

    /// True if no view has shown a surface.
    pub fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    fn check(&self) -> Result<()> {
        let voxels = self.len() as u64 * u64::from(FIELD_VOXELS);
        let needed = [voxels * VOXEL_BYTES, voxels * 8];
        match needed.into_iter().zip(self.limits).find(|(needed, (limit, _))| needed > limit) {
            Some((needed, limit)) => Err(Error::too_large("a distance field", (needed, "bytes"), limit)),
            None => Ok(()),
        }
    }

    /// Returns the blocks in order, and the neighbours of each as in field.glsl.
    pub(super) fn sorted(&self) -> (Vec<[i32; 3]>, Vec<[u32; 8]>) {
        let mut blocks: Vec<[i32; 3]> = self.found.iter().copied().collect();
        blocks.sort_unstable();
        let beside = |&[x, y, z]: &[i32; 3], corner: i32| {
            let other = [x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2)];
            blocks.binary_search(&other).map_or(NO_BLOCK, |at| at as u32)
        };
        let neighbours =
            blocks.iter().map(|block| std::array::from_fn(|corner| beside(block, corner as i32)));
        let neighbours = neighbours.collect();
        (blocks, neighbours)
    }
}

/// Refuses views of which depth maps are not fused.
pub(super) fn check_view(PinholeView { camera, counts }: &PinholeView) -> Result<()> {
    let [width, height] = [camera.width, camera.height];
    if !camera.is_pinhole() {
        return Err(Error::argument("camera", "is no pinhole, and only depths of pinholes are fused"));
    }
    match counts.as_ref().is_none_or(|counts| counts.len() as u64 == u64::from(width) * u64::from(height)) {
        true => Ok(()),
        false => Err(Error::argument("counts", format!("has not {width}x{height} pixels"))),
    }
}

/// Returns place and index of each block whose bounding sphere meets the pinhole's frustum, which ends a truncation behind the largest
/// depth. The view changes no voxel of other blocks: the margins of both exceed the device's rounding.
pub(super) fn visible_blocks(
    places: &[[i32; 3]],
    settings: &FieldSettings,
    camera: &Camera,
) -> Vec<[i32; 4]> {
    let FieldSettings { voxel, truncation, max_depth, .. } = *settings;
    let [voxel, farthest] = [voxel, max_depth + truncation].map(f64::from);
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::from);
    let [width, height] = [camera.width, camera.height].map(f64::from);
    // The sides lie a pixel outside the picture.
    let planes = [
        (DVec3::new(fx, 0.0, cx + 1.0).normalize(), 0.0),
        (DVec3::new(-fx, 0.0, width + 1.0 - cx).normalize(), 0.0),
        (DVec3::new(0.0, fy, cy + 1.0).normalize(), 0.0),
        (DVec3::new(0.0, -fy, height + 1.0 - cy).normalize(), 0.0),
        (DVec3::Z, -f64::from(NEAR_PLANE)),
        (DVec3::NEG_Z, farthest),
    ];
    let translation = camera.translation.as_dvec3();
    let world_from_camera = camera.camera_from_world.transpose().as_dmat3();
    let planes =
        planes.map(|(normal, offset)| (world_from_camera * normal, normal.dot(translation) + offset));
    let side = f64::from(FIELD_SIDE);
    // The outermost voxels lie half a voxel within the block's sides.
    let (middle, radius) = (DVec3::splat((side - 1.0) / 2.0), 3f64.sqrt() * side / 2.0);
    let is_visible = |&[x, y, z]: &[i32; 3]| {
        let center = voxel * (side * DVec3::new(x.into(), y.into(), z.into()) + middle);
        let reach = voxel * radius + 1e-6 * (center.length() + translation.length());
        planes.iter().all(|(normal, offset)| normal.dot(center) + offset >= -reach)
    };
    let indexed = places.iter().zip(0..).filter(|(place, _)| is_visible(place));
    indexed.map(|(&[x, y, z], index)| [x, y, z, index]).collect()
}
