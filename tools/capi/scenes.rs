//! Scenes that a host makes, changes and owns, in C.

use super::kept::{self, Kept};
use super::scratch::{List, Scratch, collected};
use super::structs::{named, read, read_all, within, write};
use super::{
    AshsplatContext, AshsplatGaussians, AshsplatHostBuffer, AshsplatScene, AshsplatScenePlan, AshsplatStatus,
    AshsplatUpdate, borrowed, borrowed_mut, give, guarded, slice,
};
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::scene::Gaussians;
use ashsplat::vk::Buffer;
use ashsplat::{DeviceScene, Error, Reservation, Result, Update};

/// Converts a host's Gaussians.
///
/// # Safety
/// The arrays have as many elements as the count and the degree require.
pub(super) unsafe fn gaussians(host: &AshsplatGaussians) -> Result<Gaussians> {
    let mut own = Gaussians::default();
    // SAFETY: as promised.
    unsafe { copy_into(&mut own, host) }.map(|()| own)
}

/// Copies a host's Gaussians over `own`, in its memory.
///
/// # Safety
/// Same as for [`gaussians`].
unsafe fn copy_into(own: &mut Gaussians, host: &AshsplatGaussians) -> Result<()> {
    if host.sh_degree > 3 {
        return Err(Error::argument("sh_degree", format!("{} is above 3", host.sh_degree)));
    }
    let (count, coefficients) = (host.count as usize, (host.sh_degree as usize + 1).pow(2));
    own.sh_degree = host.sh_degree;
    // SAFETY: as promised.
    unsafe {
        let floats = |pointer, per_gaussian: usize, what| slice(pointer, per_gaussian * count, what);
        own.means.clear();
        own.means.extend_from_slice(floats(host.means, 3, "means")?.as_chunks().0);
        own.quats.clear();
        own.quats.extend_from_slice(floats(host.quats, 4, "quats")?.as_chunks().0);
        own.log_scales.clear();
        own.log_scales.extend_from_slice(floats(host.log_scales, 3, "log_scales")?.as_chunks().0);
        own.opacity_logits.clear();
        own.opacity_logits.extend_from_slice(floats(host.opacity_logits, 1, "opacity_logits")?);
        own.sh.clear();
        own.sh.extend_from_slice(floats(host.sh, 3 * coefficients, "sh")?.as_chunks().0);
    }
    Ok(())
}

/// An update: its scene, first Gaussian, and copied Gaussians.
pub(super) type Copied<'a> = (&'a DeviceScene, u32, kept::Copy<'a>);

/// Copies a frame's updates.
///
/// # Safety
/// Same as for [`gaussians`], for each update; the scenes are alive.
pub(super) unsafe fn copied<'a>(
    updates: &[AshsplatUpdate],
    (scratch, kept): (&'a Scratch, &'a Kept),
) -> Result<List<'a, Copied<'a>>> {
    let copy = |(place, u): (usize, &AshsplatUpdate)| {
        // SAFETY: as promised.
        let copied = unsafe {
            borrowed(u.scene, "scene").and_then(|scene| {
                let mut own = kept.gaussians();
                copy_into(&mut own, &read(u.gaussians, "gaussians")?).map_err(within("gaussians"))?;
                Ok((&scene.scene, u.first, own))
            })
        };
        copied.map_err(within(format_args!("updates[{place}]")))
    };
    collected(updates.iter().enumerate().map(copy), scratch)
}

/// Converts copied updates.
pub(super) fn updates<'a>(copied: &'a [Copied<'a>], scratch: &'a Scratch) -> List<'a, Update<'a>> {
    let updates = copied.iter().map(|(scene, first, own)| Update { scene, first: *first, gaussians: own });
    List::from_iter_in(updates, scratch)
}

/// Uploads a scene from a host's arrays, with a capacity of at least `capacity` Gaussians: AshsplatUpdate and
/// ashsplat_scene_set_count change it later. Without Gaussians the scene is empty, and nothing is submitted. Values are not looked at:
/// Gaussians with a NaN, or an infinite position, size or quaternion, are not drawn. Quaternions are normalised.
///
/// # Safety
/// `context` is alive, `gaussians` is valid with arrays as long as it says, `scene` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_new(
    context: *const AshsplatContext,
    gaussians: *const AshsplatGaussians,
    capacity: u32,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (context, host) = (borrowed(context, "context")?, read(gaussians, "gaussians")?);
        give(scene, "scene", || {
            let made = match host.count {
                0 => DeviceScene::empty(&context.0, capacity, host.sh_degree),
                _ => DeviceScene::upload(&context.0, &self::gaussians(&host)?, capacity),
            };
            made.map(AshsplatScene::of)
        })
    })
}

/// Uploads `count` scenes from a host's arrays into as few buffers as kernels can bind, each with room for its own Gaussians: frames
/// draw small scenes of one buffer by one dispatch in place of one each (AshsplatSlotReport.batched_scenes). `scenes` has room for
/// `count` pointers; all are NULL after an error. Each scene is freed by itself, and the memory with the last one.
///
/// # Safety
/// `context` is alive, `gaussians` is valid for `count` structs of one size with arrays as long as they say, `scenes` is valid for
/// `count` writes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scenes_new(
    context: *const AshsplatContext,
    gaussians: *const AshsplatGaussians,
    count: u32,
    scenes: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        if count > 0 && scenes.is_null() {
            return Err(Error::argument("scenes", "the pointer is null"));
        }
        for place in 0..count as usize {
            scenes.add(place).write(std::ptr::null_mut());
        }
        let (context, hosts) = (borrowed(context, "context")?, read_all(gaussians, count, "gaussians")?);
        let copy = |(place, host): (usize, &AshsplatGaussians)| {
            self::gaussians(host).map_err(within(format_args!("gaussians[{place}]")))
        };
        let all = hosts.iter().enumerate().map(copy).collect::<Result<Vec<_>>>()?;
        let made = DeviceScene::upload_all(&context.0, &all.iter().collect::<Vec<_>>())?;
        for (place, scene) in made.into_iter().enumerate() {
            scenes.add(place).write(Box::into_raw(Box::new(AshsplatScene::of(scene))));
        }
        Ok(())
    })
}

/// The same scene in another context on the same VkDevice, with the same Gaussians in memory. It keeps the memory alive. Uses in both
/// contexts are uses of the same buffers, which the host orders.
///
/// # Safety
/// `scene` and `context` are alive, `shared` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_in_context(
    scene: *const AshsplatScene,
    context: *const AshsplatContext,
    shared: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (scene, context) = (borrowed(scene, "scene")?, borrowed(context, "context")?);
        give(shared, "shared", || scene.scene.in_context(&context.0).map(AshsplatScene::of))
    })
}

/// The layout of the parameters of `capacity` Gaussians in a host's own buffers.
///
/// # Safety
/// `context` is alive, `plan` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_plan(
    context: *const AshsplatContext,
    capacity: u32,
    sh_degree: u32,
    plan: *mut AshsplatScenePlan,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let made = DeviceScene::plan_for(&borrowed(context, "context")?.0, capacity, sh_degree)?;
        let told = AshsplatScenePlan {
            chunks: made.chunks,
            planes: made.planes,
            chunk_gaussians: made.chunk_gaussians,
            chunk_bytes: made.chunk_bytes(),
            ..AshsplatScenePlan::default()
        };
        write(plan, "plan", told)
    })
}

/// A scene of `count` Gaussians in the host's own buffers, one for each chunk of ashsplat_scene_plan for the
/// same capacity and degree. A host that writes them synchronises the writes as for any buffer that compute
/// shaders read.
///
/// # Safety
/// - `context` is alive, `buffers` has `buffer_count` elements, `scene` is valid for a write;
/// - each buffer is of the context's device, bound to memory, of the given size, and has the usages
///   STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST; it lives until the scene is freed and the last recording
///   that uses it has been executed; no two overlap.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_from_buffers(
    context: *const AshsplatContext,
    capacity: u32,
    sh_degree: u32,
    count: u32,
    buffers: *const AshsplatHostBuffer,
    buffer_count: u32,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let context = &borrowed(context, "context")?.0;
        let buffers = slice(buffers, buffer_count as usize, "buffers")?;
        give(scene, "scene", || {
            let adopt = |b: &AshsplatHostBuffer| {
                Buffer::adopt(context, "host's planes", vk::Buffer::from_raw(b.buffer), b.offset, b.bytes)
            };
            let adopt = |(place, b)| adopt(b).map_err(named(format_args!("buffers[{place}]")));
            let chunks: Result<Vec<Buffer>> = buffers.iter().enumerate().map(adopt).collect();
            let plan = DeviceScene::plan_for(context, capacity, sh_degree)?;
            let scene = DeviceScene::from_buffers(context, plan, chunks?, count)?;
            Ok(AshsplatScene::of(scene))
        })
    })
}

/// Renders only the first `count` Gaussians of a scene from the next recording on.
///
/// # Safety
/// `scene` is alive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_set_count(scene: *mut AshsplatScene, count: u32) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe { borrowed_mut(scene, "scene")?.scene.set_count(count) })
}

/// Staging bytes of an update of `gaussians` Gaussians of a scene of this degree, for AshsplatReservation.
#[unsafe(no_mangle)]
pub extern "C" fn ashsplat_update_bytes(gaussians: u32, sh_degree: u32) -> u64 {
    Reservation::update_bytes(gaussians, sh_degree.min(3))
}
