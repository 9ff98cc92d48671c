//! The set of Gaussians between two steps, for a strategy to read and change.

use super::memory::{Model, PeakCounts, RowMemory};
use super::photos::Photos;
use super::poses::Poses;
use super::schedule::TrainingRun;
use super::settings::TrainSettings;
use crate::error::{Error, Result};
use crate::frame::{
    FrameCapacity, GaussianRange, LaunchSizes, PictureCapacity, RenderSettings, SceneBuffers, ScenePlan,
    SceneSettings, gaussians_with, max_trained_among, max_trained_instances, planes,
};
use crate::kernels::constants::PLANE_ROW;
use crate::passes::adam::Moments;
use crate::passes::densify::{Curve, Densify, EdgePhoto, Gather, Importance, ImportanceBuffers, RandomKey};
use crate::render::{FrameRunner, Renderer, Request, RunError, frozen_capacity};
use crate::scene::Camera;
use crate::scene::camera::middle;
use crate::vk::{Buffer, Context, MemoryKind, Recorder};

/// The Gaussians with their moments and statistics, between two steps.
pub struct Population<'a> {
    pub(super) context: &'a Context,
    pub(super) run: &'a TrainingRun,
    pub(super) rows: &'a RowMemory,
    pub(super) runner: &'a mut FrameRunner,
    pub(super) pictures: &'a mut Renderer,
    pub(super) frozen: &'a [SceneBuffers],
    pub(super) model: &'a mut Model,
    pub(super) photos: &'a Photos,
    /// None unless poses are optimised.
    pub(super) poses: Option<&'a Poses>,
    pub(super) peak: &'a mut PeakCounts,
    pub(super) iteration: u32,
}

/// New planes for a set that exceeds its capacity; nothing for a set that fits.
pub struct Growth(Option<Model>);

impl Population<'_> {
    /// Context of the device.
    pub fn context(&self) -> &Context {
        self.context
    }

    pub(super) fn sizes(&self) -> LaunchSizes {
        LaunchSizes::new(self.context.limits())
    }

    /// The run's settings.
    pub fn settings(&self) -> &TrainSettings {
        &self.run.settings
    }

    /// Extent of the scene, world units.
    pub fn scene_extent(&self) -> f32 {
        self.run.scene_extent
    }

    /// Training cameras as given, without optimised poses.
    pub fn cameras(&self) -> &[Camera] {
        &self.run.cameras
    }

    /// Last iteration, counted from 1.
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// Number of Gaussians.
    pub fn count(&self) -> u32 {
        self.model.scene.count
    }

    /// Parameters of the Gaussians.
    pub fn scene(&self) -> &SceneBuffers {
        &self.model.scene
    }

    /// Adam's moments of the parameters.
    pub fn moments(&self) -> &Moments {
        &self.model.moments
    }

    /// Per Gaussian, since the last change of the set: sum over views of the norm of the 2D mean's gradient (NDC), and number of
    /// views. Views count if [`StepWork::accumulates`](super::schedule::StepWork::accumulates) is set. With
    /// [`Strategy::absolute_gradients`](super::Strategy::absolute_gradients) the norm is that of the absolute gradients:
    /// ‖(W/2 Σ|g_x|, H/2 Σ|g_y|)‖, where g is the gradient with respect to the 2D mean in pixels through one pixel alone (AbsGS,
    /// Ye et al. 2024).
    pub fn statistics(&self) -> &Buffer {
        &self.model.statistics[0]
    }

    /// Frees the buffers of pictures drawn between steps.
    pub fn release_pictures(&mut self) {
        self.pictures.release();
    }

    /// Mean importance of each Gaussian over training views (indices of [`Population::cameras`]): its blending weights at
    /// edges, f32 per Gaussian from 0 to 1. The views are drawn one after the other. None if memory is short. In a view whose
    /// frame does not fit the memory, all have importance 0.
    ///
    /// # Errors
    /// [`Error::Argument`] without views, or for an index that does not exist; when a photograph cannot be read or the device
    /// is lost.
    pub fn importance(&mut self, kernels: &Importance, views: &[usize]) -> Result<Option<Buffer>> {
        let (context, count) = (self.context, self.count());
        let views_exist = !views.is_empty() && views.iter().all(|&view| view < self.run.cameras.len());
        if !views_exist {
            let problem = format!("{views:?} are not some of the {} there are", self.run.cameras.len());
            return Err(Error::argument("views", problem));
        }
        let each = self.run.cameras.iter().map(|camera| u64::from(camera.width) * u64::from(camera.height));
        let requests = ImportanceBuffers::requests(count, each.max().unwrap_or(0));
        let own = [("importance", u64::from(count) * 4)];
        let place = [("photo", self.photos.place_bytes())];
        let allocate = |requests: &[_]| or_none(context.allocate("importance", requests, MemoryKind::Device));
        let (Some(own), Some(place), Some(buffers)) =
            (allocate(&own)?, allocate(&place)?, allocate(&requests)?)
        else {
            return Ok(None);
        };
        let (importance, place) = (&own[0], &place[0]);
        let buffers = ImportanceBuffers::from_allocated(buffers);
        context.run("clear importance", |r| r.fill(importance, 0))?;
        // The weights do not depend on colours.
        let settings = RenderSettings { inverse_depth: false, ..self.run.settings.render_settings() };
        let share = 1.0 / views.len() as f32;
        for &view in views {
            let camera = &self.run.cameras[view];
            let texels = &self.photos.between_steps(context, view, place)?;
            let photo = EdgePhoto {
                texels,
                size: (camera.width, camera.height),
                masked: self.photos.is_masked(view),
                cut_sides: camera.cut_sides(),
            };
            let request = Request {
                scene: &self.model.scene,
                other_scenes: self.frozen,
                camera,
                pose: self.poses.map(|poses| poses.camera(view)),
                settings: &settings,
                of_scenes: &SceneSettings::USUAL,
                sh_degree: 0,
                backward: true,
                last_entries: false,
                hidden_by: None,
            };
            let ran = self.runner.run(&request, |r, inputs| {
                let gradient = &inputs.buffers.image_gradient;
                r.barrier();
                kernels.record_edges(r, &photo, &buffers, gradient);
                r.barrier();
                kernels.record_view(r, inputs, gradient, &buffers, importance, share);
            });
            or_none(ran.map_err(RunError::error))?;
        }
        Ok(Some(importance.clone()))
    }

    /// Space-filling curve of the storage order.
    pub fn curve(&self) -> Curve {
        let middle = middle(self.run.cameras.iter().map(Camera::position)).unwrap_or_default();
        Curve { center: middle.as_vec3(), extent: self.run.scene_extent }
    }

    /// Maximum number of Gaussians for which frames stay within the limits of device and memory. Later frames should stay within
    /// three quarters of the device's instance limit, because views differ. No Gaussian is added if memory cannot hold a frame
    /// with the peak counts so far.
    pub fn max_rows(&self) -> u32 {
        let count = self.count();
        if !self.holds_peak() {
            return count;
        }
        let instances = u64::from(max_trained_instances(self.context.limits())) * 3 / 4;
        let frozen = u64::from(frozen_capacity(self.frozen));
        let all = (u64::from(count) + frozen) * instances / u64::from(self.peak.instances.max(1));
        all.saturating_sub(frozen).clamp(count.into(), u32::MAX.into()) as u32
    }

    /// Allocates planes and a frame for `rows` rows, if they exceed the capacity. Tries a reserve of half, then no reserve,
    /// then the largest capacity that fits, if that is at least a sixteenth larger than the present one. The growth may fall
    /// short of `rows`: see [`Population::capacity_with`].
    pub fn reserve_gaussians(&mut self, rows: u32) -> Result<Growth> {
        let old = self.model.scene.plan.capacity;
        if rows <= old {
            return Ok(Growth(None));
        }
        let max = self.max_rows_that_fit(rows)?;
        let worth_it = old + old / 16;
        // Half more, up to the most that can be trained beside the frozen Gaussians.
        let trainable = max_trained_among(self.context.limits(), frozen_capacity(self.frozen));
        let reserved = rows.saturating_add(rows / 2).min(trainable.max(rows));
        for capacity in [reserved, rows, max] {
            if capacity <= worth_it && capacity < rows {
                continue;
            }
            if let Some(fresh) = or_none(self.allocate_fresh(capacity))? {
                return Ok(Growth(Some(fresh)));
            }
        }
        Ok(Growth(None))
    }

    /// Capacity in Gaussians after a growth.
    pub fn capacity_with(&self, growth: &Growth) -> u32 {
        growth.0.as_ref().unwrap_or(self.model).scene.plan.capacity
    }

    /// Replaces the set by `rows` rows in one submission: either all of it executes or the old set stays. `record_sources`
    /// records a buffer with a word per new row, and ends with a barrier. The word is the index of an old Gaussian; its bits from
    /// `KIND_SHIFT` on say what the row is: kept, clone, first or second half of a split. Statistics are cleared then. Kept Gaussians
    /// keep their moments; those of new ones are zero. Then `record_changes` records changes to the new set, behind a barrier,
    /// from the set and the sources of its rows.
    ///
    /// # Errors
    /// [`Error::Argument`] for more rows than the capacity; when the device is lost.
    pub fn rebuild<'b>(
        &mut self,
        rows: u32,
        growth: Growth,
        kernels: &Densify,
        key: &RandomKey,
        record_sources: impl FnOnce(&mut Recorder, &SceneBuffers) -> &'b Buffer,
        record_changes: impl FnOnce(&mut Recorder, &SceneBuffers, &Moments, &Buffer),
    ) -> Result<()> {
        let capacity = self.capacity_with(&growth);
        if rows > capacity {
            let problem = format!("are {rows}, the capacity is {capacity}");
            return Err(Error::argument("rows", problem));
        }
        let (old, before) = (&*self.model, self.count());
        // A set within its capacity changes in place: each plane moves through another one.
        let (mut new, moved) = match growth.0 {
            Some(new) => (new, Vec::new()),
            None => (old.clone(), self.moved_planes()?),
        };
        new.scene.count = rows;
        self.context.run("densify: gather", |r| {
            let sources = record_sources(r, &old.scene);
            r.fill(&new.statistics[0], 0);
            let gather = Gather { from: &old.scene, to: &new.scene, sources, scratch: &moved };
            kernels.record_gather_parameters(r, &gather, key);
            for (from, to) in old.moment_planes().zip(new.moment_planes()) {
                let gather = Gather { from: &from, to: &to, ..gather };
                kernels.record_gather_moments(r, &gather);
            }
            record_changes(r, &new.scene, &new.moments, sources);
        })?;
        *self.model = new;
        let of_frame = |rows: u32| rows.saturating_add(frozen_capacity(self.frozen));
        *self.peak = self.peak.remembered(of_frame(before), of_frame(rows));
        Ok(())
    }

    /// Keeps these Gaussians, in this order, each once, and removes all others.
    ///
    /// # Errors
    /// [`Error::Argument`] for an index that does not exist or comes twice, and for an empty list; when memory is short or the
    /// device is lost.
    pub fn keep(&mut self, kept: &[u32], kernels: &Densify) -> Result<()> {
        let count = self.count();
        let refuse = |problem: String| Err(Error::argument("Gaussians to keep", problem));
        if kept.is_empty() || kept.len() > count as usize {
            return refuse(format!("are {}, must be 1 to {count}", kept.len()));
        }
        let mut seen = vec![false; count as usize];
        for &index in kept {
            match seen.get_mut(index as usize) {
                None => return refuse(format!("have {index}, there are {count}")),
                Some(true) => return refuse(format!("have {index} twice")),
                Some(seen) => *seen = true,
            }
        }
        let requests = [("sources", kept.len() as u64 * 4)];
        let buffers = self.context.allocate("densify", &requests, MemoryKind::Device)?;
        self.context.upload(&buffers[0], bytemuck::cast_slice(kept))?;
        let key = self.random_key();
        let sources = |r: &mut Recorder, _: &_| {
            r.barrier();
            &buffers[0]
        };
        self.rebuild(kept.len() as u32, Growth(None), kernels, &key, sources, |_, _, _, _| {})
    }

    /// One plane per chunk, in the memory of the frame, which is idle between steps, or in its own if there is no frame.
    fn moved_planes(&self) -> Result<Vec<Buffer>> {
        let (plan, rows) = (&self.model.scene.plan, PLANE_ROW);
        let bytes = u64::from(plan.capacity.next_multiple_of(rows)) * 16;
        let of_frame = self.runner.store.current().map(|frame| frame.moved_plane.clone());
        let all = match of_frame {
            Ok(plane) if plane.bytes() >= bytes => plane,
            _ => self.context.allocate("scratch", &[("moved_plane", bytes)], MemoryKind::Device)?.remove(0),
        };
        let of_chunk = |range: GaussianRange| {
            let [first, count] = [range.first, range.count.next_multiple_of(rows)].map(u64::from);
            all.range(first * 16, count * 16)
        };
        Ok(plan.ranges(plan.capacity).map(of_chunk).collect())
    }

    /// Key of the random numbers after an iteration.
    pub(super) fn random_key(&self) -> RandomKey {
        RandomKey { seed: self.run.settings.seed, iteration: self.iteration }
    }

    /// Memory for the work between two steps. None if memory is short.
    pub(super) fn allocate(&self, requests: &[(&'static str, u64)]) -> Result<Option<Vec<Buffer>>> {
        or_none(self.context.allocate("densify", requests, MemoryKind::Device))
    }

    /// Capacity of the frame for all views, also those not used yet.
    fn frame_capacity(&self) -> FrameCapacity {
        let (frame, all) = (self.runner.store.capacity(), PictureCapacity::of_cameras(&self.run.cameras));
        FrameCapacity { pictures: frame.pictures.and(all), ..frame }
    }

    /// True if planes for `plan` and a frame of its capacity fit beside the current planes. Once those are freed, a frame with
    /// proportionally more visible Gaussians and instances must fit too.
    fn has_room(&self, plan: &ScenePlan) -> bool {
        let (context, frozen, old) = (self.context, frozen_capacity(self.frozen), &self.model.scene.plan);
        let limits = context.limits();
        let (new, present) = (self.rows.bytes(plan), self.rows.bytes(old));
        if plan.capacity > max_trained_among(limits, frozen) || !new.is_offloadable(context) {
            return false;
        }
        let Some((limit, _)) = context.memory_limit() else { return true };
        let (store, frame) = (&self.runner.store, self.frame_capacity());
        let of = |plan: &ScenePlan| gaussians_with(plan.capacity, frozen);
        let grown = FrameCapacity { gaussians: of(plan), ..frame };
        // The visible Gaussians and instances grow with the number of Gaussians.
        let grow = |n: u32, max: u32| {
            let grown = u64::from(n) * u64::from(of(plan)) / u64::from(of(old).max(1));
            grown.min(max.into()) as u32
        };
        let full = FrameCapacity {
            visible: grow(frame.visible, of(plan)),
            instances: grow(frame.instances, max_trained_instances(limits)),
            ..grown
        };
        let beside = (context.held_bytes() + new.device).saturating_sub(store.bytes());
        let during = beside + store.bytes_of(&grown);
        let after = (beside + store.bytes_of(&full)).saturating_sub(present.device);
        during.max(after) <= limit
    }

    /// Largest number of rows, up to `rows`, that fits; at least the current capacity.
    fn max_rows_that_fit(&self, rows: u32) -> Result<u32> {
        let plan = self.model.scene.plan;
        let (mut fits, mut beyond) = (plan.capacity, rows);
        while beyond.saturating_sub(fits) > (plan.capacity / 64).max(1) {
            let middle = fits + (beyond - fits) / 2;
            let plan = self.rows.plan(self.context, middle, plan.sh_degree)?;
            if self.has_room(&plan) { fits = middle } else { beyond = middle }
        }
        Ok(fits)
    }

    /// True if memory holds a frame with the peak counts so far.
    fn holds_peak(&self) -> bool {
        let Some((limit, _)) = self.context.memory_limit() else { return true };
        let frame = self.frame_capacity();
        let visible = self.peak.visible.min(frame.gaussians).max(frame.visible);
        let full = FrameCapacity { visible, instances: self.peak.instances.max(frame.instances), ..frame };
        let beside = self.context.held_bytes().saturating_sub(self.runner.store.bytes());
        full == frame || beside + self.runner.store.bytes_of(&full) <= limit
    }

    /// Allocates planes for parameters and moments with the given capacity, their statistics, and a frame.
    /// An error if they do not fit the memory: the old planes then still exist, but the next step allocates the old frame
    /// again.
    fn allocate_fresh(&mut self, capacity: u32) -> Result<Model> {
        let plan = self.rows.plan(self.context, capacity, self.model.scene.plan.sh_degree)?;
        if !self.has_room(&plan) {
            return Err(Error::argument("densification", "the memory does not suffice"));
        }
        let chunks = planes::allocate(self.context, "scene", self.rows.planes, &plan)?;
        let fresh = Model::allocate(self.context, SceneBuffers { chunks, plan, count: 0 }, self.rows)?;
        self.runner.store.reserve_gaussians(gaussians_with(capacity, frozen_capacity(self.frozen)))?;
        Ok(fresh)
    }
}

/// Returns None if memory is short, and an error if the state of the device is unknown.
fn or_none<T>(result: Result<T>) -> Result<Option<T>> {
    match result {
        Err(error) if !may_have_executed(&error) => Ok(None),
        result => result.map(Some),
    }
}

/// True if the wait for a submission failed: it may or may not have executed.
pub(super) fn may_have_executed(error: &Error) -> bool {
    matches!(
        error,
        Error::DeviceLost { .. } | Error::Timeout { .. } | Error::Vulkan { call: "vkWaitForFences", .. }
    )
}
