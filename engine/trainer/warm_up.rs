//! Frames at a quarter and at half of the photographs' size at the start of a run (paper, section 7.1), and the photographs to
//! compare them with. Photographs also get the random background of an iteration.

use super::settings::TrainSettings;
use crate::error::Result;
use crate::kernels::pixels::photo_reduced;
use crate::loss::{Windowing, photo_bytes};
use crate::plan::{LaunchSizes, Strips, blocks};
use crate::scene::{Camera, PicturePart};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Divisors of width and height: at the start and at the end of the warm-up.
const FACTORS: [u32; 2] = [4, 2];
/// Minimum width and height of a reduced picture, pixels: four tiles by four.
const LEAST_SIDE: u32 = 64;

/// Kernels that reduce photographs and compose transparent ones over random backgrounds.
pub(super) struct PhotoPreparation {
    sizes: LaunchSizes,
    /// True if photographs may keep their size.
    whole: bool,
    /// For opaque, masked and transparent photographs.
    kernels: [Kernel<photo_reduced::Interface>; 3],
}

/// Inputs of the preparation of a photograph.
pub(super) struct PhotoInputs<'a> {
    /// Camera of the photograph, and camera of the frame.
    pub cameras: [&'a Camera; 2],
    pub photo: &'a Buffer,
    pub masked: bool,
    /// Change of the background (r, g, b) of a transparent photograph; None for others.
    pub background_change: Option<[f32; 3]>,
}

/// Camera of a picture with 1 / `factor` of the width and height: its pixels are squares of `factor` pixels. The remainder at
/// the right and at the bottom is cut off.
fn reduced(camera: &Camera, factor: u32) -> Camera {
    let by = factor as f32;
    let part = camera.part.map(|part| PicturePart {
        left: part.left / factor,
        top: part.top / factor,
        whole_width: part.whole_width / factor,
        whole_height: part.whole_height / factor,
    });
    Camera {
        part,
        fx: camera.fx / by,
        fy: camera.fy / by,
        cx: camera.cx / by,
        cy: camera.cy / by,
        width: camera.width / factor,
        height: camera.height / factor,
        ..*camera
    }
}

impl TrainSettings {
    /// Last iteration of the warm-up: `warm_up`, but at most half of the iterations.
    pub fn warm_up_end(&self) -> u32 {
        self.warm_up.min(self.iterations / 2)
    }

    /// Camera that draws a view at an iteration (1-based). It has a quarter of the size up to half of
    /// [the warm-up](Self::warm_up_end), and half of the size up to its end. It is reduced less if a side would have fewer than
    /// 64 pixels. The first iteration is whole, because it shows the memory that whole frames take.
    pub fn warm_up_camera(&self, iteration: u32, camera: &Camera) -> Camera {
        let end = self.warm_up_end();
        let wanted = match iteration {
            _ if iteration > end || iteration <= 1 => 1,
            _ if iteration > end / 2 => FACTORS[1],
            _ => FACTORS[0],
        };
        let fits = |&factor: &u32| factor <= wanted && camera.width.min(camera.height) / factor >= LEAST_SIDE;
        FACTORS.into_iter().find(fits).map_or(*camera, |factor| reduced(camera, factor))
    }

    /// Camera of a view at all sizes that training draws, its own first.
    pub(super) fn sizes_of_camera(&self, camera: &Camera) -> Vec<Camera> {
        let of = |iteration: u32| self.warm_up_camera(iteration, camera);
        let mut sizes = vec![*camera, of(2), of(self.warm_up_end())];
        sizes.dedup();
        sizes
    }
}

/// Estimates the instances of a frame at the size of `camera` from a frame of `drawn` with these instances and visible
/// Gaussians. Assumes square footprints of equal size.
pub(super) fn whole_instances([camera, drawn]: [&Camera; 2], instances: u32, visible: u32) -> u32 {
    let factor = f64::from(camera.width / drawn.width);
    let tiles = f64::from(instances) / f64::from(visible.max(1));
    let side = 1.0 + factor * (tiles.max(1.0).sqrt() - 1.0);
    (f64::from(visible) * side * side).max(f64::from(instances)).min(f64::from(u32::MAX)) as u32
}

impl PhotoPreparation {
    /// None unless the settings have a warm-up or random backgrounds.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Option<Self>> {
        let whole = settings.random_background;
        if settings.warm_up == 0 && !whole {
            return Ok(None);
        }
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        let kernel = |masked, transparent| {
            Kernel::new(context, &photo_reduced::Spec { workgroup_size, strips, masked, transparent })
        };
        let kernels = [kernel(false, false)?, kernel(true, false)?, kernel(true, true)?];
        Ok(Some(Self { sizes, whole, kernels }))
    }

    /// Name and bytes of a prepared photograph, for photographs of these sizes (width, height).
    pub fn request(&self, sizes: &[(u32, u32)]) -> (&'static str, u64) {
        let windowing = if self.sizes.strips { Windowing::Sweeps } else { Windowing::Blocks };
        let factor = if self.whole { 1 } else { FACTORS[1] };
        let bytes =
            |&(width, height): &(u32, u32)| photo_bytes(windowing, width / factor, height / factor, true);
        ("prepared_photo", sizes.iter().map(bytes).max().unwrap_or(0).max(4))
    }

    /// Records the photograph for a frame of its camera, or of a smaller one of [`TrainSettings::warm_up_camera`]. The caller
    /// places barriers before and after.
    pub fn record(&self, r: &mut Recorder, inputs: &PhotoInputs, prepared: &Buffer) {
        let PhotoInputs { cameras: [camera, drawn], photo, masked, background_change } = *inputs;
        let Camera { width, height, .. } = *drawn;
        let words = match self.sizes.strips {
            true => (if masked { 4 } else { 3 }) * Strips { width, height }.values() / 4,
            false => u64::from(width) * u64::from(height),
        };
        let push = photo_reduced::Push {
            image_width: camera.width,
            image_height: camera.height,
            factor: camera.width / width,
            background_change: background_change.unwrap_or_default(),
        };
        let form = if background_change.is_some() { 2 } else { usize::from(masked) };
        let groups = blocks(words, self.sizes.elementwise_workgroup.into());
        let bind = photo_reduced::Bind { photo, reduced: prepared };
        r.dispatch(&self.kernels[form], &bind, &push, groups);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Intrinsics;
    use glam::{Mat3, Vec3};

    #[test]
    fn pictures_are_a_quarter_then_half_then_whole() {
        let settings = TrainSettings { warm_up: 500, ..TrainSettings::default() };
        let of = |width, height| Camera {
            fx: 300.0,
            fy: 310.0,
            cx: 151.0,
            cy: 99.0,
            width,
            height,
            ..Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, Intrinsics::from_fov_x(1.0, width, height))
        };
        let size = |iteration, camera: &Camera| {
            let drawn = settings.warm_up_camera(iteration, camera);
            (drawn.width, drawn.height)
        };
        let camera = of(303, 259);
        for (iterations, expected) in
            [([2, 250], (75, 64)), ([251, 500], (151, 129)), ([501, 9999], (303, 259))]
        {
            assert_eq!(iterations.map(|iteration| size(iteration, &camera)), [expected; 2]);
        }
        let drawn = settings.warm_up_camera(2, &camera);
        assert_eq!([drawn.fx, drawn.fy, drawn.cx, drawn.cy], [75.0, 77.5, 37.75, 24.75]);
        let part = of(800, 640).part([160, 80], [400, 320]).expect("a part");
        let whole = settings.warm_up_camera(2, &of(800, 640));
        assert_eq!(settings.warm_up_camera(2, &part), whole.part([40, 20], [100, 80]).expect("its part"));
        // Small photographs are reduced less, or not at all.
        assert_eq!([size(2, &of(303, 255)), size(2, &of(400, 127))], [(151, 127), (400, 127)]);
        assert_eq!(size(1, &camera), (303, 259));
        let without = TrainSettings::default();
        assert_eq!(without.warm_up_camera(2, &camera), camera);
    }

    #[test]
    fn short_runs_have_a_warm_up_of_their_half() {
        let end =
            |iterations| TrainSettings { warm_up: 500, iterations, ..TrainSettings::default() }.warm_up_end();
        assert_eq!([0, 1, 2, 600, 1000, 2000].map(end), [0, 0, 1, 300, 500, 500]);
    }

    #[test]
    fn whole_pictures_have_more_instances() {
        let camera =
            |width| Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, Intrinsics::from_fov_x(1.0, width, width));
        let (whole, quarter) = (camera(400), camera(100));
        // One tile each; two by two tiles, which become five by five; none.
        let estimates = [(70, 70), (400, 100), (0, 0)]
            .map(|(n, visible)| whole_instances([&whole, &quarter], n, visible));
        assert_eq!(estimates, [70, 2500, 0]);
        assert_eq!(whole_instances([&whole, &whole], 123, 70), 123);
        assert_eq!(whole_instances([&whole, &quarter], u32::MAX, 1), u32::MAX);
    }
}
