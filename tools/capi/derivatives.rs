//! A renderer's other operations on a scene, in C: gradients, alignment of cameras to photographs, the 3D filter.

use super::training::photo;
use super::*;
use ashsplat::{Alignment, Gradients};

/// Arrays of the host that receive gradients, each as long as the scene and shaped as in AshsplatGaussians. NULL leaves a
/// gradient out.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatGradients {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// By the means: three each, 1 / units of the scene.
    pub means: *mut f32,
    /// By the quaternions as they are stored: four each.
    pub quats: *mut f32,
    /// By the logarithms of the standard deviations: three each.
    pub log_scales: *mut f32,
    /// By the opacities before the sigmoid.
    pub opacity_logits: *mut f32,
    /// By the coefficients of all stored degrees: three for each of (sh_degree + 1)^2. Those of degrees that are not evaluated are 0.
    pub sh: *mut f32,
    /// By the centres in the picture: two each, 1 / pixels. 0 for Gaussians that are not visible.
    pub mean2d_px: *mut f32,
    /// By the camera's pose T, from world to camera: six floats dL/dδ at δ = 0 of exp(δ^) T. The first three are
    /// displacements of the scene along the camera's axes (x right, y down, z forward), 1 / world units; the others are
    /// turns of it about these axes, 1 / radians.
    pub pose: *mut f32,
}

/// How ashsplat_align moves a camera: by Adam.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatAlignment {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Number of steps; 100 reach about 2.5 degrees.
    pub steps: u32,
    /// Initial learning rate of turns, radians; of displacements, times the mean depth. It falls log-linearly to a
    /// hundredth.
    pub lr: f64,
    /// Weight of 1 - SSIM in the loss, 0 to 1; L1 takes the rest.
    pub lambda_dssim: f64,
}

/// Renders a scene and gives the gradient of L by all parameters, for a given dL/dimage (paper, appendix A). It is exact, but for
/// AshsplatRenderSettings.antialias_detached. `image_gradient`: red, green and blue of each pixel, row by row. `inverse_depth_gradient`: a
/// float of each pixel, by the sum of weights / z (AshsplatRenderSettings.inverse_depth), or NULL. Submits and waits. Settings with
/// another shape or a scale modifier, and orthographic cameras, are refused.
///
/// # Safety
/// `renderer`, `scene` and `camera` are alive, `settings` too, or NULL for the defaults; `background` has three floats,
/// `image_gradient` 3 width height, `inverse_depth_gradient` width height or is NULL; `gradients` is valid with arrays as long as the
/// scene (ashsplat_scene_size).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_gradients(
    renderer: *mut AshsplatRenderer,
    scene: *const AshsplatScene,
    camera: *const AshsplatCamera,
    settings: *const AshsplatRenderSettings,
    background: *const f32,
    image_gradient: *const f32,
    inverse_depth_gradient: *const f32,
    gradients: *const AshsplatGradients,
) -> AshsplatStatus {
    guarded!({
        let (renderer, scene) = (borrowed_mut(renderer, "renderer")?, borrowed(scene, "scene")?);
        let to = read(gradients, "gradients")?;
        let (camera, settings) = frame(camera, settings, background)?;
        let pixels = camera.width as usize * camera.height as usize;
        let of_image = slice(image_gradient, 3 * pixels, "image_gradient")?.as_chunks().0;
        let of_depth = slice_if(inverse_depth_gradient, pixels, "inverse_depth_gradient")?;
        let found = renderer.0.with_scene(&scene.scene, |renderer| match to.pose.is_null() {
            true => renderer.gradients(&camera, &settings, of_image, of_depth),
            false => renderer.gradients_with_pose(&camera, &settings, of_image, of_depth),
        })?;
        to.fill(&found);
        Ok(())
    })
}

impl AshsplatGradients {
    /// # Safety
    /// The arrays are null or as long as the gradients.
    unsafe fn fill(&self, found: &Gradients) {
        let of = &found.parameters;
        let all: [(*mut f32, &[f32]); 7] = [
            (self.means, of.means.as_flattened()),
            (self.quats, of.quats.as_flattened()),
            (self.log_scales, of.log_scales.as_flattened()),
            (self.opacity_logits, &of.opacity_logits),
            (self.sh, of.sh.as_flattened()),
            (self.mean2d_px, found.mean2d_px.as_flattened()),
            (self.pose, found.pose.as_ref().map_or(&[], |pose| pose)),
        ];
        for (to, from) in all.into_iter().filter(|(to, _)| !to.is_null()) {
            // SAFETY: as promised.
            unsafe { fill(to, from) };
        }
    }
}

/// Moves a camera until the picture of a fixed scene agrees with a photograph, for example before a held-out view is
/// measured. Submits and waits. `rgb`: red, green and blue of each pixel, a byte each, row by row. `mask`: a byte per pixel,
/// those with 0 do not count, or NULL. `aligned` may be `camera`. Refuses what ashsplat_gradients refuses.
///
/// # Safety
/// `renderer`, `scene` and `camera` are alive; `settings` and `alignment` too, or NULL for the defaults; `background` has three floats,
/// `rgb` 3 width height bytes, `mask` width height or is NULL; `aligned` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_align(
    renderer: *mut AshsplatRenderer,
    scene: *const AshsplatScene,
    camera: *const AshsplatCamera,
    settings: *const AshsplatRenderSettings,
    background: *const f32,
    rgb: *const u8,
    mask: *const u8,
    alignment: *const AshsplatAlignment,
    aligned: *mut AshsplatCamera,
) -> AshsplatStatus {
    guarded!({
        let (renderer, scene) = (borrowed_mut(renderer, "renderer")?, borrowed(scene, "scene")?);
        let (camera, settings) = frame(camera, settings, background)?;
        let alignment = read_if(alignment, "alignment")?.unwrap_or_default();
        check_pointer(aligned, "aligned")?;
        check_room(aligned, "aligned")?;
        let alignment = Alignment {
            steps: alignment.steps,
            lr: alignment.lr,
            lambda_dssim: alignment.lambda_dssim as f32,
        };
        let photo = photo(&camera, rgb, mask)?;
        let align =
            |renderer: &mut ashsplat::Renderer| renderer.align(&camera, &photo, &settings, &alignment);
        let moved = renderer.0.with_scene(&scene.scene, align)?;
        write(aligned, "aligned", moved.into())
    })
}

/// Gives a scene's Gaussians the sizes of Mip-Splatting's 3D filter (Yu et al. 2024, section 5.1), which follow from the cameras that
/// the scene was trained with: AshsplatRenderSettings.filter_3d draws with them. Submits and waits. Orthographic cameras are refused.
/// Not for a PLY whose scales and opacities contain the filter already, nor for a trainer's scene, which keeps its own
/// sizes. Updates and Gaussians that are added later have none.
///
/// # Safety
/// `renderer` and `scene` are alive, `cameras` is valid for `count` structs of one size. No recorded frame may use the scene meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_compute_filters(
    renderer: *mut AshsplatRenderer,
    scene: *mut AshsplatScene,
    cameras: *const AshsplatCamera,
    count: u32,
) -> AshsplatStatus {
    guarded!({
        let (renderer, scene) = (borrowed_mut(renderer, "renderer")?, borrowed(scene, "scene")?);
        let cameras = read_all(cameras, count, "cameras")?.collect::<Result<Vec<_>>>()?;
        let known = |(index, camera): (usize, &AshsplatCamera)| {
            let name = format!("cameras[{index}]");
            let camera = camera.known(&name)?;
            if camera.is_orthographic() {
                let problem = "is orthographic: the 3D filter takes rays through a point";
                return Err(Error::argument(format!("{name}.projection"), problem));
            }
            camera.check().map_err(named(name))?;
            Ok(camera)
        };
        let cameras = cameras.iter().enumerate().map(known).collect::<Result<Vec<_>>>()?;
        renderer.0.with_scene(&scene.scene, |renderer| renderer.compute_filters(&cameras))
    })
}

/// The sizes of the 3D filter, world units, one for each Gaussian; 0 where there is none. Submits and waits.
///
/// # Safety
/// `renderer` and `scene` are alive, `sizes` has room for the scene's Gaussians.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_filters(
    renderer: *mut AshsplatRenderer,
    scene: *const AshsplatScene,
    sizes: *mut f32,
) -> AshsplatStatus {
    guarded!({
        let (renderer, scene) = (borrowed_mut(renderer, "renderer")?, borrowed(scene, "scene")?);
        check_pointer(sizes, "sizes")?;
        fill(sizes, &renderer.0.with_scene(&scene.scene, |renderer| renderer.filters())?);
        Ok(())
    })
}
