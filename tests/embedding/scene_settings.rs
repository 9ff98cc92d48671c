//! Scenes of one frame with different settings.

use crate::scenes::{appended, assert_nearly_equal};
use crate::stage::*;
use ashsplat::Shape;

pub const SIZE: [u32; 2] = [110, 70];

pub struct Stage<'a> {
    host: &'a Host,
    pub renderer: Renderer,
    pub scenes: Vec<DeviceScene>,
    pub camera: Camera,
    pub frame: RenderSettings,
    /// Poses of the scenes; empty for the identity.
    pub poses: Vec<Pose>,
}

impl<'a> Stage<'a> {
    pub fn new(host: &'a Host, parts: &[&Gaussians], wanted: &dyn Fn(Reservation) -> Reservation) -> Self {
        Self::of(host, &guest(host), parts, wanted)
    }

    pub fn of(
        host: &'a Host,
        context: &Context,
        parts: &[&Gaussians],
        wanted: &dyn Fn(Reservation) -> Reservation,
    ) -> Self {
        let upload = |part: &&Gaussians| uploaded(context, part);
        let mut renderer = Renderer::new(context).expect("kernels");
        let gaussians: usize = parts.iter().map(|part| part.len()).sum();
        let reservation = Reservation::new(gaussians as u32, 1, SIZE[0], SIZE[1]);
        renderer.reserve(&wanted(Reservation { scenes: parts.len() as u32, ..reservation })).expect("memory");
        let frame = RenderSettings::default();
        let scenes = parts.iter().map(upload).collect();
        Self { host, renderer, scenes, camera: camera(0.7, SIZE[0], SIZE[1]), frame, poses: Vec::new() }
    }

    pub fn pixels(&mut self, settings: &[SceneSettings]) -> Vec<[f32; 4]> {
        let Self { host, renderer, scenes, camera, frame, poses } = self;
        let placed = placed(scenes, poses, settings);
        rendered(host, renderer, &RecordedFrame::new(&placed, camera, frame))
    }

    pub fn refused(&mut self, settings: &[SceneSettings]) -> Error {
        let placed = placed(&self.scenes, &self.poses, settings);
        refused(self.host, &mut self.renderer, &RecordedFrame::new(&placed, &self.camera, &self.frame))
    }

    pub fn assert_refused(&mut self, settings: &[SceneSettings], expected: &str) {
        assert_argument(&self.refused(settings), expected);
    }

    pub fn assert_drawn(&mut self, settings: &[SceneSettings], gaussians: &Gaussians) {
        assert_same(&self.pixels(settings), &owned(gaussians, &self.camera, &self.frame));
    }
}

pub fn placed<'a>(
    scenes: &'a [DeviceScene],
    poses: &[Pose],
    settings: &[SceneSettings<'a>],
) -> Vec<Placed<'a>> {
    let poses = poses.iter().copied().chain(std::iter::repeat(Pose::IDENTITY));
    let scenes = scenes.iter().zip(settings).zip(poses);
    scenes.map(|((scene, &settings), pose)| Placed { settings, ..Placed::at(scene, pose) }).collect()
}

pub const USUAL: SceneSettings = SceneSettings {
    visible: true,
    tint: [1.0; 3],
    opacity: 1.0,
    sh_degree: None,
    cut_outs: &[],
    selection: None,
};
pub const HIDDEN: SceneSettings = SceneSettings { visible: false, ..USUAL };
const FADED: SceneSettings = SceneSettings { opacity: 0.0, ..USUAL };

/// Hidden scenes need no capacity, and leave the bits of a frame without them.
#[test]
fn scenes_that_are_not_drawn_leave_no_trace() {
    with_host(&options(), |host| {
        let parts = [cloud(300, 1), cloud(5000, 2), cloud(257, 3)];
        // The second scene alone would not fit.
        let reservation = |wanted| Reservation { gaussians: 600, ..wanted };
        let mut stage = Stage::new(host, &[&parts[0], &parts[1], &parts[2]], &reservation);
        for hidden in [HIDDEN, FADED] {
            stage.assert_drawn(&[USUAL, hidden, USUAL], &appended(&parts[0], &parts[2]));
            let report = report_of(&mut stage.renderer, 0);
            assert_eq!(report.gaussians, 557);
            stage.assert_drawn(&[hidden, hidden, USUAL], &parts[2]);
            stage.assert_drawn(&[USUAL, hidden, hidden], &parts[0]);
            assert!(stage.pixels(&[hidden; 3]).iter().all(|pixel| *pixel == [0.0, 0.0, 0.0, 1.0]));
            let report = report_of(&mut stage.renderer, 0);
            assert_eq!((report.gaussians, report.visible), (0, 0));
        }
        let error = stage.refused(&[USUAL, USUAL, HIDDEN]);
        assert!(matches!(&error, Error::TooLarge { needed: 5300, .. }), "{error}");
    });
}

/// Each scene can limit its SH degree. The bits equal those of a scene without the higher coefficients.
#[test]
fn a_scene_has_an_sh_degree_of_its_own() {
    with_host(&options(), |host| {
        let parts = [cloud(300, 1), cloud(280, 2)];
        let mut stage = Stage::new(host, &[&parts[0], &parts[1]], &|wanted| wanted);
        let mut flat = parts[0].clone();
        flat.sh.chunks_mut(4).for_each(|sh| sh[1..].fill([0.0; 3]));
        let degree = |sh_degree| SceneSettings { sh_degree: Some(sh_degree), ..USUAL };
        let expected = owned(&appended(&flat, &parts[1]), &stage.camera, &stage.frame);
        // A sum with zeros rounds differently.
        assert_nearly_equal(&stage.pixels(&[degree(0), degree(3)]), &expected);
        stage.assert_drawn(&[degree(1), USUAL], &appended(&parts[0], &parts[1]));
        // The frame's limit applies to all scenes.
        stage.frame.sh_degree = Some(0);
        let all_flat = owned(&appended(&parts[0], &parts[1]), &stage.camera, &stage.frame);
        assert_same(&stage.pixels(&[degree(1), degree(3)]), &all_flat);
        stage.frame.sh_degree = None;
        assert_same(&stage.pixels(&[degree(0), degree(0)]), &all_flat);
    });
}

/// Colours and opacities as if trained with the factors. A factor of 1 has the bits of none.
#[test]
fn a_tint_and_an_opacity_are_factors() {
    with_host(&options(), |host| {
        let (mut tinted, other) = (cloud(300, 1), cloud(280, 2));
        tinted.sh.chunks_mut(4).for_each(|sh| sh[1..].fill([0.0; 3]));
        let mut stage = Stage::new(host, &[&tinted, &other], &|wanted| Reservation { tint: true, ..wanted });
        let both = appended(&tinted, &other);
        let whole = owned(&both, &stage.camera, &stage.frame);
        assert_same(&stage.pixels(&[USUAL, USUAL]), &whole);
        // The kernels of a tint, with a tint of almost 1.
        let nearly_usual = SceneSettings { tint: [1.0, 1.0, 1.0f32.next_down()], ..USUAL };
        assert_nearly_equal(&stage.pixels(&[nearly_usual, USUAL]), &whole);
        let (tint, opacity) = ([0.5, 1.75, 0.0], 0.375);
        let mut edited = tinted.clone();
        let c0 = 0.282_094_79;
        for sh in &mut edited.sh.chunks_mut(4) {
            sh[0] = [0, 1, 2].map(|i| ((c0 * sh[0][i] + 0.5) * tint[i] - 0.5) / c0);
        }
        for logit in &mut edited.opacity_logits {
            let faded = opacity / (1.0 + (-*logit).exp());
            *logit = (faded / (1.0 - faded)).ln();
        }
        let settings = SceneSettings { tint, opacity, ..USUAL };
        let expected = owned(&appended(&edited, &other), &stage.camera, &stage.frame);
        assert_nearly_equal(&stage.pixels(&[settings, USUAL]), &expected);
        let expected = owned(&edited, &stage.camera, &stage.frame);
        assert_nearly_equal(&stage.pixels(&[settings, HIDDEN]), &expected);
        // Dots stay opaque.
        stage.frame.shape = Shape::Point;
        stage.assert_drawn(&[SceneSettings { opacity: 0.01, ..USUAL }, USUAL], &both);
    });
}

#[test]
fn bad_settings_of_a_scene_are_refused_by_name() {
    with_host(&options(), |host| {
        let part = cloud(100, 1);
        let mut stage = Stage::new(host, &[&part, &part], &|wanted| wanted);
        let bad = [
            (
                SceneSettings { tint: [0.5, f32::NAN, 0.5], ..USUAL },
                "scenes[1].settings.tint: [0.5, NaN, 0.5]",
            ),
            (SceneSettings { tint: [-1.0; 3], ..USUAL }, "scenes[1].settings.tint: "),
            (SceneSettings { tint: [1001.0; 3], ..USUAL }, "each factor may be 0 to 1000"),
            (SceneSettings { opacity: f32::NAN, ..USUAL }, "scenes[1].settings.opacity: NaN"),
            (
                SceneSettings { opacity: 1.5, ..USUAL },
                "scenes[1].settings.opacity: 1.5 is not between 0 and 1",
            ),
            (SceneSettings { opacity: -0.0625, ..HIDDEN }, "scenes[1].settings.opacity: -0.0625"),
            (SceneSettings { sh_degree: Some(4), ..USUAL }, "scenes[1].settings.sh_degree: 4"),
            (
                SceneSettings { tint: [0.5; 3], ..USUAL },
                "Reservation::tint: not reserved, and scenes[1] has a tint or an opacity",
            ),
            (
                SceneSettings { opacity: 0.5, ..USUAL },
                "Reservation::tint: not reserved, and scenes[1] has a tint or an opacity",
            ),
        ];
        for (settings, expected) in bad {
            stage.assert_refused(&[USUAL, settings], expected);
        }
        // A hidden scene needs no reserved features.
        let expected = owned(&part, &stage.camera, &stage.frame);
        let unseen = SceneSettings { visible: false, tint: [0.5; 3], ..USUAL };
        assert_same(&stage.pixels(&[USUAL, unseen]), &expected);
    });
}
