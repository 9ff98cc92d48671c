//! Volumes that keep or remove Gaussians of a frame's scene.

mod at_random;

use crate::scene_settings::{HIDDEN, Stage, USUAL};
use crate::stage::*;
pub use at_random::{HIDES, Kinds, Random, mapping};

fn pose(turn: f32, translation: Vec3, scale: f32) -> Pose {
    let turn = Quat::from_euler(glam::EulerRot::XYZ, turn, -2.0 * turn, 0.5 * turn);
    Pose { world_from_object: Mat3::from_quat(turn), translation, scale }
}

/// One volume of each shape, turned, moved and scaled, that keeps the inside.
fn volumes() -> [CutOut; 3] {
    let inside = Inside::Kept;
    let half_size = Vec3::new(0.9, 0.6, 0.75);
    [
        CutOut { volume: Volume::Box { half_size }, pose: pose(0.4, Vec3::splat(0.1), 0.75), inside },
        CutOut {
            volume: Volume::Ellipsoid { radii: half_size },
            pose: pose(0.8, -Vec3::splat(0.2), 1.1),
            inside,
        },
        CutOut {
            volume: Volume::HalfSpace { normal: Vec3::new(1.0, -2.0, 0.5), offset: 0.1 },
            pose: pose(0.0, Vec3::X * 0.1, 2.0),
            inside,
        },
    ]
}

fn filtered(gaussians: &Gaussians, cut_outs: &[CutOut]) -> Gaussians {
    let mut left = gaussians.clone();
    left.cut_out(cut_outs).expect("valid cut-outs");
    left
}

fn removing(cut_out: CutOut) -> CutOut {
    CutOut { inside: Inside::Removed, ..cut_out }
}

fn with_cut_outs(wanted: Reservation) -> Reservation {
    Reservation { slots: 2, occlusion: true, tint: true, cut_outs: 20, selection: true, ..wanted }
}

/// A cut-out moves with its scene; a cut-out of the world is transformed into the scene.
#[test]
fn cut_outs_of_the_world_stay_where_they_are() {
    with_host(&options(), |host| {
        let part = cloud(600, 4);
        let mut stage = Stage::new(host, &[&part], &with_cut_outs);
        let scene_pose = pose(0.3, Vec3::new(0.2, -0.1, 0.3), 0.8);
        stage.poses = vec![scene_pose];
        let world = volumes();
        let own = world.map(|cut_out| cut_out.in_scene(&scene_pose));
        for (in_world, in_scene) in world.iter().zip(&own) {
            let limits = in_world.limits();
            let place = |mean: &[f32; 3]| {
                let turned = scene_pose.world_from_object * Vec3::from(*mean);
                (scene_pose.scale * turned + scene_pose.translation).to_array()
            };
            let inside = part.means.iter().filter(|mean| limits.contains(place(mean))).count();
            let left = filtered(&part, std::slice::from_ref(in_scene));
            assert!(left.len().abs_diff(inside) <= 1 && inside > 50, "{inside}, {}", left.len());
            let cut_outs = std::slice::from_ref(in_scene);
            let pixels = stage.pixels(&[SceneSettings { cut_outs, ..USUAL }]);
            let mut apart = Stage::new(host, &[&left], &with_cut_outs);
            apart.poses = vec![scene_pose];
            assert!(pixels == apart.pixels(&[USUAL]), "{in_world:?}");
        }
    });
}

#[test]
fn bad_cut_outs_are_refused_by_name() {
    with_host(&options(), |host| {
        let part = cloud(100, 1);
        let mut stage = Stage::new(host, &[&part, &part], &with_cut_outs);
        let [good, ball, half] = volumes();
        let with = |volume| [good, CutOut { volume, ..good }];
        let flat = with(Volume::Box { half_size: Vec3::new(1.0, 0.0, 1.0) });
        let unknown = with(Volume::Ellipsoid { radii: Vec3::new(1.0, f32::NAN, 1.0) });
        let tiny = with(Volume::Ellipsoid { radii: Vec3::splat(1e-40) });
        let nowhere = with(Volume::HalfSpace { normal: Vec3::ZERO, offset: 0.0 });
        let endless = with(Volume::HalfSpace { normal: Vec3::X, offset: f32::INFINITY });
        let sheared =
            [Pose { world_from_object: Mat3::from_diagonal(Vec3::new(1.0, 2.0, 1.0)), ..Pose::IDENTITY }]
                .map(|pose| CutOut { pose, ..ball });
        let (seventeen, ten) = ([half; 17], [half; 11]);
        let bad: [(&[CutOut], &str); 7] = [
            (&flat, "scenes[1].settings.cut_outs[1].volume: a size of [1.0, 0.0, 1.0] is not positive"),
            (&unknown, "scenes[1].settings.cut_outs[1].volume: a size of [1.0, NaN, 1.0]"),
            (&tiny, "it is too large or too small with its pose"),
            (&nowhere, "a normal of [0.0, 0.0, 0.0] has no direction"),
            (&endless, "an offset of inf is not finite"),
            (&sheared, "scenes[1].settings.cut_outs[0].pose: is not a rotation"),
            (&seventeen, "scenes[1].settings.cut_outs: 17 of them, there may be 16"),
        ];
        for (cut_outs, expected) in bad {
            stage.assert_refused(&[USUAL, SceneSettings { cut_outs, ..USUAL }], expected);
        }
        let eleven = SceneSettings { cut_outs: &ten, ..USUAL };
        let error = stage.refused(&[eleven, eleven]).to_string();
        assert_eq!(error, "scenes: the frame needs 22 cut-outs, more than 20 (Reservation::cut_outs)");
        // A hidden scene has no cut-outs.
        let hidden = SceneSettings { visible: false, ..eleven };
        stage.assert_drawn(&[hidden, eleven], &filtered(&part, &ten));
        let mut none = Stage::new(host, &[&part], &|wanted| wanted);
        let error = none.refused(&[eleven]).to_string();
        assert_eq!(error, "scenes: the frame needs 11 cut-outs, more than 0 (Reservation::cut_outs)");
        assert!(none.pixels(&[HIDDEN]).iter().all(|pixel| pixel[3] == 1.0));
    });
}
