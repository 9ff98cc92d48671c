//! Training in C: steps that submit and wait, and steps in a host's command buffer.

use super::structs::{check_room, write, write_if};
use super::{AshsplatRelease, AshsplatScene, AshsplatStatus, borrowed, borrowed_mut, give, guarded, take};
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::trainer::{Maintenance, StepOutcome, StepReservation};
use ashsplat::{StepReport, Trainer};
use std::ffi::c_void;

/// Trains Gaussians on photographs.
pub struct AshsplatTrainer(pub(super) Trainer);

/// The report of a training step.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatStep {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Whether the step has finished. The other fields are valid only then.
    pub finished: bool,
    /// Whether it changed nothing, because a capacity was too small. ashsplat_trainer_maintain grows it. Then
    /// the iteration is recorded again.
    pub overflow: bool,
    /// Its iteration, from 1.
    pub iteration: u32,
    /// The loss before it; NaN if the iteration was skipped, because its frame exceeds the largest possible
    /// capacity.
    pub loss: f32,
    /// Gaussians in it.
    pub gaussians: u32,
    /// Gaussians visible in its view.
    pub visible: u32,
    /// (tile, Gaussian) instances that its view needs; after an overflow those of the visible Gaussians that there was room for.
    pub instances: u32,
    /// Index of its view.
    pub view: u32,
}

impl From<&StepReport> for AshsplatStep {
    fn from(r: &StepReport) -> Self {
        Self {
            finished: true,
            overflow: false,
            iteration: r.iteration,
            loss: r.loss,
            gaussians: r.gaussians,
            visible: r.visible,
            instances: r.instances,
            view: r.view as u32,
            ..Self::default()
        }
    }
}

impl From<&StepOutcome> for AshsplatStep {
    fn from(outcome: &StepOutcome) -> Self {
        match outcome {
            StepOutcome::Done(report) => report.into(),
            &StepOutcome::Overflowed {
                iteration,
                visible_needed: visible,
                instances_needed: instances,
                ..
            } => Self { finished: true, overflow: true, iteration, visible, instances, ..Self::default() },
        }
    }
}

/// The report of ashsplat_trainer_maintain.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatMaintenance {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Whether Gaussians were added and removed.
    pub densified: bool,
    /// Whether opacities were reset.
    pub opacities_reset: bool,
    /// Whether the capacity has grown.
    pub grown: bool,
    /// The iteration that was skipped, because its frame exceeds the largest possible capacity; 0 for none.
    /// The next step is the iteration after it.
    pub skipped: u32,
}

impl From<Maintenance> for AshsplatMaintenance {
    fn from(m: Maintenance) -> Self {
        Self {
            densified: m.densified.is_some(),
            opacities_reset: m.opacities_reset,
            grown: m.grown,
            skipped: m.skipped.unwrap_or(0),
            ..Self::default()
        }
    }
}

/// Frees a trainer. No recorded step of it may still be executed.
///
/// # Safety
/// `trainer` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_free(trainer: *mut AshsplatTrainer) {
    // SAFETY: as promised.
    unsafe { take(trainer) }
}

/// Runs one iteration: submits and waits. Iterations after the last of the settings change nothing.
///
/// # Safety
/// `trainer` is alive, `step` is NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_step(
    trainer: *mut AshsplatTrainer,
    step: *mut AshsplatStep,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        check_room(step, "step")?;
        let report = borrowed_mut(trainer, "trainer")?.0.step()?;
        write_if(step, "step", (&report).into())
    })
}

/// Builds all kernels and allocates everything that recorded steps need. `slots` steps may be in flight, with
/// a capacity of at least `instances` (tile, Gaussian) pairs and `visible` Gaussians that a view shows, or 0 for estimates. Submits
/// and waits.
///
/// # Safety
/// `trainer` is alive; the whole command buffers of all recorded steps have finished: their fences were
/// waited for. A result of ashsplat_trainer_outcome is not enough.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_reserve(
    trainer: *mut AshsplatTrainer,
    slots: u32,
    instances: u32,
    visible: u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let wanted = StepReservation { slots, instances, visible };
        borrowed_mut(trainer, "trainer")?.0.reserve_steps(&wanted)
    })
}

/// Records the next iteration into a VkCommandBuffer. It never submits, waits, allocates, maps or reads back.
/// Errors are reported before anything is recorded, including that maintenance is due. The slot is in flight
/// until the device has executed the step.
///
/// # Safety
/// - `commands` is of the context's device and queue family, in the recording state, outside of a render
///   pass; it is submitted at most once before it is recorded again, and steps in the order in which they
///   were recorded;
/// - the trainer lives until the execution has finished, and the slot is recorded again only then: its fence
///   was waited for;
/// - the host assumes afterwards that the command buffer's compute pipeline, descriptor sets and push
///   constants have changed;
/// - `release` is NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_record(
    trainer: *mut AshsplatTrainer,
    commands: *mut c_void,
    slot: u32,
    release: *mut AshsplatRelease,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let trainer = &mut borrowed_mut(trainer, "trainer")?.0;
        let commands = trainer.context().adopt_commands(vk::CommandBuffer::from_raw(commands as u64))?;
        check_room(release, "release")?;
        let step = trainer.record_step(commands, slot)?;
        write_if(release, "release", (&step.release).into())
    })
}

/// Forgets the last recorded step of a slot, whose command buffer was discarded. The command buffers of all
/// steps recorded after it must then be discarded as well.
///
/// # Safety
/// `trainer` is alive; the command buffer was not submitted and is not going to be.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_discard(
    trainer: *mut AshsplatTrainer,
    slot: u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        borrowed_mut(trainer, "trainer")?.0.step_recording(slot)?.discard();
        Ok(())
    })
}

/// The outcome of the last recorded step of a slot. Never waits, except on llvmpipe, where reading the time
/// waits.
///
/// # Safety
/// `trainer` is alive, `step` valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_outcome(
    trainer: *mut AshsplatTrainer,
    slot: u32,
    step: *mut AshsplatStep,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let outcome = borrowed_mut(trainer, "trainer")?.0.step_outcome(slot)?;
        write(step, "step", outcome.as_ref().map(AshsplatStep::from).unwrap_or_default())
    })
}

/// Whether ashsplat_trainer_maintain must be called before another step can be recorded. Never waits.
///
/// # Safety
/// `trainer` is alive, `is_due` valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_maintenance_is_due(
    trainer: *mut AshsplatTrainer,
    is_due: *mut bool,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        *borrowed_mut(is_due, "is_due")? = borrowed_mut(trainer, "trainer")?.0.maintenance_is_due()?;
        Ok(())
    })
}

/// Does what recorded steps cannot: densifies and resets opacities if that is due, and grows the capacity
/// after a step that overflowed. Submits, waits and allocates; no recorded step may be in flight. Scenes of
/// ashsplat_trainer_scene are out of date afterwards.
///
/// # Safety
/// `trainer` is alive, `done` is NULL or valid for a write; the whole command buffers of all recorded steps
/// have finished: their fences were waited for. A result of ashsplat_trainer_outcome is not enough.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_maintain(
    trainer: *mut AshsplatTrainer,
    done: *mut AshsplatMaintenance,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        check_room(done, "done")?;
        let maintenance = borrowed_mut(trainer, "trainer")?.0.maintain()?;
        write_if(done, "done", maintenance.into())
    })
}

/// The Gaussians on the device, for ashsplat_record after recorded steps. Each call makes a scene that the host frees
/// (ashsplat_scene_free), before or after the trainer: it keeps the memory alive. It shows the trainer's Gaussians until the next
/// ashsplat_trainer_maintain or ashsplat_trainer_step: ask again then.
///
/// # Safety
/// `trainer` is alive, `scene` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_scene(
    trainer: *const AshsplatTrainer,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let trainer = borrowed(trainer, "trainer")?;
        give(scene, "scene", || Ok(AshsplatScene::of(trainer.0.scene())))
    })
}
