//! Gaussians in the device's layout, vec4 planes split into chunks, and conversions to and from it.

use crate::error::{Error, Result};
use crate::frame::{GaussianRange, SceneBuffers, ScenePlan, ShStorage, to_u32};
use crate::kernels::constants as c;
use crate::scene::Gaussians;
use crate::scene::gaussians::sh_coefficients;
use crate::vk::{Buffer, Context, MemoryKind};
use half::f16;

/// Requests for the buffers of a plan's planes, one per chunk.
pub(crate) fn requests(plan: &ScenePlan) -> Vec<(&'static str, u64)> {
    vec![("planes", plan.chunk_bytes()); plan.chunks as usize]
}

/// Allocates planes for a plan, one buffer per chunk.
pub fn allocate(
    context: &Context,
    arena: &'static str,
    kind: MemoryKind,
    plan: &ScenePlan,
) -> Result<Vec<Buffer>> {
    context.allocate(arena, &requests(plan), kind)
}

/// Uploads Gaussians into newly allocated planes in device memory, with the given `capacity`, stored with SH up to `sh_degree`
/// (missing coefficients are zero).
///
/// # Errors
/// [`TooLarge`](crate::Error::TooLarge) or an allocation's failure; [`Argument`](crate::Error::Argument) when
/// the Gaussians' vectors differ in length.
pub fn upload(
    context: &Context,
    arena: &'static str,
    gaussians: &Gaussians,
    capacity: u32,
    sh_degree: u32,
) -> Result<SceneBuffers> {
    let count = to_u32(gaussians.len() as u64)?;
    let plan = ScenePlan::new(context.limits(), capacity.max(count), sh_degree, ShStorage::F32)?;
    upload_planned(context, arena, MemoryKind::Device, gaussians, plan)
}

/// Same as [`upload`], for a plan whose capacity suffices, in memory of this kind.
pub fn upload_planned(
    context: &Context,
    arena: &'static str,
    kind: MemoryKind,
    gaussians: &Gaussians,
    plan: ScenePlan,
) -> Result<SceneBuffers> {
    gaussians.check_shapes()?;
    let count = to_u32(gaussians.len() as u64)?;
    let scene = SceneBuffers { chunks: allocate(context, arena, kind, &plan)?, plan, count };
    fill(context, &scene, gaussians)?;
    Ok(scene)
}

/// Uploads Gaussians, or other data of the same shape, into the planes of a scene of the same count.
///
/// # Errors
/// [`Argument`](crate::Error::Argument) when their number or their vectors' lengths differ; when the device
/// is lost.
pub fn fill(context: &Context, scene: &SceneBuffers, gaussians: &Gaussians) -> Result<()> {
    gaussians.check_shapes()?;
    if gaussians.len() != scene.count as usize {
        let problem = format!("{} do not fill a scene of {}", gaussians.len(), scene.count);
        return Err(Error::argument("Gaussians", problem));
    }
    let mut words = Vec::new();
    for range in scene.plan.ranges(scene.count) {
        let (first, end) = (range.first as usize, (range.first + range.count) as usize);
        pack_into(&mut words, gaussians, first..end, &scene.plan, 0);
        context.upload(&scene.chunks[range.chunk], bytemuck::cast_slice(&words))?;
    }
    Ok(())
}

/// Downloads the Gaussians of a scene.
pub fn download(context: &Context, scene: &SceneBuffers) -> Result<Gaussians> {
    let k = sh_coefficients(scene.plan.sh_degree);
    let n = scene.count as usize;
    let mut out = Gaussians { sh_degree: scene.plan.sh_degree, ..Gaussians::default() };
    out.means.reserve_exact(n);
    out.quats.reserve_exact(n);
    out.log_scales.reserve_exact(n);
    out.opacity_logits.reserve_exact(n);
    out.sh.reserve_exact(n * k);
    for range in scene.plan.ranges(scene.count) {
        let bytes = context.download(&scene.chunks[range.chunk])?;
        let words: &[[f32; 4]] = &bytemuck::pod_collect_to_vec::<u8, [f32; 4]>(&bytes);
        unpack(words, range.count as usize, &scene.plan, &mut out);
    }
    Ok(out)
}

/// Downloads the vec4 of all planes, Gaussian by Gaussian.
pub(crate) fn download_words(context: &Context, scene: &SceneBuffers) -> Result<Vec<[u32; 4]>> {
    let mut all = Vec::with_capacity(scene.count as usize * scene.plan.planes as usize);
    for range in scene.plan.ranges(scene.count) {
        let words: Vec<[u32; 4]> =
            bytemuck::pod_collect_to_vec(&context.download(&scene.chunks[range.chunk])?);
        let planes = |i: usize| (0..scene.plan.planes).map(move |plane| (plane, i));
        let each = (0..range.count as usize).flat_map(planes);
        all.extend(each.map(|(plane, i)| words[scene.plan.place(plane, i)]));
    }
    Ok(all)
}

/// Uploads what [`download_words`] returned.
pub(crate) fn fill_words(context: &Context, scene: &SceneBuffers, all: &[[u32; 4]]) -> Result<()> {
    let planes = scene.plan.planes as usize;
    for range in scene.plan.ranges(scene.count) {
        let mut words = vec![[0; 4]; scene.plan.chunk_gaussians as usize * planes];
        let own = all.chunks_exact(planes).skip(range.first as usize).take(range.count as usize);
        for (i, values) in own.enumerate() {
            (0..).zip(values).for_each(|(plane, value)| words[scene.plan.place(plane, i)] = *value);
        }
        context.upload(&scene.chunks[range.chunk], bytemuck::cast_slice(&words))?;
    }
    Ok(())
}

/// Downloads the sizes of the 3D filter: see [`Filter3d`](crate::passes::filter_3d::Filter3d).
pub fn download_filters(context: &Context, scene: &SceneBuffers) -> Result<Vec<f32>> {
    let mut values = Vec::with_capacity(scene.count as usize);
    for range in scene.plan.ranges(scene.count) {
        let bytes = context.download(&geometry_of(scene, &range))?;
        let words: &[[f32; 4]] = &bytemuck::pod_collect_to_vec::<u8, [f32; 4]>(&bytes);
        let size = |i: usize| words[scene.plan.place(c::PLANE_LOG_SCALE, i)][3];
        values.extend((0..range.count as usize).map(size));
    }
    Ok(values)
}

/// Uploads the sizes of the 3D filter, one per Gaussian.
pub fn upload_filters(context: &Context, scene: &SceneBuffers, filters: &[f32]) -> Result<()> {
    for range in scene.plan.ranges(scene.count) {
        let geometry = geometry_of(scene, &range);
        let mut words: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&context.download(&geometry)?);
        for (i, size) in filters[range.first as usize..][..range.count as usize].iter().enumerate() {
            words[scene.plan.place(c::PLANE_LOG_SCALE, i)][3] = *size;
        }
        context.upload(&geometry, bytemuck::cast_slice(&words))?;
    }
    Ok(())
}

/// Geometry planes of a range's Gaussians. They come first in a chunk, row by row.
fn geometry_of(scene: &SceneBuffers, range: &GaussianRange) -> Buffer {
    let rows = u64::from(range.count.div_ceil(c::PLANE_ROW));
    scene.chunks[range.chunk].range(0, rows * u64::from(c::PLANE_ROW) * u64::from(c::PLANE_SH) * 16)
}

/// Packs the Gaussians of `range` into a chunk, from index `begin` on. All others of the chunk become zero.
pub(crate) fn pack_into(
    planes: &mut Vec<[f32; 4]>,
    g: &Gaussians,
    range: std::ops::Range<usize>,
    plan: &ScenePlan,
    begin: usize,
) {
    planes.clear();
    planes.resize(plan.chunk_gaussians as usize * plan.planes as usize, [0.0; 4]);
    let stored = sh_coefficients(plan.sh_degree);
    for (i, source) in (begin..).zip(range) {
        let mut put = |plane: u32, values| planes[plan.place(plane, i)] = values;
        let [x, y, z] = g.means[source];
        put(c::PLANE_MEAN_OPACITY, [x, y, z, g.opacity_logits[source]]);
        put(c::PLANE_QUAT, g.quats[source]);
        let [x, y, z] = g.log_scales[source];
        put(c::PLANE_LOG_SCALE, [x, y, z, 0.0]);
        let sh = &g.sh_of(source);
        let floats = sh[..stored.min(sh.len())].as_flattened();
        match plan.sh_storage {
            ShStorage::F32 => {
                for (plane, floats) in (c::PLANE_SH..).zip(floats.chunks(4)) {
                    let mut values = [0.0; 4];
                    values[..floats.len()].copy_from_slice(floats);
                    put(plane, values);
                }
            }
            ShStorage::Half => {
                for (plane, floats) in (c::PLANE_SH..).zip(floats.chunks(8)) {
                    let mut halves = [f16::ZERO; 8];
                    halves.iter_mut().zip(floats).for_each(|(half, &float)| *half = nearest_half(float));
                    put(plane, bytemuck::cast(halves.map(f16::to_bits)));
                }
            }
            ShStorage::Bytes => {
                let Some((&[r, g, b], higher)) = floats.split_first_chunk() else { continue };
                let step = exact_step(higher).unwrap_or_else(|| rounded_step(higher));
                put(c::PLANE_SH, [r, g, b, step]);
                // The first bytes stand for the base colour and are unused.
                let mut bytes = [0; 48];
                bytes
                    .iter_mut()
                    .skip(3)
                    .zip(higher)
                    .for_each(|(byte, value)| *byte = (value / step).round() as i8);
                for (plane, bytes) in (c::PLANE_SH + 1..plan.planes).zip(bytes.as_chunks::<16>().0) {
                    put(plane, bytemuck::cast(*bytes));
                }
            }
        }
    }
}

impl ShStorage {
    /// Returns the smallest storage in which these Gaussians keep their values: bytes for those of SPZ files (but for a Gaussian that
    /// has both 1 and -1), halves for those that were trained in halves.
    pub fn lossless(gaussians: &Gaussians) -> Self {
        let mut all = gaussians.sh.chunks_exact(sh_coefficients(gaussians.sh_degree));
        let in_bytes = |own: &[[f32; 3]]| exact_step(own[1..].as_flattened()).is_some();
        let is_half = |value: &f32| f16::from_f32(*value).to_f32() == *value;
        match gaussians.sh_degree {
            // They are as large as floats.
            0 => Self::F32,
            _ if all.all(in_bytes) => Self::Bytes,
            _ if gaussians.sh.as_flattened().iter().all(is_half) => Self::Half,
            _ => Self::F32,
        }
    }
}

/// The step of which all values are multiples that fit bytes: 1/128, as SPZ files have it. Negative if there is 1, which mirroring makes
/// of -1.
fn exact_step(values: &[f32]) -> Option<f32> {
    let fits = |step: f32| values.iter().all(|value| f32::from((value / step) as i8) * step == *value);
    [1.0 / 128.0, -1.0 / 128.0].into_iter().find(|step| fits(*step))
}

/// A step for values of which some are rounded. Ones that are not finite do not count.
fn rounded_step(values: &[f32]) -> f32 {
    values.iter().filter(|value| value.is_finite()).fold(0.0, |max: f32, value| max.max(value.abs())) / 127.0
}

/// The nearest finite half.
fn nearest_half(value: f32) -> f16 {
    f16::from_f32(value.clamp(f16::MIN.to_f32(), f16::MAX.to_f32()))
}

fn unpack(planes: &[[f32; 4]], count: usize, plan: &ScenePlan, out: &mut Gaussians) {
    let at = |p: u32, i: usize| planes[plan.place(p, i)];
    let k = sh_coefficients(plan.sh_degree);
    for i in 0..count {
        let [x, y, z, opacity] = at(c::PLANE_MEAN_OPACITY, i);
        out.means.push([x, y, z]);
        out.opacity_logits.push(opacity);
        out.quats.push(at(c::PLANE_QUAT, i));
        let [x, y, z, _] = at(c::PLANE_LOG_SCALE, i);
        out.log_scales.push([x, y, z]);
        let float = |f: usize| match plan.sh_storage {
            ShStorage::F32 => at(c::PLANE_SH + f as u32 / 4, i)[f % 4],
            ShStorage::Half => {
                let halves: [u16; 8] = bytemuck::cast(at(c::PLANE_SH + f as u32 / 8, i));
                f16::from_bits(halves[f % 8]).to_f32()
            }
            ShStorage::Bytes => {
                let base = at(c::PLANE_SH, i);
                let byte =
                    |f: usize| bytemuck::cast::<_, [i8; 16]>(at(c::PLANE_SH + 1 + f as u32 / 16, i))[f % 16];
                if f < 3 { base[f] } else { f32::from(byte(f)) * base[3] }
            }
        };
        out.sh.extend((0..k).map(|j| [float(3 * j), float(3 * j + 1), float(3 * j + 2)]));
    }
}
