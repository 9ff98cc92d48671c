//! Frames with backward passes by the engine's stages, for values that a renderer does not return.

use super::sets;
use crate::common::engine::settings;
use crate::common::prelude::*;
use crate::golden::npz::Npz;
use ashsplat::frame::{
    FrameBuffers, FrameCapacity, FrameInputs, FrameVariant, LaunchSizes, PictureCapacity, PlacedScene,
    SceneBuffers, planes,
};
use ashsplat::kernels::constants::{STATE_OVERFLOW, STATE_WORDS};
use ashsplat::passes::backward::{Backward, BackwardForm};
use ashsplat::render::Forward;
use ashsplat::vk::Recorder;

/// The cameras of an archive with a row per view.
pub fn views(npz: &Npz, extent: Extent) -> Vec<View> {
    sets::views(npz).into_iter().map(|view| View { extent, ..view }).collect()
}

pub fn field(extent: Extent, name: &str) -> String {
    match extent {
        Extent::Exact => name.to_owned(),
        Extent::Reference => format!("ref_{name}"),
    }
}

pub struct Stages<'a> {
    pub gpu: &'a Gpu,
    pub backward: Backward,
    pub scene: SceneBuffers,
    forward: Forward,
    frame: FrameBuffers,
    capacity: FrameCapacity,
    /// True if the sum of weights z is drawn, too.
    linear_depth: bool,
}

impl<'a> Stages<'a> {
    /// Builds kernels for the views' SH degree.
    pub fn new(gpu: &'a Gpu, set: &[Gaussian], views: &[View]) -> Stages<'a> {
        Self::with_depth(gpu, set, views, false)
    }

    pub fn with_depth(gpu: &'a Gpu, set: &[Gaussian], views: &[View], linear_depth: bool) -> Stages<'a> {
        let context = gpu.context;
        let sh_degree = views[0].sh_degree;
        let input = gaussians(set);
        let scene = planes::upload(context, "test", &input, 0, input.sh_degree).expect("upload");
        let cameras: Vec<_> = views.iter().map(camera).collect();
        let pictures = PictureCapacity::of_cameras(&cameras);
        let tiles = views.iter().map(|view| view.tiles()[0] * view.tiles()[1]).max().expect("a view");
        let capacity = FrameCapacity {
            gaussians: scene.plan.capacity,
            visible: scene.plan.capacity,
            instances: tiles * set.len() as u32 + 64,
            pictures,
            backward: true,
            absolute: true,
            depth: true,
            ..FrameCapacity::default()
        };
        let requests = FrameBuffers::requests(&capacity, &LaunchSizes::new(context.limits()));
        let frame = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
        let mut forward = Forward::new(context).expect("kernels");
        let drawn = RenderSettings { inverse_depth: linear_depth, linear_depth, ..settings(&views[0]) };
        let variant = FrameVariant::of(&drawn, &camera(&views[0]), true);
        forward.prepare(sh_degree, variant).expect("kernels");
        let mut backward = Backward::new(context);
        for absolute in [false, true] {
            backward
                .prepare(sh_degree, variant, BackwardForm { absolute, ..BackwardForm::default() })
                .expect("kernels");
        }
        backward.prepare_expand(sh_degree, variant).expect("kernels");
        let frame = FrameBuffers::from_allocated(frame);
        Stages { gpu, backward, scene, forward, frame, capacity, linear_depth }
    }

    pub fn run(&self, view: &View, record: impl FnOnce(&mut Recorder, &FrameInputs, &Backward)) {
        let linear_depth = self.linear_depth;
        let settings = RenderSettings { inverse_depth: linear_depth, linear_depth, ..settings(view) };
        let camera = camera(view);
        let scenes = [PlacedScene::alone(&self.scene, &camera, view.sh_degree)];
        let inputs = FrameInputs {
            backward: true,
            ..FrameInputs::new(&scenes, &self.frame, &self.capacity, &settings)
        };
        self.gpu.run(|r| {
            self.forward.record(r, &inputs);
            r.barrier();
            record(r, &inputs, &self.backward);
        });
        let state = self.gpu.read::<u32>(&self.frame.state, STATE_WORDS as usize);
        assert_eq!(state[STATE_OVERFLOW as usize], 0, "the frame overflowed");
    }
}
