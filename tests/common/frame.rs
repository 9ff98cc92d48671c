//! Splats of a random scene and their tile lists, as inputs of the kernels that follow the projection.

use super::gpu::{Gpu, UNTOUCHED};
use super::layout::{
    SplatPlanes, antialias_word, camera_block, extent_word, pack_filtered, pack_splats, plane_capacity,
    rounded,
};
use super::scenes::{Random, mixed_scene};
use crate::reference::blend::samples;
use crate::reference::pipeline::{Frame, pixels_of, tile_of};
use crate::reference::project as twin;
use crate::reference::tiles::{alpha_unclamped, touched, touches_by_pixels};
use crate::reference::types::{
    ALPHA_MAX, ALPHA_MIN, Extent, Gaussian, Selection, Splat, TRANSMITTANCE_MIN, View,
};
use ashsplat::frame::ShStorage;
use ashsplat::kernels::constants::{STATE_FIRST_SCENE_VISIBLE, STATE_INSTANCES, STATE_VISIBLE};
use ashsplat::kernels::forward::project;
use ashsplat::vk::Buffer;

pub struct Splats {
    pub splats: Vec<Splat>,
    pub mean2d_extent: Buffer,
    pub conic_opacity: Buffer,
    pub color_inverse_depth: Buffer,
}

impl Splats {
    pub fn new(gpu: &Gpu, splats: Vec<Splat>) -> Splats {
        let SplatPlanes { mean2d_extent, conic_opacity, color_inverse_depth } = pack_splats(&splats);
        Splats {
            mean2d_extent: gpu.buffer("mean2d_extent", &mean2d_extent),
            conic_opacity: gpu.buffer("conic_opacity", &conic_opacity),
            color_inverse_depth: gpu.buffer("color_inverse_depth", &color_inverse_depth),
            splats: rounded(&splats),
        }
    }
}

/// Output of `forward/project` for the visible Gaussians of a scene.
pub struct Projected {
    pub expected: Vec<Splat>,
    pub mean2d_extent: Buffer,
    pub conic_opacity: Buffer,
    pub color_inverse_depth: Buffer,
    pub depth_keys: Buffer,
    pub footprints: Buffer,
    pub tile_lists: Buffer,
}

impl Projected {
    /// Projects a scene. Each output has one row more than there are visible Gaussians.
    pub fn new(gpu: &Gpu, gaussians: &[Gaussian], view: &View) -> Projected {
        Self::listing(gpu, gaussians, view, false)
    }

    /// Same as [`Self::new`]; all Gaussians may be listed as visible. `expected` has only those that are.
    pub fn listing(gpu: &Gpu, gaussians: &[Gaussian], view: &View, shared_order: bool) -> Projected {
        let spec = project::Spec {
            workgroup_size: gpu.workgroup(64),
            // May be lower than the stored one.
            sh_degree: view.sh_degree,
            filter_3d: view.filter_3d > 0.0,
            dropout: view.drawn.dropout.is_some(),
            tinted: view.drawn.tint.is_some(),
            selection: view.drawn.selection.is_some(),
            z_record: view.drawn.z_record,
            projection: view.drawn.projection(),
            lenses: false,
            sh_loops: gpu.limits().tuning.sh_loops,
            shared_order,
            sh_storage: ShStorage::F32 as u32,
            distance_order: view.drawn.distance_order,
            shutter: false,
        };
        let splat = |(i, gaussian): (usize, &Gaussian)| {
            let splat = twin::project(gaussian, view)?;
            Some(Splat { color: view.drawn.highlighted(i, splat.color), ..splat })
        };
        let splats: Vec<Option<Splat>> = gaussians.iter().enumerate().map(splat).collect();
        // The range begins with a later Gaussian of its scene.
        let first_of_scene = 37;
        let mut mask = vec![0; (gaussians.len() + first_of_scene).div_ceil(32).max(1)];
        for i in (0..gaussians.len()).filter(|&i| Selection::selects(i)) {
            mask[(first_of_scene + i) / 32] |= 1u32 << ((first_of_scene + i) % 32);
        }
        // Culling applies the dropout.
        let visible: Vec<u32> =
            (0..gaussians.len() as u32).filter(|&i| shared_order || splats[i as usize].is_some()).collect();
        let (capacity, count) = (plane_capacity(gaussians.len()), visible.len());
        let parameters = gpu.buffer("parameters", &pack_filtered(gaussians, capacity, view.filter_3d));
        // Two entries at the front belong to another range.
        let list = gpu.buffer("visible_list", &[&[UNTOUCHED; 2], visible.as_slice()].concat());
        let ranges = gpu.buffer("visible_ranges", &[[0; 4], [2, 2 + count as u32, 0, 0]]);
        let [mean2d_extent, conic_opacity, color_inverse_depth, footprints] =
            ["mean2d_extent", "conic_opacity", "color_inverse_depth", "footprints"]
                .map(|name| gpu.untouched::<[u32; 4]>(name, count + 3));
        let depth_keys = gpu.untouched::<u32>("depth_keys", count + 3);
        let tile_lists = gpu.untouched::<[u32; 2]>("tile_lists", count + 3);
        let bind = project::Bind {
            parameters: &parameters,
            visible_ranges: &ranges,
            visible_list: &list,
            mean2d_extent: &mean2d_extent,
            conic_opacity: &conic_opacity,
            color_inverse_depth: &color_inverse_depth,
            depth_keys: &depth_keys,
            footprints: &footprints,
            tile_lists: &tile_lists,
            selection: &gpu.buffer("selection", &mask),
            camera_block: &gpu.buffer("camera_block", &[camera_block(view)]),
        };
        let push = project::Push {
            first: 0,
            chunk_gaussians: capacity as u32,
            extent: extent_word(view),
            antialias: antialias_word(view),
            splat_stride: 1,
            first_of_scene: first_of_scene as u32,
            ..project::Push::default()
        };
        let workgroups = count as u64 / u64::from(spec.workgroup_size) + 1;
        gpu.dispatch::<project::Interface>(&spec, &bind, &push, workgroups);
        let behind = |buffer: Buffer, bytes: u64| {
            let words = gpu.read::<u32>(&buffer, buffer.bytes() as usize / 4);
            let own = 2 * bytes as usize / 4..(2 + count) * bytes as usize / 4;
            let others = words[..own.start].iter().chain(&words[own.end..]);
            assert!(others.copied().all(|word| word == UNTOUCHED), "{} outside the range", buffer.name());
            // A buffer of its own, because devices align ranges to up to 256 bytes.
            gpu.buffer("own", &words[own.start..])
        };
        Projected {
            expected: splats.into_iter().flatten().collect(),
            mean2d_extent: behind(mean2d_extent, 16),
            conic_opacity: behind(conic_opacity, 16),
            color_inverse_depth: behind(color_inverse_depth, 16),
            depth_keys: behind(depth_keys, 4),
            footprints: behind(footprints, 16),
            tile_lists: behind(tile_lists, 8),
        }
    }

    /// Splats as the kernels after the projection read them: mean, conic, opacity and radius.
    pub fn splats(&self, gpu: &Gpu, view: &View) -> Vec<Splat> {
        let count = self.expected.len();
        let means = gpu.read::<[f32; 4]>(&self.mean2d_extent, count);
        let conics = gpu.read::<[f32; 4]>(&self.conic_opacity, count);
        let footprints = gpu.read::<[u32; 4]>(&self.footprints, count);
        let seen = |(place, splat): (usize, &Splat)| {
            let [x, y, _, _] = means[place].map(f64::from);
            let [a, b, c, opacity] = conics[place].map(f64::from);
            let radius_px = if view.extent == Extent::Reference { footprints[place][2] as i32 } else { 0 };
            Splat { mean2d_px: [x, y], conic: [a, b, c], opacity, radius_px, ..splat.clone() }
        };
        self.expected.iter().enumerate().map(seen).collect()
    }
}

pub fn visible_scene(count: usize, view: &View) -> Vec<Gaussian> {
    let mut random = Random::new(count as u64);
    let mut gaussians = Vec::new();
    while gaussians.len() < count {
        let scene = mixed_scene(&mut random, 4 * count, 1);
        gaussians.extend(scene.into_iter().filter(|gaussian| twin::project(gaussian, view).is_some()));
    }
    gaussians.truncate(count);
    gaussians
}

/// Fewest and most tiles that may be counted for a splat: those with a pixel of α ≥ 1/255, and those that a slightly
/// larger ellipse meets.
pub fn tile_bounds(splat: &Splat, view: &View) -> (u32, u32) {
    if view.extent == Extent::Reference {
        let exactly = touched(splat, view).len() as u32;
        return (exactly, exactly);
    }
    let max = touched_at_most(splat, view).len() as u32;
    let [columns, rows] = view.tiles();
    let tiles = (0..rows).flat_map(|y| (0..columns).map(move |x| [x, y]));
    // Rounding decides about pixels at the threshold.
    let surely = Splat { opacity: splat.opacity * (1.0 - 1e-5), ..splat.clone() };
    (tiles.filter(|tile| touches_by_pixels(&surely, *tile)).count() as u32, max)
}

/// A splat enlarged by the projection's margins.
pub fn widened(splat: &Splat) -> Splat {
    let opacity = splat.opacity.max(ALPHA_MIN) * 1.005;
    Splat {
        opacity,
        cov2d: splat.cov2d.map(|c| c * 1.001),
        conic: splat.conic.map(|c| c / 1.001),
        ..splat.clone()
    }
}

/// All tiles whose lists may contain a splat, with the projection's margins and up to a tenth of a pixel of
/// displacement.
pub fn touched_at_most(splat: &Splat, view: &View) -> Vec<u32> {
    let mut tiles = Vec::new();
    for (dx, dy) in [(0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)] {
        let [x, y] = splat.mean2d_px;
        tiles.extend(touched(&Splat { mean2d_px: [x + dx, y + dy], ..widened(splat) }, view));
    }
    tiles.sort_unstable();
    tiles.dedup();
    tiles
}

/// Frame state with these counts. The first scene has `first_scene` of the visible Gaussians.
pub fn state(gpu: &Gpu, [first_scene, visible, instances]: [usize; 3]) -> Buffer {
    gpu.frame_state(&[
        (STATE_VISIBLE, visible as u32),
        (STATE_FIRST_SCENE_VISIBLE, first_scene as u32),
        (STATE_INSTANCES, instances as u32),
    ])
}

/// A random permutation, in place of a depth sort.
pub fn shuffled(count: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..count as u32).collect();
    let mut random = Random::new(count as u64);
    for last in (1..count).rev() {
        order.swap(last, random.below(last as u32 + 1) as usize);
    }
    order
}

pub struct Lists {
    pub view: View,
    pub frame: Splats,
    pub lists: Vec<Vec<u32>>,
    pub tile_ranges: Buffer,
    pub sorted_visible: Buffer,
    /// Slot before the tile sort of each sorted instance.
    pub instances: Vec<u32>,
    pub sorted_instances: Buffer,
    pub state: Buffer,
}

impl Lists {
    /// Uploads lists. The instances are a random permutation.
    pub fn new(gpu: &Gpu, splats: Vec<Splat>, lists: Vec<Vec<u32>>, view: &View) -> Lists {
        let mut ranges = Vec::new();
        let mut sorted: Vec<u32> = Vec::new();
        for list in &lists {
            let begin = sorted.len() as u32;
            sorted.extend(list);
            ranges.push(if list.is_empty() { [0, 0] } else { [begin, sorted.len() as u32] });
        }
        let instances = shuffled(sorted.len());
        let state = state(gpu, [splats.len(), splats.len(), sorted.len()]);
        Lists {
            view: view.clone(),
            frame: Splats::new(gpu, splats),
            lists,
            tile_ranges: gpu.buffer("tile_ranges", &ranges),
            sorted_visible: gpu.buffer("sorted_visible", &sorted),
            sorted_instances: gpu.buffer("sorted_instances", &instances),
            instances,
            state,
        }
    }

    /// `entries` splats per tile, so faint and small that every entry contributes.
    pub fn long(gpu: &Gpu, entries: usize, opacity: [f64; 2], view: &View) -> Lists {
        let mut random = Random::new(entries as u64);
        let tiles = view.tiles();
        let mut splats = Vec::new();
        let mut lists = Vec::new();
        for tile in 0..tiles[0] * tiles[1] {
            let corner = [tile % tiles[0], tile / tiles[0]].map(|t| f64::from(t * 16));
            let first = splats.len() as u32;
            splats.extend((0..entries).map(|_| random_splat(&mut random, corner, opacity)));
            lists.push((first..splats.len() as u32).collect());
        }
        Lists::new(gpu, splats, lists, view)
    }

    /// Same as [`Self::long`], but every list is in order of depth, as in a frame.
    pub fn sorted(gpu: &Gpu, entries: usize, opacity: [f64; 2], view: &View) -> Lists {
        let Lists { frame, mut lists, view, .. } = Lists::long(gpu, entries, opacity, view);
        for list in &mut lists {
            list.sort_by(|&a, &b| frame.splats[a as usize].depth.total_cmp(&frame.splats[b as usize].depth));
        }
        Lists::new(gpu, frame.splats, lists, &view)
    }

    pub fn list_of(&self, pixel: [u32; 2]) -> Vec<&Splat> {
        self.lists[tile_of(&self.view, pixel)].iter().map(|&i| &self.frame.splats[i as usize]).collect()
    }

    /// Pixels at which float32 rounding may change a decision of the blending: exp is accurate to 17 ulp on
    /// lavapipe, and its argument is rounded too.
    pub fn unstable(&self) -> Vec<bool> {
        pixels_of(&self.view)
            .map(|pixel| {
                let list = self.list_of(pixel);
                is_unstable(&list, pixel, 2e-5)
            })
            .collect()
    }
}

fn random_splat(random: &mut Random, corner: [f64; 2], opacity: [f64; 2]) -> Splat {
    let [xx, yy] = [0; 2].map(|_| random.between(0.5, 60.0));
    let xy = random.between(-0.9, 0.9) * (xx * yy).sqrt();
    let determinant = xx * yy - xy * xy;
    Splat {
        depth: random.between(0.5, 9.0),
        mean2d_px: corner.map(|x| x + random.between(-8.0, 24.0)),
        cov2d: [xx, xy, yy],
        conic: [yy / determinant, -xy / determinant, xx / determinant],
        opacity: random.between(opacity[0], opacity[1]),
        color: [0; 3].map(|_| random.unit()),
        radius_px: 0,
    }
}

/// True if a relative error of α may change a decision at this pixel.
pub fn is_unstable(list: &[&Splat], pixel: [u32; 2], margin: f64) -> bool {
    let near = |x: f64, threshold: f64, margin: f64| (x / threshold - 1.0).abs() < margin;
    let (blended, _) = samples(list, pixel);
    let end = blended.last().map_or(0, |sample| sample.entry + 1);
    let mut transmittance = 1.0;
    let mut decided = blended.iter().peekable();
    for (entry, splat) in list.iter().enumerate() {
        let Some(alpha) = alpha_unclamped(splat, pixel) else { continue };
        if near(alpha, ALPHA_MIN, margin) || near(alpha, ALPHA_MAX, margin) {
            return true;
        }
        if alpha >= ALPHA_MIN {
            let next = transmittance * (1.0 - alpha.min(ALPHA_MAX));
            if near(next, TRANSMITTANCE_MIN, 10.0 * margin) {
                return true;
            }
        }
        if decided.peek().is_some_and(|sample| sample.entry == entry) {
            let sample = decided.next().expect("peeked");
            transmittance = sample.transmittance * (1.0 - sample.alpha);
        } else if entry > end && alpha >= ALPHA_MIN {
            break;
        }
    }
    false
}

/// Pixels of a frame at which a relative error of α may change a decision.
pub fn unstable_pixels(view: &View, frame: &Frame, margin: f64) -> Vec<bool> {
    let splat = |&index: &u32| frame.splats[index as usize].as_ref().expect("listed");
    let lists: Vec<Vec<&Splat>> = frame.lists.iter().map(|list| list.iter().map(splat).collect()).collect();
    pixels_of(view).map(|pixel| is_unstable(&lists[tile_of(view, pixel)], pixel, margin)).collect()
}
