//! Layout of Gaussians, cameras and splats for the kernels (documented in the shaders and `constants.glsl`).

use crate::reference::project::slope_limits;
use crate::reference::tiles::half_extent_px;
use crate::reference::types::{Gaussian, Splat, View};
use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::constants::{
    ANTIALIAS_COMPENSATED, ANTIALIAS_DETACHED, CAMERA_BLOCK_WORDS, NEAR_PLANE, PLANE_LOG_SCALE,
    PLANE_MEAN_OPACITY, PLANE_QUAT, PLANE_SH,
};

pub fn planes(coefficients: usize) -> usize {
    PLANE_SH as usize + (3 * coefficients).div_ceil(4)
}

/// Capacity of the planes for `count` Gaussians and a few more.
pub fn plane_capacity(count: usize) -> usize {
    (count + 3).next_multiple_of(256)
}

/// Index of a Gaussian in plane `plane`. Geometry and each SH degree lie apart, in rows of eight Gaussians.
pub fn place(plane: u32, index: usize, capacity: usize) -> usize {
    let [first, planes, own] = plane_place(plane, capacity).map(|part| part as usize);
    first + (index / 8 * planes + own) * 8 + index % 8
}

/// First index of the planes stored together with `plane`, their number, and its number among them.
pub fn plane_place(plane: u32, capacity: usize) -> [u32; 3] {
    let (first, planes) = match plane {
        0..3 => (0, 3),
        3 => (3, 1),
        4..6 => (4, 2),
        6..10 => (6, 4),
        10..15 => (10, 5),
        _ => panic!("no Gaussian has a plane {plane}"),
    };
    [first * capacity as u32, planes, plane - first]
}

pub fn pack(gaussians: &[Gaussian], capacity: usize) -> Vec<[f32; 4]> {
    let coefficients = gaussians.first().map_or(16, |g| g.sh.len());
    let mut packed = vec![[0.0; 4]; planes(coefficients) * capacity];
    let at = |plane: u32, i: usize| place(plane, i, capacity);
    for (i, gaussian) in gaussians.iter().enumerate() {
        let f = |x: f64| x as f32;
        let [x, y, z] = gaussian.mean.map(f);
        packed[at(PLANE_MEAN_OPACITY, i)] = [x, y, z, f(gaussian.opacity_logit)];
        packed[at(PLANE_QUAT, i)] = gaussian.quat.map(f);
        let [a, b, c] = gaussian.log_scale.map(f);
        packed[at(PLANE_LOG_SCALE, i)] = [a, b, c, 0.0];
        for (float, value) in gaussian.sh.as_flattened().iter().enumerate() {
            packed[at(PLANE_SH + float as u32 / 4, i)][float % 4] = f(*value);
        }
    }
    packed
}

/// Same as [`pack`], but all Gaussians have a 3D filter of this size; 0 for none.
pub fn pack_filtered(gaussians: &[Gaussian], capacity: usize, size: f64) -> Vec<[f32; 4]> {
    let mut packed = pack(gaussians, capacity);
    (0..gaussians.len()).for_each(|i| packed[place(PLANE_LOG_SCALE, i, capacity)][3] = size as f32);
    packed
}

pub fn antialias_word(view: &View) -> u32 {
    let bit = |on: bool, bit: u32| if on { bit } else { 0 };
    bit(view.antialias, ANTIALIAS_COMPENSATED) | bit(view.antialias_detached, ANTIALIAS_DETACHED)
}

/// The inverse of [`pack`].
pub fn unpack(packed: &[[f32; 4]], capacity: usize, count: usize, coefficients: usize) -> Vec<Gaussian> {
    let f = |x: f32| f64::from(x);
    let at = |plane: u32, i: usize| packed[place(plane, i, capacity)];
    (0..count)
        .map(|i| {
            let [x, y, z, opacity_logit] = at(PLANE_MEAN_OPACITY, i).map(f);
            let [a, b, c, _] = at(PLANE_LOG_SCALE, i).map(f);
            let flat = |float: usize| f(at(PLANE_SH + float as u32 / 4, i)[float % 4]);
            Gaussian {
                mean: [x, y, z],
                quat: at(PLANE_QUAT, i).map(f),
                log_scale: [a, b, c],
                opacity_logit,
                sh: (0..coefficients).map(|k| [0, 1, 2].map(|channel| flat(3 * k + channel))).collect(),
            }
        })
        .collect()
}

/// The uniform block of the kernels that project.
// Views lack some members of the block; those are 0.
#[allow(clippy::needless_update)]
pub fn camera_block(view: &View) -> CameraBlock {
    let [[x0, x1], [y0, y1]] = slope_limits(view);
    let [camera_row_x, camera_row_y, camera_row_z] = view.camera_from_world.map(|row| row.map(|x| x as f32));
    let [low, high] = view.drawn.cut.mean;
    CameraBlock {
        camera_row_x,
        camera_row_y,
        camera_row_z,
        camera_translation: view.translation.map(|x| x as f32),
        focal_px: view.focal_px.map(|x| x as f32),
        // Pixel centres at the integers.
        center_px: view.center_px.map(|x| (x - 0.5) as f32),
        jacobian_limits: [x0 as f32, x1 as f32, y0 as f32, y1 as f32],
        image_width: view.size_px[0],
        image_height: view.size_px[1],
        whole_width: view.size_px[0],
        whole_height: view.size_px[1],
        inverse_scale_squared: 1.0,
        shape_scale: view.drawn.scale_modifier as f32,
        shape_dilation_px2: view.drawn.dilation_px2 as f32,
        shape_opacity: view.drawn.opacity as f32,
        cut_low: low.map(|x| x as f32),
        cut_high: high.map(|x| x as f32),
        cut_opacity_logit: view.drawn.cut.opacity_logit as f32,
        cut_log_density: view.drawn.cut.log_density as f32,
        dropout_seed: view.drawn.dropout.map_or(0, |dropout| dropout.seed),
        dropout_iteration: view.drawn.dropout.map_or(0, |dropout| dropout.iteration),
        dropout_below: view.drawn.dropout.map_or(0, |dropout| dropout.below),
        dropout_factor: view.drawn.opacity_factor() as f32,
        scene_tint: view.drawn.tint.map_or([0.0; 3], |tint| tint.color.map(|x| x as f32)),
        scene_opacity: view.drawn.tint.map_or(0.0, |tint| tint.opacity as f32),
        selection_color: view.drawn.selection.map_or([0.0; 3], |own| own.color.map(|x| x as f32)),
        selection_share: view.drawn.selection.map_or(0.0, |own| own.share as f32),
        ..CameraBlock::default()
    }
}

/// Camera blocks of several scenes in a row, as the kernels over all scenes read them.
pub fn scene_blocks(blocks: &[CameraBlock]) -> Vec<[u32; CAMERA_BLOCK_WORDS as usize]> {
    let padded = |block: &CameraBlock| {
        let mut words = [0xDEAD_BEEF; CAMERA_BLOCK_WORDS as usize];
        let own = bytemuck::cast_slice(bytemuck::bytes_of(block));
        words[..own.len()].copy_from_slice(own);
        words
    };
    blocks.iter().map(padded).collect()
}

/// Cut-outs of a view, behind two that culling must not read. Also the index of the first and their number.
pub fn cut_outs(view: &View) -> (Vec<[f32; 4]>, [u32; 2]) {
    let mut words = vec![[f32::NAN; 4]; 8];
    let own = view.drawn.cut_outs.iter().flatten();
    for cut_out in own.clone() {
        for (row, center) in cut_out.rows.iter().zip(cut_out.center) {
            words.push([row[0], row[1], row[2], center]);
        }
        let ([x, y, z], kind) = (cut_out.bounds, cut_out.shape + if cut_out.removes { 4 } else { 0 });
        words.push([x, y, z, kind as f32]);
    }
    (words, [2, own.count() as u32])
}

pub fn extent_word(view: &View) -> u32 {
    use crate::reference::types::Extent;
    match view.extent {
        Extent::Exact => ashsplat::kernels::constants::EXTENT_EXACT,
        Extent::Reference => ashsplat::kernels::constants::EXTENT_REFERENCE,
    }
}

#[derive(Clone, Debug, Default)]
pub struct SplatPlanes {
    pub mean2d_extent: Vec<[f32; 4]>,
    pub conic_opacity: Vec<[f32; 4]>,
    pub color_inverse_depth: Vec<[f32; 4]>,
}

/// The depth of a depth key.
pub fn depth_of_key(key: u32) -> f32 {
    f32::from_bits(key + NEAR_PLANE.to_bits())
}

/// Packs splats, rounded to float32. The extents are slightly widened, as the projection does it.
pub fn pack_splats(splats: &[Splat]) -> SplatPlanes {
    let f = |x: f64| x as f32;
    let mut planes = SplatPlanes::default();
    for splat in splats {
        let [hx, hy] = half_extent_px(splat).map(|h| h * 1.0001 + 0.001);
        planes.mean2d_extent.push([splat.mean2d_px[0], splat.mean2d_px[1], hx, hy].map(f));
        let [a, b, c] = splat.conic;
        planes.conic_opacity.push([a, b, c, splat.opacity].map(f));
        let [red, green, blue] = splat.color;
        planes.color_inverse_depth.push([red, green, blue, 1.0 / splat.depth].map(f));
    }
    planes
}

/// Rounds every value to float32, so that the twins see the same numbers as the kernels.
pub fn rounded(splats: &[Splat]) -> Vec<Splat> {
    let planes = pack_splats(splats);
    let f = |x: f32| f64::from(x);
    splats
        .iter()
        .enumerate()
        .map(|(i, splat)| {
            let [x, y, _, _] = planes.mean2d_extent[i].map(f);
            let [a, b, c, opacity] = planes.conic_opacity[i].map(f);
            let [red, green, blue, inverse_depth] = planes.color_inverse_depth[i].map(f);
            Splat {
                depth: 1.0 / inverse_depth,
                mean2d_px: [x, y],
                conic: [a, b, c],
                opacity,
                color: [red, green, blue],
                ..splat.clone()
            }
        })
        .collect()
}
