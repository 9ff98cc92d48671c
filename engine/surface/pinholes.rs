//! Pinholes in place of lenses: only depths of pinholes follow the slopes of Gaussians.

use crate::scene::{Camera, Intrinsics, PhotoLens, Projection};
use glam::{DMat3, DVec2, DVec3};

/// Right and forward of a cube's faces.
const FACES: [[DVec3; 2]; 6] = [
    [DVec3::X, DVec3::Z],
    [DVec3::NEG_Z, DVec3::X],
    [DVec3::Z, DVec3::NEG_X],
    [DVec3::X, DVec3::NEG_Y],
    [DVec3::X, DVec3::Y],
    [DVec3::NEG_X, DVec3::NEG_Z],
];
/// Steps along a picture's side at which its directions are looked at.
const STEPS: u32 = 128;
/// Largest number of a face's pixels for a pixel of the lens: at a corner of the face.
const STRETCH: f64 = 3.0;
/// Marks a ray outside the photograph.
const NOWHERE: u32 = u32::MAX;

/// A pinhole's view of a part of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PinholeView {
    /// The pinhole.
    pub camera: Camera,
    /// Per pixel: true if it counts. None if all do.
    pub counts: Option<Vec<bool>>,
}

/// Pinholes that together show what a lens shows: faces of a cube, each cut to what the lens shows there. A pinhole gives itself.
/// [`RenderSettings::distance_order`](crate::RenderSettings::distance_order) draws them in the order in which fisheyes and panoramas
/// have trained a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Pinholes {
    lens: PhotoLens,
    photograph: Option<PhotoLens>,
    faces: Vec<Face>,
}

#[derive(Clone, Debug, PartialEq)]
struct Face {
    /// Rotation from the lens's camera space to the face's.
    turn: DMat3,
    intrinsics: Intrinsics,
    /// Per pixel: the photograph's pixel, or `NOWHERE`. None for a pinhole without a photograph.
    places: Option<Vec<u32>>,
}

impl Pinholes {
    /// Pinholes for cameras of a lens; none for parallel rays. With a photograph, only what it shows counts.
    pub fn new(lens: &PhotoLens, photograph: Option<&PhotoLens>) -> Self {
        let mut faces = match lens.projection {
            Projection::Orthographic => Vec::new(),
            Projection::Perspective => vec![Face::new(DMat3::IDENTITY, lens.intrinsics())],
            _ => faces_of(lens),
        };
        if lens.projection.is_lens() || photograph.is_some() {
            let (is_shown, pixel_of) = (lens.pixels(), photograph.unwrap_or(lens).pixels());
            let place =
                |ray: DVec3| is_shown(ray).and_then(|_| pixel_of(ray)).map_or(NOWHERE, |pixel| pixel as u32);
            for face in &mut faces {
                face.places = Some(face.places_of(place));
            }
        }
        Self { lens: *lens, photograph: photograph.copied(), faces }
    }

    /// True if these are the pinholes of this lens and photograph.
    pub fn are_of(&self, lens: &PhotoLens, photograph: Option<&PhotoLens>) -> bool {
        self.lens == *lens && self.photograph.as_ref() == photograph
    }

    /// The pinholes of a camera with the lens. The mask is the photograph's: 0 hides a pixel. A rolling shutter has its pose halfway.
    pub fn views(&self, camera: &Camera, mask: Option<&[u8]>) -> Vec<PinholeView> {
        let counts = |&place: &u32| {
            place != NOWHERE
                && mask.is_none_or(|mask| mask.get(place as usize).is_some_and(|&value| value != 0))
        };
        let view = |Face { turn, intrinsics, places }: &Face| {
            let turn = turn.as_mat3();
            let (rotation, translation) = (turn * camera.camera_from_world, turn * camera.translation);
            PinholeView {
                camera: Camera::with_pose(rotation, translation, *intrinsics),
                counts: places.as_ref().map(|places| places.iter().map(counts).collect()),
            }
        };
        self.faces.iter().map(view).collect()
    }
}

impl Face {
    fn new(turn: DMat3, intrinsics: Intrinsics) -> Self {
        Self { turn, intrinsics, places: None }
    }

    /// Per pixel: the place of its direction in the lens's camera space. Several threads share the work.
    fn places_of(&self, place: impl Fn(DVec3) -> u32 + Copy + Send) -> Vec<u32> {
        let Intrinsics { fx, fy, cx, cy, width, height } = self.intrinsics;
        let [focal, center] = [[fx, fy], [cx, cy]].map(|pair| DVec2::from_array(pair.map(f64::from)));
        let lens_from_face = self.turn.transpose();
        let ray_of = move |x: u32, y: u32| {
            let at = DVec2::new(x.into(), y.into()) + 0.5;
            lens_from_face * ((at - center) / focal).extend(1.0)
        };
        let mut places = vec![NOWHERE; width as usize * height as usize];
        let threads = std::thread::available_parallelism().map_or(1, usize::from) as u32;
        let rows = height.div_ceil(threads).max(1);
        std::thread::scope(|scope| {
            let parts = places.chunks_mut(rows as usize * width as usize);
            for (part, first) in parts.zip((0..height).step_by(rows as usize)) {
                let pixels = (first..height).flat_map(move |y| (0..width).map(move |x| ray_of(x, y)));
                scope.spawn(move || part.iter_mut().zip(pixels).for_each(|(to, ray)| *to = place(ray)));
            }
        });
        places
    }
}

/// Faces with the focal length of the lens's middle.
fn faces_of(lens: &PhotoLens) -> Vec<Face> {
    let half = lens.focal_px.max_element().ceil().max(1.0);
    let size = DVec2::new(lens.width.into(), lens.height.into());
    let margin = STRETCH * size.max_element() / f64::from(STEPS);
    let step = |at: u32| f64::from(at) / f64::from(STEPS);
    let (steps, ray_of) = ((0..=STEPS).flat_map(|y| (0..=STEPS).map(move |x| [x, y])), lens.rays());
    let rays: Vec<DVec3> = steps.filter_map(|at| ray_of(DVec2::from_array(at.map(step)) * size)).collect();
    let face = |[right, forward]: [DVec3; 2]| {
        let turn = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let places =
            rays.iter().map(|&ray| turn * ray).filter(|at| at.z > 0.0).map(|at| half * at.truncate() / at.z);
        let inside = places.filter(|place| place.abs().max_element() <= half + margin);
        let [low, high] = inside
            .fold([DVec2::INFINITY, DVec2::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)]);
        let whole = DVec2::splat(half);
        let (low, high) = ((low - margin).max(-whole).floor(), (high + margin).min(whole).ceil());
        let [width, height] = (high - low).to_array().map(|side| side as u32);
        let (focal, [cx, cy]) = (half as f32, (-low).as_vec2().to_array());
        let intrinsics = Intrinsics { fx: focal, fy: focal, cx, cy, width, height };
        (width > 0 && height > 0).then(|| Face::new(turn, intrinsics))
    };
    FACES.into_iter().filter_map(face).collect()
}
