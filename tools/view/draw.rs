//! One picture of the scene in one of the modes, and its bytes.

use super::edits::GaussianSet;
use super::protocol::{Edit, Mode, ViewSettings};
use ashsplat::kernels::constants::TILE_SIZE;
use ashsplat::{
    Camera, Error, Frame, FrameStats, Gaussians, PixelReport, RenderSettings, Result, SurfaceDepth,
    TileReport, Trainer,
};
use ashsplat_files::Photo;
use ashsplat_program::appearance::Appearance;
use ashsplat_program::output::{self, Depth};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use serde_json::Value;

/// A page by its number, or its film.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Viewer {
    pub page: u64,
    pub films: bool,
}

pub struct ViewerSettings<'a> {
    pub viewer: Viewer,
    /// Most Gaussians of a picture of a tree of tiles. None: the program's own setting.
    pub budget: Option<u64>,
    /// True if the selected Gaussians are drawn in the selection's colour.
    pub selection: bool,
    pub is_connected: &'a dyn Fn(&Viewer) -> bool,
}

/// Error for edits of a scene that cannot be edited.
pub const NOT_EDITED: &str =
    "only a scene that is loaded whole can be edited, no training and no tree of tiles";

/// A scene to look at: finished, or in training.
pub trait ViewedScene {
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame>;
    fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)>;
    fn inspect(&mut self, camera: &Camera, settings: &RenderSettings, pixel: [u32; 2])
    -> Result<PixelReport>;
    fn gaussians(&self, part: GaussianSet) -> Result<Gaussians>;
    fn edit(&mut self, _: &Edit) -> Result<()> {
        Err(Error::argument("edit", NOT_EDITED))
    }
    fn edits(&self) -> Option<&Value> {
        None
    }
    /// Frees the memory of pictures. The next picture allocates what it needs.
    fn shrink(&mut self);
    /// The training whose scene it is, if it is in training.
    fn trainer(&self) -> Option<&Trainer> {
        None
    }
    fn set_viewer(&mut self, _: &ViewerSettings<'_>) {}
    /// True if all parts of the scene that this camera needs are loaded; requests those that are missing.
    fn is_ready(&mut self, _: &Camera) -> Result<bool> {
        Ok(true)
    }
    /// How complete the last picture of a tree of tiles is.
    fn tree(&self) -> Option<&Value> {
        None
    }
}

impl ViewedScene for Trainer {
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        Trainer::render(self, camera, settings)
    }

    fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        let settings = self.at_current_degree(settings);
        self.draw(|renderer| renderer.render_with_tiles(camera, &settings))
    }

    fn inspect(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        pixel: [u32; 2],
    ) -> Result<PixelReport> {
        let settings = self.at_current_degree(settings);
        self.draw(|renderer| renderer.inspect(camera, &settings, pixel))
    }

    fn gaussians(&self, part: GaussianSet) -> Result<Gaussians> {
        if part == GaussianSet::Selection {
            return Err(Error::argument("part", NOT_EDITED));
        }
        self.baked_gaussians()
    }

    fn shrink(&mut self) {
        self.shrink_pictures();
    }

    fn trainer(&self) -> Option<&Trainer> {
        Some(self)
    }
}

pub struct DrawnPicture {
    pub photo: Photo,
    /// Values of the lowest and the highest colour, in the mode's unit.
    pub legend: Option<[f32; 2]>,
    pub stats: FrameStats,
}

pub fn settings(base: &RenderSettings, look: &ViewSettings) -> RenderSettings {
    let has_depth = matches!(look.mode, Mode::Depth | Mode::Ellipsoids);
    let base = if has_depth { Depth::Mean.requested(*base) } else { *base };
    RenderSettings {
        background: look.background.unwrap_or(base.background),
        sh_degree: look.sh_degree.or(base.sh_degree),
        shape: look.mode.shape(),
        surface: (look.mode == Mode::Normals).then_some(SurfaceDepth::Median),
        scale_modifier: look.scale,
        cut: look.cut.cut(),
        ..base
    }
}

/// In [`Mode::Splats`], a photo's exposure and lens effects are applied. The photo's camera comes with them.
pub fn draw(
    scene: &mut dyn ViewedScene,
    camera: &Camera,
    base: &RenderSettings,
    look: &ViewSettings,
    appearance: Option<(Camera, Appearance)>,
) -> Result<DrawnPicture> {
    let settings = settings(base, look);
    let (mut frame, tiles) = match look.mode {
        Mode::Tiles => {
            let (frame, tiles) = scene.render_with_tiles(camera, &settings)?;
            (frame, Some(tiles))
        }
        _ => (scene.render(camera, &settings)?, None),
    };
    if let (Mode::Splats, Some((taken, appearance))) = (look.mode, &appearance) {
        appearance.apply_as_taken(taken, camera, &mut frame);
    }
    if look.mode == Mode::Normals {
        output::show_normals(&mut frame);
    }
    let (photo, legend) = match (look.mode, tiles) {
        (Mode::Ellipsoids, _) => (outlined(&frame)?, None),
        (Mode::Depth, _) => depth_picture(&frame)?,
        (_, Some(tiles)) => tile_picture(&frame, &tiles)?,
        (_, None) => (output::to_photo(&frame)?, None),
    };
    Ok(DrawnPicture { photo, legend, stats: frame.stats })
}

/// Encodes a JPEG of quality 1 to 100, or a PNG for 0.
pub fn encode(photo: &Photo, quality: u8) -> Result<Vec<u8>> {
    if quality > 0 {
        return output::to_jpeg(photo, quality.min(100));
    }
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub)
        .write_image(&photo.rgb, photo.width, photo.height, ExtendedColorType::Rgb8)
        .map_err(|e| Error::argument("picture", format!("cannot be encoded: {e}")))?;
    Ok(bytes)
}

/// Relative step of depth between neighbours at which an ellipsoid's outline is drawn.
const OUTLINE_STEP: f32 = 0.008;

/// Draws dark outlines where one ellipsoid hides another. All pixels of an ellipsoid have the depth of its mean.
fn outlined(frame: &Frame) -> Result<Photo> {
    let mut photo = output::to_photo(frame)?;
    let depth = Depth::Mean.of(frame);
    let width = frame.width as usize;
    for index in 0..depth.len() {
        let (x, here) = (index % width, depth[index]);
        let right = if x + 1 < width { depth[index + 1] } else { here };
        let below = depth.get(index + width).copied().unwrap_or(here);
        let steps = [right, below].iter().any(|&there| {
            let nearer = here.min(there);
            nearer.is_finite() && (here - there).abs() > OUTLINE_STEP * nearer
        });
        if steps {
            photo.rgb[3 * index..3 * index + 3]
                .iter_mut()
                .for_each(|channel| *channel = (u32::from(*channel) * 13 / 20) as u8);
        }
    }
    Ok(photo)
}

/// Pixels of lower opacity show no depth.
const MIN_OPACITY: f32 = 0.3;

/// Expected depth as a colour, in even steps of 1/z. The range leaves out the nearest and the farthest percent.
fn depth_picture(frame: &Frame) -> Result<(Photo, Option<[f32; 2]>)> {
    let depth = Depth::Mean.of(frame);
    let shown = |index: usize| depth[index].is_finite() && 1.0 - frame.transmittance[index] >= MIN_OPACITY;
    let mut inverse: Vec<f32> =
        (0..depth.len()).filter(|&index| shown(index)).map(|index| depth[index].recip()).collect();
    if inverse.is_empty() {
        return Ok((output::to_photo(frame)?, None));
    }
    let last = inverse.len() - 1;
    let (_, &mut far, _) = inverse.select_nth_unstable_by(last / 100, f32::total_cmp);
    let (_, &mut near, _) = inverse.select_nth_unstable_by(last - last / 100, f32::total_cmp);
    let span = (near - far).max(f32::MIN_POSITIVE);
    let mut color = frame.color.clone();
    for (index, pixel) in color.iter_mut().enumerate() {
        if shown(index) {
            *pixel = turbo((depth[index].recip() - far) / span);
        }
    }
    Ok((Photo::from_f32(frame.width, frame.height, &color)?, Some([near.recip(), far.recip()])))
}

/// Colours each tile by its number of entries (logarithmic), over a dark picture.
fn tile_picture(frame: &Frame, tiles: &TileReport) -> Result<(Photo, Option<[f32; 2]>)> {
    let max = tiles.entries.iter().copied().max().unwrap_or(0).max(1);
    let scale = 1.0 / (1.0 + max as f32).ln();
    let mut color = frame.color.clone();
    for (index, pixel) in color.iter_mut().enumerate() {
        let (x, y) = (index as u32 % frame.width, index as u32 / frame.width);
        let entries = tiles.entries[(y / TILE_SIZE * tiles.columns + x / TILE_SIZE) as usize];
        let heat = turbo((1.0 + entries as f32).ln() * scale);
        let gray = 0.3 * pixel[0] + 0.6 * pixel[1] + 0.1 * pixel[2];
        let line = if x.is_multiple_of(TILE_SIZE) || y.is_multiple_of(TILE_SIZE) { 0.7 } else { 1.0 };
        *pixel = heat.map(|channel| line * (0.62 * channel + 0.38 * gray));
    }
    Ok((Photo::from_f32(frame.width, frame.height, &color)?, Some([0.0, max as f32])))
}

/// Turbo (Mikhailov 2019), polynomial approximation; 0 is dark blue, 1 dark red.
fn turbo(x: f32) -> [f32; 3] {
    let x = x.clamp(0.0, 1.0);
    let polynomial = |c: [f32; 6]| c.iter().rev().fold(0.0, |sum, &c| sum * x + c).clamp(0.0, 1.0);
    [
        polynomial([0.135_721, 4.615_393, -42.660_32, 132.131_08, -152.942_4, 59.286_38]),
        polynomial([0.091_403, 2.194_188, 4.842_967, -14.185_034, 4.277_299, 2.829_566]),
        polynomial([0.106_673, 12.641_946, -60.582_05, 110.362_77, -89.903_11, 27.348_25]),
    ]
}
