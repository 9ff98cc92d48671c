//! One picture of the scene in one of the modes, and its bytes.

use super::cut;
use super::lights::{self, PhotoLights, Places};
use super::protocol::{Look, Mode, ViewRequest};
use ashsplat::kernels::constants::TILE_SIZE;
use ashsplat::scene::WorldFrame;
use ashsplat::{Camera, Error, Frame, Gaussians, PixelReport, RenderSettings, Result, TileReport, Trainer};
use ashsplat_files::Photo;
use ashsplat_program::light::Light;
use ashsplat_program::output::{self, Depth};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use serde_json::{Value, json};
use std::time::Instant;

/// A page by its number, or its film.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Viewer {
    pub page: u64,
    pub films: bool,
}

/// The viewer of the next pictures.
pub struct Audience<'a> {
    pub viewer: Viewer,
    /// Most Gaussians of a picture of a tree of tiles. None: the program's own setting.
    pub budget: Option<u64>,
    /// True if that viewer is still connected.
    pub is_there: &'a dyn Fn(&Viewer) -> bool,
}

/// A scene to look at: finished, or in training.
pub trait Painter {
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame>;
    fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)>;
    fn inspect(&mut self, camera: &Camera, settings: &RenderSettings, pixel: [u32; 2])
    -> Result<PixelReport>;
    /// Returns the current Gaussians.
    fn gaussians(&self) -> Result<Gaussians>;
    /// Frees the memory of pictures. The next picture allocates what it needs.
    fn shrink(&mut self);
    /// Iterations of training so far.
    fn iteration(&self) -> Option<u32> {
        None
    }
    /// Returns the current exposure and lens effects of a training view.
    fn light(&self, _: Places) -> Result<Light> {
        Ok(Light::default())
    }
    /// Sets the viewer of the next pictures.
    fn attend(&mut self, _: &Audience<'_>) {}
    /// True if all parts of the scene that this camera needs are loaded; requests those that are missing.
    fn is_ready(&mut self, _: &Camera) -> Result<bool> {
        Ok(true)
    }
    /// How complete the last picture of a tree of tiles is.
    fn tree(&self) -> Option<&Value> {
        None
    }
}

impl Painter for Trainer {
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

    fn gaussians(&self) -> Result<Gaussians> {
        self.baked_gaussians()
    }

    fn shrink(&mut self) {
        self.shrink_pictures();
    }

    fn iteration(&self) -> Option<u32> {
        Some(Trainer::iteration(self))
    }

    fn light(&self, places: Places) -> Result<Light> {
        lights::of_training(self, places)
    }
}

pub struct Drawn {
    pub photo: Photo,
    /// Values of the lowest and the highest colour, in the mode's unit.
    pub legend: Option<[f32; 2]>,
    pub stats: Value,
}

/// Render settings for a look.
pub fn settings(base: &RenderSettings, look: &Look) -> RenderSettings {
    let has_depth = matches!(look.mode, Mode::Depth | Mode::Ellipsoids);
    let base = if has_depth { Depth::Mean.requested(*base) } else { *base };
    RenderSettings {
        background: look.background.unwrap_or(base.background),
        sh_degree: look.sh_degree.or(base.sh_degree),
        shape: look.mode.shape(),
        scale_modifier: look.scale,
        cut: look.cut.cut(),
        ..base
    }
}

/// In [`Mode::Splats`], a photo's exposure and lens effects are applied. The photo's camera comes with them.
pub fn draw(
    painter: &mut dyn Painter,
    camera: &Camera,
    base: &RenderSettings,
    look: &Look,
    light: Option<(Camera, Light)>,
) -> Result<Drawn> {
    let settings = settings(base, look);
    let (frame, photo, legend) = match look.mode {
        Mode::Splats | Mode::Centres => {
            let mut frame = painter.render(camera, &settings)?;
            if let (Mode::Splats, Some((taken, light))) = (look.mode, &light) {
                light.apply_as_taken(taken, camera, &mut frame);
            }
            let photo = output::to_photo(&frame)?;
            (frame, photo, None)
        }
        Mode::Ellipsoids => {
            let frame = painter.render(camera, &settings)?;
            let photo = outlined(&frame)?;
            (frame, photo, None)
        }
        Mode::Depth => {
            let frame = painter.render(camera, &settings)?;
            let (photo, legend) = depth_picture(&frame)?;
            (frame, photo, legend)
        }
        Mode::Tiles => {
            let (frame, tiles) = painter.render_with_tiles(camera, &settings)?;
            let (photo, legend) = tile_picture(&frame, &tiles)?;
            (frame, photo, Some(legend))
        }
    };
    let s = &frame.stats;
    let stats = json!({
        "gaussians": s.gaussians, "visible": s.visible, "instances": s.instances, "longest_tile": s.longest_tile,
    });
    Ok(Drawn { photo, legend, stats })
}

/// Answers a request for a frame: header and bytes.
pub fn answer(
    painter: &mut dyn Painter,
    (base, lights, frame): (&RenderSettings, &PhotoLights, &WorldFrame),
    request: &ViewRequest,
) -> Result<(Value, Vec<u8>)> {
    let camera = request.camera.camera()?;
    let light = request.as_photo.map(|photo| lights.of(photo, painter)).transpose()?;
    let start = Instant::now();
    let drawn = draw(painter, &camera, base, &request.look, light)?;
    let render_ms = start.elapsed().as_secs_f64() * 1e3;
    let start = Instant::now();
    let bytes = encode(&drawn.photo, request.look.quality)?;
    let encode_ms = start.elapsed().as_secs_f64() * 1e3;
    let settings = settings(base, &request.look);
    let header = json!({
        "seq": request.seq, "width": camera.width, "height": camera.height,
        "format": if request.look.quality == 0 { "image/png" } else { "image/jpeg" },
        "render_ms": render_ms, "encode_ms": encode_ms, "stats": drawn.stats, "legend": drawn.legend,
        "iteration": painter.iteration(),
        "tree": painter.tree(),
        // Options and address that make the same cut of the file.
        "convert": cut::options(&settings, frame),
        "export": cut::query(&settings),
    });
    Ok((header, bytes))
}

/// Encodes a JPEG of quality 1 to 100, or a PNG for 0.
pub fn encode(photo: &Photo, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let (width, height) = (photo.width, photo.height);
    let written =
        match quality {
            0 => PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub)
                .write_image(&photo.rgb, width, height, ExtendedColorType::Rgb8),
            quality => JpegEncoder::new_with_quality(&mut bytes, quality.min(100)).write_image(
                &photo.rgb,
                width,
                height,
                ExtendedColorType::Rgb8,
            ),
        };
    written.map_err(|e| Error::argument("picture", format!("cannot be encoded: {e}")))?;
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
const LEAST_OPACITY: f32 = 0.3;

/// Expected depth as a colour, in even steps of 1/z. The range leaves out the nearest and the farthest percent.
fn depth_picture(frame: &Frame) -> Result<(Photo, Option<[f32; 2]>)> {
    let depth = Depth::Mean.of(frame);
    let shown = |index: usize| depth[index].is_finite() && 1.0 - frame.transmittance[index] >= LEAST_OPACITY;
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
fn tile_picture(frame: &Frame, tiles: &TileReport) -> Result<(Photo, [f32; 2])> {
    let most = tiles.entries.iter().copied().max().unwrap_or(0).max(1);
    let scale = 1.0 / (1.0 + most as f32).ln();
    let mut color = frame.color.clone();
    for (index, pixel) in color.iter_mut().enumerate() {
        let (x, y) = (index as u32 % frame.width, index as u32 / frame.width);
        let entries = tiles.entries[(y / TILE_SIZE * tiles.columns + x / TILE_SIZE) as usize];
        let heat = turbo((1.0 + entries as f32).ln() * scale);
        let gray = 0.3 * pixel[0] + 0.6 * pixel[1] + 0.1 * pixel[2];
        let line = if x.is_multiple_of(TILE_SIZE) || y.is_multiple_of(TILE_SIZE) { 0.7 } else { 1.0 };
        *pixel = heat.map(|channel| line * (0.62 * channel + 0.38 * gray));
    }
    Ok((Photo::from_f32(frame.width, frame.height, &color)?, [0.0, most as f32]))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_go_from_blue_to_red() {
        let [low, middle, high] = [0.1, 0.5, 0.9].map(turbo);
        assert!(low[2] > low[0] && middle[1] > middle[0] && high[0] > high[2], "{low:?} {middle:?} {high:?}");
    }

    #[test]
    fn pictures_are_encoded() {
        let photo = Photo { width: 5, height: 3, rgb: (0..45).collect() };
        let png = encode(&photo, 0).expect("a PNG");
        assert_eq!(image::load_from_memory(&png).expect("a picture").to_rgb8().into_raw(), photo.rgb);
        assert_eq!(&encode(&photo, 80).expect("a JPEG")[..2], [0xFF, 0xD8]);
    }
}
