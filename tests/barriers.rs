//! Every barrier of a training step is needed, and the hazard checker notices each missing one.

use crate::common::engine::settings;
use crate::common::prelude::*;
use ashsplat::frame::{
    FrameBuffers, FrameCapacity, FrameInputs, FrameVariant, LaunchSizes, POSE_BYTES, PictureCapacity,
    PlacedScene, SceneBuffers, Strips, planes,
};
use ashsplat::passes::adam::{Moments, Optimizer, OptimizerForm, Rates, Step};
use ashsplat::passes::backward::{Backward, BackwardForm, Statistics};
use ashsplat::passes::loss::{Loss, LossInputs, NativeLayout, PhotoFormat, photo_bytes};
use ashsplat::passes::poses::{PoseBuffers, PoseGradient, PoseOptimizer, PoseStep};
use ashsplat::render::Forward;
use ashsplat::vk::{Buffer, Recorder};

const SIZE: [u32; 2] = [40, 30];
const SH_DEGREE: u32 = 1;

/// Commands recorded after the forward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Loss, backward, optimiser.
    Step,
    /// Backward, with the gradients of all parameters.
    Gradients,
    /// A step with a camera that the device moves.
    Poses,
}

const KINDS: [Kind; 3] = [Kind::Step, Kind::Gradients, Kind::Poses];

struct Training {
    context: Context,
    forward: Forward,
    loss: Loss,
    backward: Backward,
    sizes: LaunchSizes,
    optimizer: Optimizer,
    scene: SceneBuffers,
    moments: Moments,
    gradients: Vec<Buffer>,
    frame: FrameBuffers,
    capacity: FrameCapacity,
    poses: PoseBuffers,
    pose_gradient: PoseGradient,
    pose_optimizer: PoseOptimizer,
    moved_optimizer: Optimizer,
    /// Photo, losses, statistics, 2-D gradients, scratch of the loss.
    others: Vec<Buffer>,
    camera: Camera,
    settings: RenderSettings,
}

impl Training {
    /// Parameters in several buffers and blending in two passes, so that every barrier occurs.
    fn new() -> Training {
        let context = with_range(100_000);
        let view = small_view(SIZE);
        let start = gaussians(&small_scene(&mut Random::new(1), 1200, 4));
        let scene = planes::upload(&context, "scene", &start, 1200, SH_DEGREE).expect("a scene");
        assert!(scene.plan.chunks > 1, "the parameters are to lie in several buffers");
        let planes_of = |arena: &'static str| {
            planes::allocate(&context, arena, MemoryKind::Device, &scene.plan).expect("planes")
        };
        let capacity = FrameCapacity {
            gaussians: 1200,
            visible: 1200,
            instances: 6000,
            pictures: PictureCapacity::of(SIZE[0], SIZE[1]),
            blend_passes: 2,
            backward: true,
            camera_sums: true,
            depth: true,
            ..FrameCapacity::default()
        };
        let requests = FrameBuffers::requests(&capacity, &LaunchSizes::new(context.limits()));
        let frame = context.allocate_shared("frame", &requests, FrameBuffers::LIVES, MemoryKind::Device);
        let [width, height] = SIZE;
        let loss = Loss::new(&context, PhotoFormat::Rgba8).expect("kernels");
        let mut others = vec![
            ("photo", photo_bytes(NativeLayout::of(context.limits()), width, height, false)),
            ("losses", 16),
            ("statistics", 1200 * 8),
            ("mean2d_gradients", 1200 * 8),
            // Large enough for both layouts, with inverse depth.
            ("image_gradient", 16 * Strips { width, height }.values()),
        ];
        others.extend(loss.scratch_requests([(width, height)]));
        let poses = context.allocate("poses", &PoseBuffers::requests(3), MemoryKind::Device).expect("poses");
        let mut training = Training {
            forward: Forward::new(&context).expect("kernels"),
            loss,
            backward: Backward::new(&context),
            sizes: LaunchSizes::new(context.limits()),
            optimizer: Optimizer::new(&context, OptimizerForm::default()),
            poses: PoseBuffers::from_allocated(poses),
            pose_gradient: PoseGradient::new(&context).expect("kernels"),
            pose_optimizer: PoseOptimizer::new(&context).expect("kernels"),
            moved_optimizer: Optimizer::new(
                &context,
                OptimizerForm { moved_cameras: true, ..OptimizerForm::default() },
            ),
            moments: Moments {
                packed: false,
                plan: scene.plan,
                sets: vec![planes_of("moments"), planes_of("moments")],
            },
            gradients: planes_of("gradients"),
            frame: FrameBuffers::from_allocated(frame.expect("a frame")),
            others: context.allocate("test", &others, MemoryKind::Device).expect("buffers"),
            camera: camera(&view),
            settings: settings(&view),
            capacity,
            scene,
            context,
        };
        let variant = FrameVariant { inverse_depth: true, backward: true, ..FrameVariant::default() };
        training.forward.prepare(SH_DEGREE, variant).expect("kernels");
        training.backward.prepare(SH_DEGREE, variant, BackwardForm::default()).expect("kernels");
        training.backward.prepare_expand(SH_DEGREE, variant).expect("kernels");
        training.optimizer.prepare(SH_DEGREE, variant).expect("kernels");
        let with_pose = BackwardForm { pose: true, ..BackwardForm::default() };
        training.backward.prepare(SH_DEGREE, variant, with_pose).expect("kernels");
        training.moved_optimizer.prepare(SH_DEGREE, variant).expect("kernels");
        training
    }

    fn record(&self, recorder: &mut Recorder, kind: Kind) {
        let first_pose = self.poses.cameras.range(0, POSE_BYTES);
        let scenes = [PlacedScene::alone(&self.scene, &self.camera, SH_DEGREE)];
        let inputs = FrameInputs {
            pose: (kind == Kind::Poses).then_some(&first_pose),
            backward: true,
            ..FrameInputs::new(&scenes, &self.frame, &self.capacity, &self.settings)
        };
        let others = self.others.split_first_chunk().expect("as many as were asked for");
        let ([photo, losses, statistics, mean2d_gradients, image_gradient], scratch) = others;
        let statistics = Statistics { buffer: statistics, accumulate: true };
        self.forward.record(recorder, &inputs);
        recorder.barrier();
        if kind == Kind::Gradients {
            self.backward.record(recorder, &inputs, image_gradient, statistics, BackwardForm::default());
            recorder.barrier();
            self.backward.record_expand_gradients(recorder, &inputs, &self.gradients, mean2d_gradients);
            return;
        }
        let loss = LossInputs {
            rendered: self.frame.rendered(&self.sizes),
            photo,
            scratch,
            losses,
            row: 0,
            image_gradient,
            width: SIZE[0],
            height: SIZE[1],
            background: [0.0; 3],
            lambda_dssim: 0.2,
            weight: 1.0,
        };
        self.loss.record(recorder, &loss);
        recorder.barrier();
        self.backward.record(
            recorder,
            &inputs,
            image_gradient,
            statistics,
            BackwardForm { pose: kind == Kind::Poses, ..BackwardForm::default() },
        );
        recorder.barrier();
        let rates =
            Rates { mean: 1e-4, opacity: 0.025, quat: 1e-3, log_scale: 5e-3, sh_dc: 2.5e-3, sh_rest: 1e-4 };
        let step = Step { rates, count: 1, opacity_count: 1, seed: 0, iteration: 1 };
        if kind != Kind::Poses {
            return self.optimizer.record(recorder, &inputs, &self.moments, &[], &step);
        }
        self.moved_optimizer.record(recorder, &inputs, &self.moments, &[], &step);
        let (poses, state) = (&self.poses, &self.frame.state);
        self.pose_gradient.record(recorder, &inputs, &poses.parameters, 0, &poses.gradient);
        recorder.barrier();
        let step = PoseStep { rate: 1e-3, count: 1 };
        self.pose_optimizer.record(recorder, poses, state, Some((step, 0)));
    }

    /// Hazards of a recording without one of its barriers, and its number of barriers.
    fn hazards(&self, kind: Kind, omitted: Option<u32>) -> (Vec<String>, u32) {
        let mut recorder = self.context.begin("training step").expect("a recorder");
        recorder.collect_hazards();
        if let Some(index) = omitted {
            recorder.omit_barrier(index);
        }
        self.record(&mut recorder, kind);
        (recorder.hazards().to_vec(), recorder.barriers())
    }
}

#[test]
fn barriers_are_complete_and_none_is_superfluous() {
    let training = Training::new();
    for kind in KINDS {
        let (hazards, barriers) = training.hazards(kind, None);
        assert!(hazards.is_empty(), "{kind:?} with all barriers: {hazards:#?}");
        assert!(barriers > 15, "{barriers} barriers");
        let superfluous: Vec<u32> =
            (0..barriers).filter(|&index| training.hazards(kind, Some(index)).0.is_empty()).collect();
        assert!(superfluous.is_empty(), "{kind:?}: of {barriers} barriers, nothing needs {superfluous:?}");
    }
    assert_silent(&training.context);
}

/// Synchronization validation accepts what the checker accepts.
#[test]
fn barriers_satisfy_synchronization_validation() {
    let training = Training::new();
    for kind in KINDS {
        training.context.run("training step", |recorder| training.record(recorder, kind)).expect("a step");
    }
    assert_silent(&training.context);
}

#[test]
fn barriers_missing_in_a_recording_panic_with_both_ends() {
    let training = Training::new();
    for index in [3, 12, 19] {
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let mut recorder = training.context.begin("training step").expect("a recorder");
            recorder.omit_barrier(index);
            training.record(&mut recorder, Kind::Step);
        }));
        let payload = outcome.expect_err("a missing barrier panics");
        let message = payload.downcast_ref::<String>().cloned().unwrap_or_default();
        assert!(message.contains("barrier"), "{index}: {message}");
    }
}
