//! Messages between page and program over the WebSocket: JSON, except frames. A frame is binary: the length of a JSON header
//! (u32, little-endian), the header, the encoded picture.

use super::cut::CutMessage;
use ashsplat::scene::{Camera, Coefficients, Intrinsics, Projection};
use ashsplat::{Error, PixelReport, Result, Shape};
use ashsplat_program::output::samples;
use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Most pixels of a requested picture.
pub const MAX_PIXELS: u64 = 3840 * 2400;

#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "op", rename_all = "lowercase")]
pub enum Edit {
    /// Changes the selection among the Gaussians that are drawn and that the page's cut keeps.
    Select {
        region: Region,
        how: SelectionOp,
        #[serde(default)]
        cut: CutMessage,
    },
    Hide,
    Show,
    Delete,
    Undo,
    Redo,
}

/// A part of the scene, by the means of its Gaussians.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Region {
    All,
    /// Pixels inside a polygon (even-odd); corners in pixels, the first pixel's centre at 0.5.
    Lasso {
        camera: Box<CameraMessage>,
        points: Vec<[f32; 2]>,
    },
    /// Pixels at most `radius` from a line.
    Brush {
        camera: Box<CameraMessage>,
        points: Vec<[f32; 2]>,
        radius: f32,
    },
    /// Gaussians by their index: one of several scenes.
    Range {
        first: usize,
        count: usize,
    },
    /// A ball, world units.
    Sphere {
        center: [f32; 3],
        radius: f32,
    },
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum SelectionOp {
    Set,
    Add,
    Remove,
    Toggle,
}

/// The page's camera: x right, y down, z forward.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct CameraMessage {
    /// Rows of the rotation from world to camera.
    pub rotation: [[f32; 3]; 3],
    /// Translation from world to camera, world units.
    pub translation: [f32; 3],
    /// Focal lengths and principal point, pixels; the first pixel's centre at 0.5.
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
    /// Size of the picture, pixels.
    pub width: u32,
    pub height: u32,
    /// Lens of the photo that the view is exactly of; none for pinholes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens: Option<LensMessage>,
}

/// A lens: see [`Projection`].
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct LensMessage {
    pub projection: String,
    pub coefficients: Coefficients,
}

impl CameraMessage {
    pub fn camera(&self) -> Result<Camera> {
        let Self { fx, fy, cx, cy, width, height, .. } = *self;
        let intrinsics = Intrinsics { fx, fy, cx, cy, width, height };
        let rotation = Mat3::from_cols_array_2d(&self.rotation).transpose();
        let mut camera = Camera::with_pose(rotation, Vec3::from_array(self.translation), intrinsics);
        if let Some(LensMessage { projection, coefficients }) = &self.lens {
            let named =
                Projection::ALL.into_iter().find(|known| known.is_lens() && known.name() == projection);
            let unknown =
                || Error::argument("camera.lens.projection", format!("{projection:?} is not known"));
            camera = camera.with_lens(named.ok_or_else(unknown)?, coefficients);
        }
        camera.check()?;
        if u64::from(width) * u64::from(height) > MAX_PIXELS {
            let problem = format!("{width}x{height} pixels are more than {MAX_PIXELS}");
            return Err(Error::argument("picture", problem));
        }
        Ok(camera)
    }

    pub fn of(camera: &Camera) -> Self {
        let rows = camera.camera_from_world.transpose().to_cols_array_2d();
        let Intrinsics { fx, fy, cx, cy, width, height } = camera.intrinsics();
        let lens = camera.projection.is_lens().then(|| LensMessage {
            projection: camera.projection.name().into(),
            coefficients: camera.coefficients,
        });
        Self {
            rotation: rows,
            translation: camera.translation.to_array(),
            fx,
            fy,
            cx,
            cy,
            width,
            height,
            lens,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    #[default]
    Splats,
    /// A dot at each mean.
    Centres,
    /// Opaque ellipsoids.
    Ellipsoids,
    /// Expected depth in colours, near is red.
    Depth,
    /// Number of Gaussians in each tile, in colours.
    Tiles,
    /// Normals as colours: (1 + n) / 2, in the scene's axes.
    Normals,
}

impl Mode {
    pub fn shape(self) -> Shape {
        match self {
            Mode::Centres => Shape::Point,
            Mode::Ellipsoids => Shape::Ellipsoid,
            _ => Shape::Gaussian,
        }
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(default)]
pub struct ViewSettings {
    pub mode: Mode,
    /// None: the background of the training.
    pub background: Option<[f32; 3]>,
    /// None: the scene's own degree.
    pub sh_degree: Option<u32>,
    pub scale: f32,
    /// JPEG quality, 1 to 100; 0 for PNG.
    pub quality: u8,
    pub cut: CutMessage,
    /// Most Gaussians of a picture of a tree of tiles. None: the program's own setting.
    pub budget: Option<u64>,
    /// True if the selected Gaussians are drawn in the selection's colour.
    pub selection: bool,
}

impl Default for ViewSettings {
    fn default() -> Self {
        Self {
            mode: Mode::Splats,
            background: None,
            sh_degree: None,
            scale: 1.0,
            quality: 90,
            cut: CutMessage::default(),
            budget: None,
            selection: false,
        }
    }
}

#[derive(Clone, Debug, Deserialize)]
pub struct ViewRequest {
    /// Returned with the frame.
    pub seq: u64,
    pub camera: CameraMessage,
    #[serde(default)]
    pub look: ViewSettings,
    /// True if the frame is to be renewed while training continues.
    #[serde(default)]
    pub follow: bool,
    /// Camera index of the photo whose exposure and lens effects are applied.
    #[serde(default)]
    pub as_photo: Option<usize>,
}

/// Asks which Gaussians make up a pixel of a picture.
#[derive(Clone, Debug, Deserialize)]
pub struct Pick {
    /// Returned with the answer.
    pub id: u64,
    pub camera: CameraMessage,
    #[serde(default)]
    pub look: ViewSettings,
    /// Column and row.
    pub pixel: [u32; 2],
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub struct PathKey {
    pub position: [f32; 3],
    /// Rows of the rotation from world to camera.
    pub rotation: [[f32; 3]; 3],
    /// Vertical field of view, radians.
    pub fov_y: f32,
}

#[derive(Clone, Debug, Deserialize)]
pub struct FilmRequest {
    pub keys: Vec<PathKey>,
    pub seconds: f32,
    pub frames_per_second: u32,
    /// True if the path returns to its first key.
    #[serde(default)]
    pub closed: bool,
    pub width: u32,
    pub height: u32,
    #[serde(default)]
    pub look: ViewSettings,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum FromPage {
    /// The newest camera. It replaces one that still waits.
    View(ViewRequest),
    /// The frame has arrived; the next may be sent.
    Ack {},
    Pick(Pick),
    /// Asks for training's progress, with curves from this iteration on.
    Status {
        #[serde(default)]
        since: u32,
    },
    Train {
        action: TrainAction,
    },
    Film(FilmRequest),
    Cancel,
    /// Changes the selection, or what is drawn of the scene, for all pages.
    Edit(EditRequest),
}

/// An edit, and the `run` of the scene that its page shows.
#[derive(Clone, Debug, Deserialize)]
pub struct EditRequest {
    pub run: String,
    #[serde(flatten)]
    pub edit: Edit,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum TrainAction {
    Pause,
    Resume,
    /// Runs one iteration, then pauses.
    Step,
    Save,
    Stop,
}

#[derive(Clone, Debug)]
pub enum ToPage {
    Text(String),
    Binary(Vec<u8>),
}

impl ToPage {
    pub fn json(value: &Value) -> Self {
        Self::Text(value.to_string())
    }

    pub fn frame(header: &Value, picture: &[u8]) -> Self {
        let header = header.to_string();
        let length = u32::try_from(header.len()).unwrap_or_default();
        Self::Binary([&length.to_le_bytes(), header.as_bytes(), picture].concat())
    }

    /// Says that the page's film is given up.
    pub fn film_is_cancelled() -> Self {
        Self::json(&json!({ "type": "film", "cancelled": true }))
    }

    pub fn problem(message: &str) -> Self {
        Self::json(&json!({ "type": "problem", "message": message }))
    }
}

/// Answers a pick. `depth` is where half of the blocked light is blocked, `point` the position there; none if too little is
/// blocked.
pub fn picked(id: u64, pixel: [u32; 2], camera: &Camera, report: &PixelReport) -> Value {
    let depth = pivot_depth(report);
    json!({
        "type": "picked", "id": id, "pixel": pixel, "samples": samples(report), "color": report.color,
        "transmittance": report.transmittance, "depth": depth,
        "point": depth.map(|depth| place(camera, pixel, depth).to_array()),
    })
}

/// World position at a depth under a pixel's centre.
pub fn place(camera: &Camera, pixel: [u32; 2], depth: f32) -> Vec3 {
    camera.points()(pixel.map(|at| at as f32 + 0.5), depth)
}

/// Depth at which half of the blocked light is blocked. None if less than a tenth is blocked in all.
pub fn pivot_depth(report: &PixelReport) -> Option<f32> {
    let blocked = 1.0 - report.transmittance;
    if blocked < 0.1 {
        return None;
    }
    let half = 1.0 - 0.5 * blocked;
    report.samples.iter().find(|s| s.transmittance_after <= half).map(|s| s.depth)
}
