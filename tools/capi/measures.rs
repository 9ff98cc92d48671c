//! Distance of two pictures, in C: LPIPS.

use super::*;
use ashsplat::passes::lpips::Lpips;
use ashsplat_files::{HostMemory, lpips_weights};

/// A network of LPIPS with its weights on a device.
pub struct AshsplatLpips(Lpips, CString);

/// Reads the weights of LPIPS 0.1 with AlexNet or VGG16 from a safetensors file, which the caller has; tools/lpips_weights.py writes
/// it. The tensors' shapes say which network it is.
///
/// # Safety
/// `context` is alive, `weights` is a C string, `lpips` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_lpips_new(
    context: *const AshsplatContext,
    weights: *const c_char,
    lpips: *mut *mut AshsplatLpips,
) -> AshsplatStatus {
    guarded!({
        let (context, path) = (borrowed(context, "context")?, text(weights, "weights")?);
        give(lpips, "lpips", || {
            let weights = lpips_weights::read(path, &HostMemory::default())?;
            let name = CString::new(weights.network.measure()).unwrap_or_default();
            Ok(AshsplatLpips(Lpips::new(&context.0, &weights)?, name))
        })
    })
}

/// Frees a network.
///
/// # Safety
/// `lpips` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_lpips_free(lpips: *mut AshsplatLpips) {
    // SAFETY: as promised.
    unsafe { take(lpips) }
}

/// Name of the measure of ashsplat_lpips_distance: "lpips_alex" on values from -1 to 1, as in gsplat; or
/// "lpips_vgg_unscaled" on values from 0 to 1, as in the reference implementation. The name lives as long as `lpips`.
///
/// # Safety
/// `lpips` is alive, `name` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_lpips_name(
    lpips: *const AshsplatLpips,
    name: *mut *const c_char,
) -> AshsplatStatus {
    guarded!({ put(name, "name", borrowed(lpips, "lpips")?.1.as_ptr()) })
}

/// LPIPS of two pictures of one size, from red, green and blue of each pixel between 0 and 1, row by row: 0 for equal ones. Values
/// outside are clamped. Submits and waits.
///
/// # Safety
/// `lpips` is alive, `a` and `b` have 3 width height floats, `distance` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_lpips_distance(
    lpips: *mut AshsplatLpips,
    a: *const f32,
    b: *const f32,
    width: u32,
    height: u32,
    distance: *mut f64,
) -> AshsplatStatus {
    guarded!({
        let (lpips, floats) = (borrowed_mut(lpips, "lpips")?, rgb_floats(width, height)?);
        let pictures = [slice(a, floats, "a")?.as_chunks().0, slice(b, floats, "b")?.as_chunks().0];
        let distance = borrowed_mut(distance, "distance")?;
        *distance = lpips.0.distance(pictures, (width, height))?;
        Ok(())
    })
}
