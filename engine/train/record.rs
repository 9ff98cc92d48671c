//! Training steps in a host's command buffer. Recording never submits, waits, allocates, maps or reads back.
//!
//! [`Trainer::maintain`] does between steps what recording cannot. It densifies, which needs memory and counts from the device;
//! it resets opacities; and it grows the capacity after an overflow. A step that overflows changes nothing, and neither do the
//! steps recorded after it: the device keeps its overflow flag until then.

use super::memory::{Model, PeakCounts};
use super::schedule::IterationPlan;
use super::step::{InFlight, RecordedSteps, StepOutcome, StepParts, StepReport, StepSlot};
use super::strategy::Densified;
use super::trainer::Trainer;
use crate::error::{Error, Result};
use crate::frame::{FrameCapacity, LaunchSizes, ScenePlan, frame_fits_device, gaussians_with, planes};
use crate::render::{DeviceScene, FrameCounts, Release, frozen_capacity};
use crate::vk::{ForeignCommands, RecordSlot, Recorder, SlotRecording};
use ash::vk;

/// A recorded step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct RecordedStep {
    /// Iteration, counted from 1.
    pub iteration: u32,
    /// Index of the view.
    pub view: usize,
    /// Stages and accesses that the next user of the Gaussians must wait for. There are no images.
    pub release: Release,
}

/// Buffers to allocate in advance for recorded steps: see [`Trainer::reserve_steps`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepReservation {
    /// Number of steps that may be recorded before the first of them has finished. They share the same memory, except for a few
    /// words each.
    pub slots: u32,
    /// Minimum capacity in (tile, Gaussian) instances of a step; 0 for an estimate. [`Trainer::maintain`] grows it.
    pub instances: u32,
    /// Minimum capacity in visible Gaussians, including frozen ones; 0 for an estimate.
    pub visible: u32,
}

impl Default for StepReservation {
    fn default() -> Self {
        Self { slots: 2, instances: 0, visible: 0 }
    }
}

/// Report of [`Trainer::maintain`](super::Trainer::maintain).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Maintenance {
    /// Report of the densification, if one was due.
    pub densified: Option<Densified>,
    /// True if opacities were reset.
    pub opacities_reset: bool,
    /// True if the capacity grew after an overflow.
    pub grown: bool,
    /// Iteration that was skipped, because its frame exceeds the largest possible capacity: see
    /// [`Trainer::step`](super::Trainer::step).
    pub skipped: Option<u32>,
}

impl Trainer {
    /// Builds all kernels and allocates everything that recorded steps need, replacing the previous reservation. Submits and
    /// waits. Before the call, the whole command buffers of all steps must have finished
    /// ([`Context::adopt_commands`](crate::vk::Context::adopt_commands)).
    ///
    /// # Errors
    /// [`Error::Argument`] without slots, for photographs in a file, or while recorded steps are in flight; [`Error::TooLarge`]
    /// if the reservation exceeds the device; memory or device failures.
    pub fn reserve_steps(&mut self, reservation: &StepReservation) -> Result<()> {
        if !(1..=1024).contains(&reservation.slots) {
            return Err(Error::argument("slots", format!("is {}, it may be 1 to 1024", reservation.slots)));
        }
        if !self.photos.are_resident() {
            let problem = "lie in a file: recorded steps need all of them on the device";
            return Err(Error::argument("photographs", problem));
        }
        self.check_none_in_flight()?;
        self.recorded.slots.clear();
        self.recorded.frame_is_ready = false;
        self.runner.store.set_at_least(reservation.visible, reservation.instances);
        for sh_degree in 0..=self.run.settings.sh_degree {
            self.recorder.prepare(sh_degree, &self.run.cameras)?;
        }
        let dispatches = self.step_dispatches();
        let losses = self.recorder.readback_request();
        let slot = |_| StepSlot::new(&self.context, dispatches, losses);
        self.recorded.slots = (0..reservation.slots).map(slot).collect::<Result<_>>()?;
        self.make_ready(true)
    }

    /// Records the next iteration into a host's command buffer. The bits equal those of [`Trainer::step`] on the same context.
    ///
    /// Recording neither submits nor waits, allocates or maps device memory, or reads anything back. Everything is checked
    /// before the first command. The slot is then in flight until the device has executed the recording. Recorded steps must
    /// execute in the order of recording. Between them the host may render [`Trainer::scene`] with
    /// [`Renderer::record`](crate::Renderer::record): in the same queue without a barrier, in another queue behind a semaphore.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved or still in flight; for commands of another device; while
    /// maintenance is due ([`Trainer::maintenance_is_due`]); after the last of
    /// [`TrainSettings::iterations`](crate::TrainSettings); and, like [`Trainer::step`], for a trainer in an unknown state.
    /// [`Error::DeviceLost`] after a loss that the context has noticed.
    pub fn record_step(&mut self, commands: ForeignCommands, slot: u32) -> Result<RecordedStep> {
        self.context.check_alive()?;
        self.state.check_whole()?;
        if !commands.belongs_to(&self.context) {
            return Err(Error::argument("commands", "it belongs to another context"));
        }
        if self.recorded.slots.is_empty() {
            return Err(Error::argument("training steps", "are not reserved: call Trainer::reserve_steps"));
        }
        let index = self.slot_index(slot)?;
        self.recorded.slots[index].recording.check_free()?;
        let is_due = self.maintenance_is_due()?;
        let progress = self.recorded.in_flight.back().map_or(self.state.progress, |last| last.after);
        let all = self.run.settings.iterations;
        // Steps after an overflow are recorded again.
        if progress.iteration >= all && self.recorded.overflow.is_none() {
            let problem = format!("the run is over: its settings have {all} iterations");
            return Err(Error::argument("training step", problem));
        }
        if is_due {
            let problem =
                "maintenance is due first: wait for the steps in flight, then call Trainer::maintain";
            return Err(Error::argument("training step", problem));
        }
        let plan = self.plan_after(&progress);
        self.runner.store.current()?;
        let mut recorder = self.recorded.slots[index].recording.begin(commands, "ashsplat training step")?;
        let slot = &self.recorded.slots[index];
        self.record_plan(&mut recorder, &plan, slot)?;
        let slot = &mut self.recorded.slots[index];
        slot.recording.end(recorder)?;
        slot.outcome = None;
        let (after, gaussians) = (progress.after(&plan), self.state.model.scene.count);
        self.recorded.in_flight.push_back(InFlight { slot: index, plan, after, gaussians });
        let release = Release {
            stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
            accesses: vk::AccessFlags2::SHADER_STORAGE_WRITE,
            ..Release::default()
        };
        Ok(RecordedStep { iteration: plan.iteration, view: plan.view, release })
    }

    /// Records a step, and copies of its counts and loss to the slot's host-readable memory.
    fn record_plan(&self, r: &mut Recorder, plan: &IterationPlan, slot: &StepSlot) -> Result<()> {
        let (run, model, strategy) = (&self.run, &self.state.model, &*self.strategy);
        let (photos, maps, memory) = (&self.photos, &self.maps, &self.losses);
        let (filter, poses, frozen) = (self.filter.as_ref(), self.poses.as_ref(), &self.frozen);
        let parts = StepParts { run, model, frozen, photos, maps, memory, strategy, filter, poses, plan };
        self.runner.record(r, &parts.frame(self.recorder.hides_masked_tiles()), |r, inputs| {
            self.recorder.record(r, inputs, &parts, &slot.losses);
            r.barrier();
            r.copy(&inputs.buffers.state, &slot.counts);
        })
    }

    fn check_none_in_flight(&mut self) -> Result<()> {
        match self.settle()? {
            0 => Ok(()),
            _ => Err(Error::argument("training steps", "are in flight: wait for them first")),
        }
    }

    /// Updates the state from recorded steps that have finished. Returns the number still in flight. Never waits.
    pub fn settle(&mut self) -> Result<u32> {
        let settled = self.settle_finished();
        self.state.broken |= settled.is_err();
        settled
    }

    fn settle_finished(&mut self) -> Result<u32> {
        self.forget_discarded()?;
        while let Some(first) = self.recorded.in_flight.front() {
            let slot = &mut self.recorded.slots[first.slot];
            if !slot.recording.finished()? {
                break;
            }
            let counts = slot.counts()?;
            slot.outcome = Some(if counts.overflow {
                let [_, max] = self.recorded.overflow.get_or_insert([counts; 2]);
                max.visible_needed = max.visible_needed.max(counts.visible_needed);
                max.instances = max.instances.max(counts.instances);
                max.longest_tile = max.longest_tile.max(counts.longest_tile);
                StepOutcome::Overflowed {
                    iteration: first.plan.iteration,
                    visible_needed: counts.visible_needed,
                    visible_capacity: self.runner.store.capacity().visible,
                    instances_needed: counts.instances,
                    instance_capacity: self.runner.store.capacity().instances,
                }
            } else {
                self.state.done(first.after, PeakCounts::of_whole_frame(&first.plan, &self.run, &counts));
                let losses = self.recorder.read_losses(&slot.losses)?;
                if first.plan.lens_rate > 0.0
                    && let Some(lenses) = &mut self.lens_opt
                {
                    lenses.step(&mut self.run.cameras, &first.plan, &losses);
                    self.recorded.frame_is_ready = false;
                }
                StepOutcome::Done(StepReport::new(&first.plan, first.gaussians, &losses, &counts))
            });
            self.recorded.in_flight.pop_front();
        }
        Ok(self.recorded.in_flight.len() as u32)
    }

    /// Forgets steps whose command buffers were discarded.
    fn forget_discarded(&mut self) -> Result<()> {
        let RecordedSteps { slots, in_flight, .. } = &mut self.recorded;
        let is_recorded = |step: &InFlight| slots[step.slot].recording.is_recorded();
        let Some(first) = in_flight.iter().position(|step| !is_recorded(step)) else { return Ok(()) };
        let discarded = in_flight.range(first..);
        let recorded_behind = discarded.clone().any(is_recorded);
        let late = discarded.clone().any(|step| slots[step.slot].recording.was_discarded_late());
        if !recorded_behind {
            in_flight.truncate(first);
        }
        let problem = match (recorded_behind, late) {
            (true, _) => {
                "a step was thrown away, but not those recorded behind it; continue from a checkpoint"
            }
            (false, true) => "a step was discarded after it had been executed; continue from a checkpoint",
            (false, false) => return Ok(()),
        };
        self.state.broken = true;
        Err(Error::argument("training steps", problem))
    }

    /// Outcome of a slot's last step; None without a step, or while it is in flight. Never waits.
    pub fn step_outcome(&mut self, slot: u32) -> Result<Option<StepOutcome>> {
        self.settle()?;
        let index = self.slot_index(slot)?;
        let slot = &mut self.recorded.slots[index];
        // Times cannot be read while steps are recorded: see `RecordSlot::has_times`.
        if let Some(StepOutcome::Done(report)) = &mut slot.outcome
            && report.scopes.is_empty()
        {
            if !slot.recording.has_times()? {
                return Ok(None);
            }
            report.scopes = slot.recording.times()?;
        }
        Ok(slot.outcome.clone())
    }

    /// True if [`Trainer::maintain`] must be called before another step can be recorded. Never waits.
    pub fn maintenance_is_due(&mut self) -> Result<bool> {
        self.settle()?;
        let recorded = &self.recorded;
        let due = recorded.in_flight.back().map_or(self.state.progress, |last| last.after).due;
        let gaussians = gaussians_with(self.state.model.scene.plan.capacity, frozen_capacity(&self.frozen));
        let fits = self.runner.store.capacity().gaussians >= gaussians;
        // The host moves the lens after each step.
        let moves_lens = |last: &InFlight| last.plan.lens_rate > 0.0;
        let lens_is_due = self.lens_opt.is_some() && recorded.in_flight.back().is_some_and(moves_lens);
        Ok(!due.is_empty() || recorded.overflow.is_some() || !recorded.frame_is_ready || !fits || lens_is_due)
    }

    /// Does the work that recorded steps cannot. It densifies and resets opacities if the previous iteration requested it.
    /// After an overflow it grows the capacity, or skips the step if the capacity cannot grow enough. Submits, waits and
    /// allocates; does nothing if nothing is due. The command buffers of all recorded steps must have finished
    /// ([`Context::adopt_commands`](crate::vk::Context::adopt_commands)).
    ///
    /// Afterwards the Gaussians are in another set of buffers: call [`Trainer::scene`] again.
    ///
    /// # Errors
    /// [`Error::Argument`] while recorded steps are in flight or without a queue; same as [`Trainer::step`].
    pub fn maintain(&mut self) -> Result<Maintenance> {
        self.state.check_whole()?;
        self.check_none_in_flight()?;
        if !self.maintenance_is_due()? {
            return Ok(Maintenance::default());
        }
        let done = self.run_maintenance();
        self.state.note_failure(&done);
        done
    }

    fn run_maintenance(&mut self) -> Result<Maintenance> {
        let mut done = Maintenance::default();
        self.recorded.frame_is_ready = false;
        // The slots hold buffers that are replaced now.
        self.recorded.slots.iter_mut().try_for_each(|slot| slot.recording.release())?;
        if let Some([first, max]) = self.recorded.overflow {
            // For all steps, or else for the first. If even that does not fit, it is skipped.
            let grown = match self.runner.store.grow(&max) {
                Err(Error::TooLarge { .. }) => self.runner.store.grow(&first),
                grown => grown,
            };
            match grown {
                Ok(grown) => done.grown = grown,
                Err(error) => {
                    let progress = self.state.progress;
                    let plan = self.plan_after(&progress);
                    self.skip(&plan, &first, error)?;
                    done.skipped = Some(plan.iteration);
                }
            }
            self.recorded.overflow = None;
        }
        let changes = self.catch_up()?;
        done.densified = changes.densified;
        done.opacities_reset = changes.opacities_reset;
        self.make_ready(false)?;
        Ok(done)
    }

    /// Allocates buffers for all views, clears the contents of earlier frames, and makes slots for the dispatches. Recordings
    /// that are never submitted create all objects that are otherwise made on first use.
    fn make_ready(&mut self, every_view: bool) -> Result<()> {
        let drawn = self.recorder.base_settings();
        let (plan, sh_degree) = (&self.state.model.scene.plan, self.run.settings.sh_degree);
        self.runner.reserve(plan, &self.frozen, &self.run.cameras, sh_degree, &drawn)?;
        let frame = self.runner.store.current()?;
        self.context.run("clear state", |r| r.fill(&frame.state, 0))?;
        let dispatches = self.step_dispatches();
        for slot in self.recorded.slots.iter_mut().filter(|slot| slot.dispatches < dispatches) {
            slot.recording = RecordSlot::new(&self.context, dispatches)?;
            slot.dispatches = dispatches;
        }
        let progress = self.state.progress;
        let plan = self.plan_after(&progress);
        // Views differ only in their photographs, which stay in place.
        let views = if every_view { 0..self.run.cameras.len() } else { plan.view..plan.view + 1 };
        if let Some(slot) = self.recorded.slots.first() {
            for view in views {
                let camera = self.run.cameras[view];
                // One reduced size represents all: they have the same buffers.
                let first = self.run.settings.warm_up_camera(2, &camera);
                let cameras = if first == camera { vec![camera] } else { vec![first, camera] };
                for camera in cameras {
                    let mut recorder = self.context.begin("rehearsal")?;
                    let plan = plan.rehearsal(view, camera);
                    self.record_plan(&mut recorder, &plan, slot)?;
                    recorder.check()?;
                }
            }
        }
        self.recorded.frame_is_ready = true;
        Ok(())
    }

    /// Maximum number of dispatches in a step.
    fn step_dispatches(&self) -> usize {
        const PER_STEP: u32 = 64;
        // Per chunk of parameters: culling, projection, its backward pass, the optimiser, the strategy's update, and two terms of
        // the loss. Chunks of frozen
        // Gaussians have the first two, and share one dispatch for their ranges.
        let frozen = self.surroundings().map_or(0, |frozen| 2 * frozen.plan().chunks + 1);
        let frame = self.runner.store.capacity();
        let blending =
            LaunchSizes::new(self.context.limits()).blend_ranges(frame.instances) * frame.blend_passes;
        let scene = &self.state.model.scene.plan;
        // The 3D filter has the nearest depths, and the sizes that follow from them.
        let filter = if self.run.settings.filter_3d { 2 * scene.chunks } else { 0 };
        (PER_STEP + 7 * scene.chunks + filter + frozen + 2 * blending) as usize
    }

    /// Gaussians on the device, for [`Renderer::record`](crate::Renderer::record) after recorded steps; valid until the next
    /// [`Trainer::maintain`] or [`Trainer::step`]. Its [`SceneSettings::sh_degree`](crate::SceneSettings::sh_degree) should be
    /// [`Trainer::sh_degree`], which rises during training. With [`sh_storage`](super::TrainSettings::sh_storage) of halves, the
    /// reservation needs [`Reservation::half_sh`](crate::Reservation::half_sh). Excludes [`Trainer::surroundings`].
    pub fn scene(&self) -> DeviceScene {
        DeviceScene::new(&self.context, self.state.model.scene.clone())
    }

    /// Recording state of a slot, for a host that has discarded its command buffer ([`SlotRecording::discard`]). The host must
    /// then also discard those of all steps recorded later.
    pub fn step_recording(&mut self, slot: u32) -> Result<SlotRecording<'_>> {
        let index = self.slot_index(slot)?;
        Ok(SlotRecording::new(&mut self.recorded.slots[index].recording))
    }

    /// Fails while recorded steps are in flight, or if they have finished without a call of [`Trainer::settle`].
    pub(super) fn check_settled(&self) -> Result<()> {
        if self.recorded.in_flight.is_empty() {
            return Ok(());
        }
        let problem = "recorded steps may be in flight: wait for them, then call Trainer::settle";
        Err(Error::argument("trainer", problem))
    }

    /// Fails unless the state of the scene is known and no recorded step can change it.
    pub(super) fn check_readable(&self) -> Result<()> {
        self.check_settled()?;
        self.state.check_whole()
    }

    fn slot_index(&self, slot: u32) -> Result<usize> {
        let count = self.recorded.slots.len();
        if slot as usize >= count {
            return Err(Error::argument("slot", format!("{slot}: {count} are reserved")));
        }
        Ok(slot as usize)
    }

    /// Frees the reserve of Gaussians if that makes enough memory for a frame. Returns true if it was freed. The rows move
    /// through the host, because memory does not hold a second copy. While there are slots for recorded steps, the reserve
    /// stays.
    ///
    /// # Errors
    /// When memory does not suffice after all, because another user holds or takes the freed part. [`Trainer::checkpoint`] then
    /// still returns the whole state, and every later step is refused.
    pub(super) fn give_up_reserve(&mut self, needed: &FrameCounts) -> Result<bool> {
        let scene = &self.state.model.scene;
        let plan = self.rows.plan(&self.context, scene.count, scene.plan.sh_degree)?;
        let smaller = (plan.chunks, plan.chunk_gaussians) != (scene.plan.chunks, scene.plan.chunk_gaussians);
        if !smaller || !self.recorded.slots.is_empty() || !self.has_room_without_reserve(needed, &plan) {
            return Ok(false);
        }
        let kept = Box::new(self.checkpoint()?);
        // The state is incomplete until the rebuild succeeds.
        self.state.broken = true;
        self.state.model.release();
        self.runner.store.forget();
        let kind = self.rows.planes;
        let scene = planes::upload_planned(&self.context, "scene", kind, &kept.gaussians, plan);
        let rebuilt =
            scene.and_then(|scene| Model::new(&self.context, scene, &self.rows)).and_then(|model| {
                self.state.model = model;
                self.restore_rows(&kept)
            });
        self.state.broken = rebuilt.is_err();
        self.state.rescued = rebuilt.is_err().then_some(kept);
        rebuilt.map(|()| true)
    }

    /// True if memory holds the frame beside planes of this plan, once the current planes are freed.
    fn has_room_without_reserve(&self, needed: &FrameCounts, plan: &ScenePlan) -> bool {
        let (context, old) = (&self.context, &self.state.model.scene.plan);
        let Some((limit, _)) = context.memory_limit() else { return false };
        let sizes = LaunchSizes::new(context.limits());
        let frame = FrameCapacity {
            gaussians: gaussians_with(plan.capacity, frozen_capacity(&self.frozen)),
            visible: needed.visible_needed,
            instances: needed.all_instances(),
            blend_passes: needed.longest_tile.div_ceil(sizes.entries_per_pass).max(1),
            ..self.runner.store.capacity()
        };
        let freed = self.rows.bytes(old).device + self.runner.store.bytes();
        let taken = self.rows.allocation_bytes(context, plan).device + self.runner.store.bytes_of(&frame);
        frame_fits_device(context.limits(), &frame, &sizes)
            && context.held_bytes().saturating_sub(freed) + taken <= limit
    }
}
