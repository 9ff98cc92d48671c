//! A valid checkpoint, also for tests/growth.

use ashsplat::TrainSettings;
use ashsplat::scene::{Gaussians, WorldFrame};
use ashsplat::train::checkpoint::{Capacities, Checkpoint, MomentState};

pub fn checkpoint(gaussians: Gaussians, sh_degree: u32) -> Checkpoint {
    let count = gaussians.len();
    let ones = Gaussians {
        sh_degree: gaussians.sh_degree,
        means: vec![[1.0; 3]; count],
        quats: vec![[1.0; 4]; count],
        log_scales: vec![[1.0; 3]; count],
        opacity_logits: vec![1.0; count],
        sh: vec![[1.0; 3]; gaussians.sh.len()],
    };
    Checkpoint {
        version: "0.2.0".into(),
        device: "a device".into(),
        driver: "a driver".into(),
        kernels: "gpu, subgroups of 32".into(),
        settings: TrainSettings { sh_degree, ..TrainSettings::reference() },
        views: 3,
        views_fingerprint: 7,
        scene_extent: 2.0,
        frame: WorldFrame::default(),
        iteration: 5,
        optimizer_steps: 5,
        opacity_steps: 5,
        due: Default::default(),
        filters: Vec::new(),
        strategy: Default::default(),
        moments: MomentState::F32([gaussians.clone(), ones]),
        statistics: vec![[0.0; 2]; count],
        gaussians,
        exposures: Default::default(),
        lens_effects: Default::default(),
        poses: None,
        lens_opt: Default::default(),
        block: None,
        skipped: 1,
        capacities: Capacities::default(),
    }
}
