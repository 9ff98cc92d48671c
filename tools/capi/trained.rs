//! Results of a training in C: the scene, cameras, exposures and lens effects, and a checkpoint of everything.

use super::structs::{check_room_of_all, write_all_if};
use super::{
    AshsplatCamera, AshsplatStatus, AshsplatTrainer, LAST_LOSS, borrowed, check_pointer, fill, guarded, text,
};
use ashsplat::scene::Cut;
use ashsplat::{Error, Result};
use ashsplat_files::{CheckpointFile, ply, splats};
use std::ffi::{CString, c_char};

/// Reads the Gaussians back and writes them, in the format that the name's ending says: PLY in the reference implementation's layout,
/// .compressed.ply, .splat, SPZ, or GLB. The sizes of the 3D filter are in PLY only; in other formats they are a part of scales and
/// opacities. ashsplat_last_loss says what the format does not hold. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `path` is a C string.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_save(
    trainer: *const AshsplatTrainer,
    path: *const c_char,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (trainer, path) = (&borrowed(trainer, "trainer")?.0, text(path, "path")?);
        let options = splats::WriteOptions::marking(&trainer.settings().render_settings());
        let filters = trainer.filters()?;
        let losses = match splats::Format::of_extension(path)? {
            splats::Format::Ply if !filters.is_empty() => {
                ply::write_filtered(path, &trainer.gaussians()?, &filters, &options)?;
                Vec::new()
            }
            format => {
                let gaussians = trainer.baked_gaussians()?;
                let all = (&Cut::default(), gaussians.sh_degree);
                splats::write(path, &gaussians, &options)?;
                splats::cut_losses(format, &gaussians, all, &options)?
            }
        };
        let losses = CString::new(losses.join("\n")).unwrap_or_default();
        LAST_LOSS.with(|last| *last.borrow_mut() = losses);
        Ok(())
    })
}

/// Writes all that ashsplat_trainer_resume needs. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `path` is a C string.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_checkpoint(
    trainer: *const AshsplatTrainer,
    path: *const c_char,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (trainer, path) = (&borrowed(trainer, "trainer")?.0, text(path, "path")?);
        trainer.checkpoint()?.write(path)
    })
}

/// The cameras of the views in their order, as the setting pose_opt has moved them. `cameras` has room for `count`, which must be the
/// number of views. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `cameras` is valid for `count` structs that ASHSPLAT_INIT has begun.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_cameras(
    trainer: *const AshsplatTrainer,
    cameras: *mut AshsplatCamera,
    count: u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let all = borrowed(trainer, "trainer")?.0.cameras()?;
        check_count(count, all.len())?;
        check_pointer(cameras, "cameras")?;
        check_room_of_all(cameras, count, "cameras")?;
        let all: Vec<AshsplatCamera> = all.into_iter().map(Into::into).collect();
        write_all_if(cameras, "cameras", &all)
    })
}

/// The exposures of the views in their order, with the setting exposure: three rows E of four floats each. A photograph's colour is
/// out_c = sum over k of in_k E[k][c] + E[c][3] of the rendered one. `exposures` has room for 12 `count` floats; `count` must be the number of views. Submits and
/// waits.
///
/// # Safety
/// `trainer` is alive, `exposures` is valid for 12 `count` floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_exposures(
    trainer: *const AshsplatTrainer,
    exposures: *mut f32,
    count: u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let all = borrowed(trainer, "trainer")?.0.exposures()?;
        let rows: Vec<[[f32; 4]; 3]> = all.into_iter().map(|exposure| exposure.rows).collect();
        give_rows(&rows, (exposures, count), ["exposures", "exposure"])
    })
}

/// The lens effects of the views in their order, with the setting lens_effects: for red, green and blue a_1, a_2, a_3 of the vignetting
/// 1 + a_1 r^2 + a_2 r^4 + a_3 r^6 and the logarithm of the response's exponent. `effects` has room for 12 `count` floats; `count` must be
/// the number of views. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `effects` is valid for 12 `count` floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_lens_effects(
    trainer: *const AshsplatTrainer,
    effects: *mut f32,
    count: u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let all = borrowed(trainer, "trainer")?.0.lens_effects()?;
        let rows: Vec<[[f32; 4]; 3]> = all.into_iter().map(|effects| effects.rows).collect();
        give_rows(&rows, (effects, count), ["effects", "lens_effects"])
    })
}

fn check_count(count: u32, views: usize) -> Result<()> {
    match count as usize == views {
        true => Ok(()),
        false => Err(Error::argument("count", format!("is {count}, there are {views} views"))),
    }
}

/// # Safety
/// The pointer is null or valid for `count` rows.
unsafe fn give_rows(
    rows: &[[[f32; 4]; 3]],
    (to, count): (*mut f32, u32),
    [name, setting]: [&str; 2],
) -> Result<()> {
    if rows.is_empty() {
        return Err(Error::argument(setting, "is not set: nothing of it is learned"));
    }
    check_count(count, rows.len())?;
    check_pointer(to, name)?;
    // SAFETY: as promised.
    unsafe { fill(to, rows.as_flattened().as_flattened()) };
    Ok(())
}
