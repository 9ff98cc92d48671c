//! A block of a scene: its trained core and the frozen Gaussians around it.
//!
//! Frames show both, so that pictures are whole and photographs need no mask. Frozen Gaussians only have parameters on the
//! device: no moments and no statistics.

use super::settings::TrainSettings;
use crate::error::{Error, Result};
use crate::passes::densify::MaskOutside;
use crate::scene::camera::{EDGE_MARGIN, Linearised, NEAR_PLANE};
use crate::scene::{Bounds, Camera, Fingerprint, Gaussians};
use crate::vk::Context;
use glam::{DVec2, DVec3, Vec3};

/// A block of a scene, with the frozen Gaussians around it.
///
/// All initial Gaussians are trained, also those outside the core. Only Gaussians in the core are cloned or split. Their halves
/// and later movement can cross its border.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneBlock {
    /// Box in which density control adds Gaussians, world units. Sides may be infinite.
    pub core: Bounds,
    /// Gaussians that are drawn but not trained; may be empty. SH coefficients above the settings' degree are dropped.
    pub frozen: Gaussians,
    /// Count and hash of all surroundings before [`SceneBlock::without_invisible`] dropped some. Checkpoints are compared by
    /// these.
    pub chosen_from: Option<Surroundings>,
}

/// Count and hash of the Gaussians around a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Surroundings {
    /// Number of Gaussians.
    pub count: u64,
    /// Hash of the Gaussians.
    pub fingerprint: u64,
}

impl SceneBlock {
    /// Divides a scene into the Gaussians to train and a block with all others. Trained are the means in the core, grown by
    /// `margin` (world units) on all sides. Both parts keep their order.
    ///
    /// # Errors
    /// Same as [`SceneBlock::check_box`]; [`Error::Argument`] if no Gaussian is to be trained.
    pub fn divide(scene: &Gaussians, core: Bounds, margin: f32) -> Result<(Gaussians, Self)> {
        Self::check_box(core, margin)?;
        let inside = |&index: &usize| Self::contains(core, margin, scene.means[index]);
        let (trained, frozen): (Vec<usize>, Vec<usize>) = (0..scene.len()).partition(inside);
        if trained.is_empty() {
            return Err(Self::nothing_inside(scene.len()));
        }
        let frozen = scene.select(&frozen);
        Ok((scene.select(&trained), Self { core, frozen, chosen_from: None }))
    }

    /// True if [`SceneBlock::divide`] trains a Gaussian with this mean.
    pub fn contains(core: Bounds, margin: f32, mean: [f32; 3]) -> bool {
        let mean = Vec3::from_array(mean);
        mean.cmpge(core.min - margin).all() && mean.cmple(core.max + margin).all()
    }

    /// Drops the surroundings that no picture of these cameras can show, at any size at which a training with these settings
    /// draws them. The pictures keep their bits, and so does the training, with two exceptions.
    /// [Dropout](TrainSettings::dropout) draws its random numbers by row, and growth that memory limits gets more of it. A
    /// checkpoint of either block can be resumed with the other. With [the 3D filter](TrainSettings::filter_3d) nothing is
    /// dropped, because its sizes depend on all surroundings.
    #[must_use]
    pub fn without_invisible(self, cameras: &[Camera], settings: &TrainSettings) -> Self {
        if settings.filter_3d {
            return self;
        }
        let drawn: Vec<Camera> = cameras.iter().flat_map(|camera| settings.sizes_of_camera(camera)).collect();
        let seen = seen(&self.frozen, &drawn, settings.kernel_size);
        let rows: Vec<usize> = (0..seen.len()).filter(|&row| seen[row]).collect();
        if rows.len() == seen.len() {
            return self;
        }
        let chosen_from = Some(self.surroundings());
        Self { frozen: self.frozen.select(&rows), chosen_from, ..self }
    }

    /// Count and hash of all surroundings, drawn or dropped.
    pub fn surroundings(&self) -> Surroundings {
        let all =
            || Surroundings { count: self.frozen.len() as u64, fingerprint: fingerprint_of(&self.frozen) };
        self.chosen_from.unwrap_or_else(all)
    }

    /// True if the core has no border.
    pub fn is_everything(core: Bounds) -> bool {
        core.min == Vec3::NEG_INFINITY && core.max == Vec3::INFINITY
    }

    /// Refuses a core without volume or with a NaN side, and a margin that is negative or not finite.
    pub fn check_box(core: Bounds, margin: f32) -> Result<()> {
        // False for NaN.
        if !core.min.cmplt(core.max).all() {
            let problem =
                format!("from {} to {}: each least side must be below the greatest", core.min, core.max);
            return Err(Error::argument("block", problem));
        }
        if !(margin.is_finite() && margin >= 0.0) {
            return Err(Error::argument("margin", format!("is {margin}, must be 0 or more")));
        }
        Ok(())
    }

    /// Error for a block without a Gaussian to train.
    pub fn nothing_inside(of: usize) -> Error {
        let problem =
            format!("has none of the {of} Gaussians of the start in it; give another box or margin");
        Error::argument("block", problem)
    }

    /// Block of a checkpoint; None if it is the whole scene.
    pub(super) fn state(&self) -> Option<BlockState> {
        let Surroundings { count, fingerprint } = self.surroundings();
        let whole = count == 0 && Self::is_everything(self.core);
        let core = [self.core.min.to_array(), self.core.max.to_array()];
        (!whole).then_some(BlockState { core, frozen: count, fingerprint })
    }
}

/// Block of a checkpoint: see [`SceneBlock`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockState {
    /// The core's corners, world units.
    pub core: [[f32; 3]; 2],
    /// Number of frozen Gaussians around the core.
    pub frozen: u64,
    /// Hash of the frozen Gaussians.
    pub fingerprint: u64,
}

impl BlockState {
    /// Difference between the block of a checkpoint and that of a run; None if they are equal.
    pub(super) fn difference(there: Option<&Self>, here: Option<&Self>) -> Option<String> {
        if there == here {
            return None;
        }
        if let (Some(there), Some(here)) = (there, here)
            && there.core == here.core
        {
            return Some(format!(
                "was made among {} other Gaussians around the block, here are {} (of another scene or margin)",
                there.frozen, here.frozen
            ));
        }
        let name = |state: Option<&Self>| match state {
            None => "the whole scene".to_owned(),
            Some(Self { core, .. }) => {
                let sides: Vec<String> = core.as_flattened().iter().map(f32::to_string).collect();
                format!("the block {}", sides.join(","))
            }
        };
        Some(format!("was made for {}, here {} is trained", name(there), name(here)))
    }
}

fn fingerprint_of(gaussians: &Gaussians) -> u64 {
    let mut print = Fingerprint::new();
    print.add(bytemuck::cast_slice(&gaussians.means));
    print.add(bytemuck::cast_slice(&gaussians.quats));
    print.add(bytemuck::cast_slice(&gaussians.log_scales));
    print.add(bytemuck::cast_slice(&gaussians.opacity_logits));
    print.add(bytemuck::cast_slice(&gaussians.sh));
    print.finish()
}

/// Number of standard deviations beyond which alpha is below 1/255 for any opacity, even one that dropout raises.
const REACH: f64 = 4.0;
/// Margin for rounding, pixels.
const ROUNDING_PX: f64 = 1.0;
/// Margin for rounding, as a share of the numbers from which a position is computed.
const ROUNDING: f64 = 1e-6;
/// A camera, for a bound of what its picture shows, in double precision: a Gaussian counts as visible if a ball of its largest
/// axis may reach a pixel. So dropping the others changes no bit of any picture.
struct VisibilityBound<'a> {
    camera: &'a Camera,
    /// Minimum absolute slopes with which Gaussians are linearised. Above 0 only if the optical axis lies far outside the whole
    /// picture.
    min_slope: DVec2,
}

impl<'a> VisibilityBound<'a> {
    fn of(camera: &'a Camera) -> Self {
        let slope_bound = |[low, high]: [f64; 2]| {
            if low > 0.0 {
                high
            } else if high < 0.0 {
                -low
            } else {
                0.0
            }
        };
        let slopes = camera.shown_slopes(EDGE_MARGIN).unwrap_or_default();
        Self { camera, min_slope: DVec2::from_array(slopes.map(slope_bound)) }
    }

    /// True if the picture may show a Gaussian with this mean and largest axis (a standard deviation), world units, under a
    /// low-pass filter of this variance. True if a number is NaN.
    fn may_show(&self, mean: DVec3, axis: f64, low_pass_px2: f64) -> bool {
        let Camera { camera_from_world, translation, width, height, .. } = *self.camera;
        if self.camera.has_lens() {
            // The bound below is that of the Jacobian; the unscented transform may draw a Gaussian farther away.
            return true;
        }
        let translation = translation.as_dvec3();
        let place = camera_from_world.as_dmat3() * mean + translation;
        let rounding = ROUNDING * (mean.abs().max_element() + translation.abs().max_element());
        if place.z < 0.999 * f64::from(NEAR_PLANE) - rounding {
            return false;
        }
        let Linearised { pixel, per_unit, slope } = self.camera.linearised(place);
        // |row of J W R S|² is at most |row of J W|² times the square of the largest axis.
        let slope = slope.abs().max(self.min_slope);
        let variance = per_unit * per_unit * (1.0 + slope * slope) * (axis * axis) + low_pass_px2;
        let rounding = ROUNDING_PX + ROUNDING * pixel.abs() + rounding * per_unit * (1.0 + slope);
        let half = REACH * DVec2::new(variance.x.sqrt(), variance.y.sqrt()) + rounding;
        let size = DVec2::new(width.into(), height.into());
        !((pixel + half).cmplt(DVec2::ZERO).any() || (pixel - half).cmpgt(size).any())
    }
}

/// Per Gaussian: true if any of the cameras may show it, under a low-pass filter of this variance on the screen (px²) and
/// without the 3D filter.
pub(super) fn seen(gaussians: &Gaussians, cameras: &[Camera], low_pass_px2: f64) -> Vec<bool> {
    let sights: Vec<VisibilityBound<'_>> = cameras.iter().map(VisibilityBound::of).collect();
    let rows: Vec<usize> = (0..gaussians.len()).collect();
    // The same cameras show neighbours, so each search begins with the last one found.
    in_threads(&rows, 0, |last, &row| {
        let axis = gaussians.log_scales[row].into_iter().fold(f32::NEG_INFINITY, f32::max);
        let (mean, axis) = (DVec3::from_array(gaussians.means[row].map(f64::from)), f64::from(axis).exp());
        let mut order = (*last..sights.len()).chain(0..(*last).min(sights.len()));
        let found = order.find(|&sight| sights[sight].may_show(mean, axis, low_pass_px2));
        *last = found.unwrap_or(*last);
        found.is_some()
    })
}

/// Maps items in several threads, each with a state that begins as `state`.
pub(super) fn in_threads<T: Sync, S: Clone + Send, R: Clone + Default + Send>(
    items: &[T],
    state: S,
    map: impl Fn(&mut S, &T) -> R + Sync,
) -> Vec<R> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let share = items.len().div_ceil(threads).max(1);
    let mut results = vec![R::default(); items.len()];
    std::thread::scope(|scope| {
        for (results, items) in results.chunks_mut(share).zip(items.chunks(share)) {
            let (mut state, map) = (state.clone(), &map);
            scope.spawn(move || {
                results.iter_mut().zip(items).for_each(|(to, item)| *to = map(&mut state, item))
            });
        }
    });
    results
}

pub(super) struct Block {
    /// State for the checkpoint.
    pub state: BlockState,
    /// None if the core has no border.
    pub mask: Option<MaskOutside>,
}

impl Block {
    /// None if the block is the whole scene.
    pub fn new(context: &Context, block: &SceneBlock) -> Result<Option<Self>> {
        let Some(state) = block.state() else { return Ok(None) };
        let bordered = !SceneBlock::is_everything(block.core);
        let mask = bordered.then(|| MaskOutside::new(context, block.core)).transpose()?;
        Ok(Some(Self { state, mask }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Intrinsics;
    use glam::{Vec3, vec3};

    fn scene(xs: &[f32]) -> Gaussians {
        let means: Vec<[f32; 3]> = xs.iter().map(|&x| [x, 0.0, 0.0]).collect();
        Gaussians { opacity_logits: xs.to_vec(), ..gaussians(&means, 0.0) }
    }

    fn bounds(min: f32, max: f32) -> Bounds {
        Bounds { min: Vec3::splat(min), max: Vec3::splat(max) }
    }

    #[test]
    fn a_scene_is_divided_at_the_margin() -> Result<()> {
        let whole = scene(&[-3.0, 0.5, -1.5, 1.0, 9.0]);
        let (trained, block) = SceneBlock::divide(&whole, bounds(-1.0, 1.0), 0.5)?;
        assert_eq!(trained.opacity_logits, [0.5, -1.5, 1.0]);
        assert_eq!(block.frozen.opacity_logits, [-3.0, 9.0]);
        let state = block.state();
        assert_eq!(state.map(|state| state.frozen), Some(2));
        let (all, rest) = SceneBlock::divide(&whole, bounds(f32::NEG_INFINITY, f32::INFINITY), 2.0)?;
        assert!(all == whole && rest.frozen.is_empty() && rest.state().is_none());
        // A border counts even if nothing lies beyond it yet.
        assert!(SceneBlock::divide(&whole, bounds(-99.0, 99.0), 0.0)?.1.state().is_some());
        Ok(())
    }

    fn seen_by(gaussians: &Gaussians, cameras: &[Camera]) -> Vec<bool> {
        seen(gaussians, cameras, 0.3)
    }

    fn gaussians(means: &[[f32; 3]], log_scale: f32) -> Gaussians {
        let count = means.len();
        Gaussians {
            sh_degree: 0,
            means: means.to_vec(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
            log_scales: vec![[log_scale, -9.0, -9.0]; count],
            opacity_logits: vec![2.0; count],
            sh: vec![[0.0; 3]; count],
        }
    }

    fn camera() -> Camera {
        let intrinsics = Intrinsics::from_fov_x(std::f32::consts::FRAC_PI_2, 200, 100);
        Camera::look_at(vec3(0.0, 0.0, -5.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
    }

    /// At depth 5, the picture is from -5 to 5 in x and -2.5 to 2.5 in y; a pixel is 0.05.
    #[test]
    fn gaussians_beside_or_behind_are_out_of_view() {
        let means = [
            [0.0, 0.0, 0.0],
            [5.5, 0.0, 0.0],
            [-5.5, 0.0, 0.0],
            [0.0, 3.0, 0.0],
            [0.0, 0.0, -5.0],
            [0.0, 0.0, -9.0],
            [4.9, 2.4, 0.0],
        ];
        let small = seen_by(&gaussians(&means, -7.0), &[camera()]);
        assert_eq!(small, [true, false, false, false, false, false, true]);
        // With an axis of 0.2, four of them reach 0.8, and more with the slope.
        let large = seen_by(&gaussians(&means, 0.2_f32.ln()), &[camera()]);
        assert_eq!(large, [true, true, true, true, false, false, true]);
        assert_eq!(seen_by(&gaussians(&means, -7.0), &[]), [false; 7]);
        assert!(seen_by(&gaussians(&[], 0.0), &[camera()]).is_empty());
        // A low-pass filter of 10 px² reaches 4 times 3.2 pixels, which are 0.63.
        assert_eq!(seen(&gaussians(&means, -7.0), &[camera()], 10.0)[..4], [true, true, true, true]);
        // Linearised as at the edge of a picture that looks aside: x from 10 to 20, and 4 sqrt(1 + 4.3²) 0.2 beyond.
        let aside = Camera { cx: -200.0, ..camera() };
        let beside = [[6.5, 0.0, 0.0], [5.0, 0.0, 0.0]];
        assert_eq!(seen_by(&gaussians(&beside, 0.2_f32.ln()), &[aside]), [true, false]);
    }

    #[test]
    fn any_camera_counts_and_its_part_only() {
        let left = camera().part([0, 0], [64, 100]).expect("a part");
        let means = [[-3.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        assert_eq!(seen_by(&gaussians(&means, -7.0), &[left]), [true, false]);
        let right = camera().part([136, 0], [64, 100]).expect("a part");
        assert_eq!(seen_by(&gaussians(&means, -7.0), &[left, right]), [true, true]);
        // A unit is 100 pixels there, at any depth.
        let near = [[0.5, 0.0, 0.0], [3.0, 0.0, 0.0]];
        assert_eq!(seen_by(&gaussians(&near, -7.0), &[camera().orthographic()]), [true, false]);
        assert_eq!(seen_by(&gaussians(&[[f32::NAN; 3]], -7.0), &[left]), [true]);
    }

    #[test]
    fn senseless_boxes_are_refused() {
        let whole = scene(&[0.0]);
        for (core, margin) in [
            (bounds(1.0, -1.0), 0.0),
            (bounds(0.0, 0.0), 0.0),
            (bounds(f32::NAN, 1.0), 0.0),
            (bounds(-1.0, 1.0), -0.1),
            (bounds(-1.0, 1.0), f32::NAN),
            (bounds(-1.0, 1.0), f32::INFINITY),
            (bounds(3.0, 4.0), 1.0),
        ] {
            assert!(SceneBlock::divide(&whole, core, margin).is_err(), "{core:?} {margin}");
        }
    }

    #[test]
    fn what_differs_is_named() {
        let state = BlockState { core: [[-1.0; 3], [1.0; 3]], frozen: 7, fingerprint: 3 };
        let differs =
            |here: Option<&BlockState>| BlockState::difference(Some(&state), here).unwrap_or_default();
        assert_eq!(differs(Some(&state)), "");
        assert!(differs(None).contains("-1,-1,-1,1,1,1"));
        assert!(differs(Some(&BlockState { core: [[-2.0; 3], [1.0; 3]], ..state })).contains("-2,-2,-2,1"));
        assert!(differs(Some(&BlockState { fingerprint: 4, ..state })).contains("7 other Gaussians"));
        assert!(BlockState::difference(None, Some(&state)).is_some());
        assert!(BlockState::difference(None, None).is_none());
    }
}
