//! Lenses and shutters with which the demo photographs its scenes.

use ashsplat::scene::{Camera, Intrinsics, PhotoLens, Projection};
use ashsplat_demo_scene::View;
use glam::{DMat3, dvec3};

/// Lens of the photographs, by COLMAP's name of the camera model, or their shutter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Lens {
    /// None
    #[default]
    Pinhole,
    /// A wide lens with strong barrel distortion
    Opencv,
    /// A circular fisheye of 200 degrees, square, with masks
    OpencvFisheye,
    /// Panoramas of all directions, 2:1
    Equirectangular,
    /// A pinhole that moves while its rows are read, from the first to the last: a transforms.json with two poses per photograph
    RollingShutter,
}

/// Focal length of the wide lens, as a share of the width, and its k1 k2 p1 p2. Without k2 it would fold the picture.
const WIDE: (f32, [f32; 4]) = (0.65, [-0.28, 0.07, 0.003, -0.002]);
/// Focal length of the fisheye, as a share of the width, and its k1 k2 p1 p2 k3 k4.
const FISHEYE: (f32, [f32; 6]) = (0.29, [-0.02, 0.004, 0.0, 0.0, -0.0006, 0.000_04]);
/// Angle from the fisheye's axis to its rim, degrees.
const RIM: f64 = 100.0;
/// Motion between the first and the last row: a share of the distance to the scene, and an angle in degrees.
const MOTION: [f64; 2] = [0.04, 3.0];

impl Lens {
    /// The photograph's view in place of a pinhole's. All lenses have about the same number of pixels. `distance` is that of the
    /// scene, world units.
    pub fn view(self, index: u32, pinhole: &Camera, distance: f64) -> View {
        let posed =
            |intrinsics| Camera::with_pose(pinhole.camera_from_world, pinhole.translation, intrinsics);
        let centred = |focal: f32, width: u32, height: u32| {
            let (cx, cy) = (0.5 * width as f32, 0.5 * height as f32);
            let focal = focal * width as f32;
            posed(Intrinsics { fx: focal, fy: focal, cx, cy, width, height })
        };
        let (width, height) = (pinhole.width, pinhole.height);
        match self {
            Self::Pinhole => View::new(*pinhole),
            Self::Opencv => View::new(centred(WIDE.0, width, height).with_lens(Projection::Brown, &WIDE.1)),
            Self::OpencvFisheye => {
                let side = width * 7 / 8;
                let camera = centred(FISHEYE.0, side, side).with_lens(Projection::Fisheye, &FISHEYE.1);
                View::new(camera).with_rim(RIM.to_radians())
            }
            Self::Equirectangular => {
                let height = width * 5 / 8;
                let camera = posed(PhotoLens::panorama(2 * height, height).intrinsics());
                View::new(camera.with_lens(Projection::Equirectangular, &[]))
            }
            Self::RollingShutter => {
                let [first, last] = [-0.5, 0.5].map(|share| moved(pinhole, index, distance, share));
                View::new(first).moving_to(last)
            }
        }
    }
}

/// The camera during its motion: at its own pose halfway, where `share` is 0. Each photograph moves and turns in another direction.
fn moved(camera: &Camera, index: u32, distance: f64, share: f64) -> Camera {
    let angle = 2.4 * f64::from(index);
    let aside = share * MOTION[0] * distance * dvec3(angle.cos(), angle.sin(), 0.0);
    let axis = dvec3((1.7 * angle).cos(), (1.7 * angle).sin(), 0.3).normalize();
    let rotation = camera.camera_from_world.as_dmat3();
    let turned = DMat3::from_axis_angle(axis, share * MOTION[1].to_radians()) * rotation;
    Camera::at(camera.exact_position() + rotation.transpose() * aside, turned, camera.intrinsics())
}
