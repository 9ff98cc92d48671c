//! A view before its photo is read.

use std::path::PathBuf;
use std::sync::Arc;

use glam::{DMat3, DVec3, Vec3};

use super::View;
use super::crop::{Crop, cut_photo};
use super::mask::{Mask, grey};
use super::options::{AlphaUse, DatasetOptions};
use crate::depth_fit::DepthFit;
use crate::images::{Decoded, Photo, PhotoFileFormat, Request, StoredPhoto, read_as, undistort};
use ashsplat::Result;
use ashsplat::scene::{Camera, PhotoLens, PicturePart, Projection, Shutter, WorldFrame};

/// True if a photo is rotated by its metadata, and its size after that, if it can be read.
pub(super) type FileSize = (bool, Option<(u32, u32)>);

pub(crate) struct PlannedView {
    pub(crate) name: String,
    pub(super) image_id: u32,
    pub(super) camera_id: u32,
    /// Rotation and translation from source coordinates to the camera; with a rolling shutter to that halfway.
    pub(super) camera_from_source: DMat3,
    pub(super) translation: DVec3,
    /// Rolling shutter, in source units.
    pub(super) shutter: Option<Shutter>,
    pub(super) frame: WorldFrame,
    /// The lens at the photo's size.
    pub(super) lens: PhotoLens,
    /// The lens of the picture that is used: the same, or the pinhole that replaces it.
    pub(super) used: PhotoLens,
    pub(super) photo_path: PathBuf,
    /// True if the photo is rotated by its metadata.
    pub(super) turned: bool,
    /// Width and height after that rotation, if the photo can be read.
    pub(super) file_size: Option<(u32, u32)>,
    /// The photo's mask file. `coarse_mask` hides further pixels.
    pub(super) mask_path: Option<PathBuf>,
    /// Radius around the middle beyond which the photo shows nothing, as a share of its width.
    pub(super) rim: Option<f64>,
    pub(super) coarse_mask: Option<Mask>,
    /// The used part of the photo; `None` for the whole.
    pub(super) crop: Option<Crop>,
    pub(super) held_out: bool,
    /// The inverse-depth map that is read with the photo.
    pub(super) map: Option<PlannedMap>,
    /// The points that the photo shows, after [`Gallery::read_tracks`](super::Gallery::read_tracks).
    pub(super) track: Option<Track>,
}

/// An inverse-depth map that is read with its photo.
#[derive(Clone, Debug)]
pub(super) struct PlannedMap {
    pub(super) path: PathBuf,
    /// Maps the values to inverse depths, 1 / world units.
    pub(super) fit: DepthFit,
}

/// Positions of points, world.
pub(super) type Track = Arc<[Vec3]>;

/// Findings in the pixels of a photo.
pub(super) struct PhotoUse {
    pub(super) is_hidden: bool,
    /// See [`Mask::read`].
    pub(super) mask_is_cut_out: bool,
    /// True if its alpha channel has transparent pixels.
    pub(super) is_transparent: bool,
    /// See [`Decoded::gamma`].
    pub(super) gamma: Option<f32>,
    /// True for a fisheye's photo whose corners are black and count.
    pub(super) is_round: bool,
}

impl PlannedView {
    /// A view at the origin with its whole photo, and without a name.
    pub(super) fn of(
        (lens, used): (PhotoLens, PhotoLens),
        photo_path: PathBuf,
        (turned, file_size): FileSize,
    ) -> Self {
        Self {
            name: String::new(),
            image_id: 0,
            camera_id: 0,
            camera_from_source: DMat3::IDENTITY,
            translation: DVec3::ZERO,
            shutter: None,
            frame: WorldFrame::default(),
            lens,
            used,
            photo_path,
            turned,
            file_size,
            mask_path: None,
            rim: None,
            coarse_mask: None,
            crop: None,
            held_out: false,
            map: None,
            track: None,
        }
    }

    /// True if the view is trained on, as a whole or as a half.
    pub(super) fn is_trained(&self, options: &DatasetOptions) -> bool {
        !self.held_out || options.train_test_exp
    }

    /// True if the photo is replaced by a pinhole's.
    pub(super) fn is_undistorted(&self) -> bool {
        self.used.projection != self.lens.projection
    }

    /// The view's camera at the size of its file.
    pub(crate) fn camera(&self) -> Camera {
        self.camera_in(&self.frame)
    }

    pub(super) fn camera_in(&self, frame: &WorldFrame) -> Camera {
        let translation = frame.translation(self.camera_from_source, self.translation);
        let camera = self.used.camera(self.camera_from_source.as_mat3(), translation);
        Camera { shutter: self.shutter.map(|shutter| shutter.in_units(frame.unit)), ..camera }
    }

    /// The camera's centre, source coordinates.
    pub(super) fn source_position(&self) -> DVec3 {
        -(self.camera_from_source.transpose() * self.translation)
    }

    /// Depth of a point in source coordinates, source units; `None` if the point is out of view.
    pub(super) fn depth_of(&self, point: DVec3) -> Option<f64> {
        let halfway = self.camera_from_source * point + self.translation;
        let p = self.shutter.map_or(Some(halfway), |shutter| shutter.reading_of(&self.used, halfway))?;
        self.used.shows(p).then(|| self.used.projection.depth_of(p))
    }

    /// Reads the photo, scaled and, if wanted, undistorted, with its mask.
    pub(super) fn load(&self, options: &DatasetOptions) -> Result<(View, PhotoUse)> {
        let (lens, used, is_undistorted) = (self.lens, self.used, self.is_undistorted());
        let memory = &options.host_memory;
        let own = (lens.width, lens.height);
        // Reads one file at a time: a thread that waits for memory must hold none.
        let mask =
            self.mask_path.as_ref().map(|path| Mask::read(path, self.turned, own, memory)).transpose()?;
        let (mask, mask_is_cut_out) = mask.map_or((None, false), |(mask, cut_out)| (Some(mask), cut_out));
        let mask = Mask::of_both(mask, self.rim.map(|rim| Mask::disc(own, rim * f64::from(own.0))));
        let scaled = options.resolution.apply(used.width, used.height);
        let bytes = |width: u32, height: u32| u64::from(width) * u64::from(height);
        let (before, after) = (bytes(lens.width, lens.height), bytes(used.width, used.height));
        let masks = if mask.is_some() { 2 * before } else { 0 };
        let keeps_opacity = options.keep_opacity && options.alpha == AlphaUse::Target;
        let opacity = if keeps_opacity { 3 * (before + after + bytes(scaled.0, scaled.1)) } else { 0 };
        let besides = opacity
            + match is_undistorted {
                false => masks,
                true => masks + 3 * after + 3 * bytes(scaled.0, scaled.1) + 2 * masks,
            };
        let request = Request {
            background: (options.alpha != AlphaUse::Ignore).then(|| options.background()),
            turned: self.turned,
            size: Some(own),
            // Photos are scaled after they are undistorted.
            scaled: (!is_undistorted).then_some(scaled),
            besides,
            memory,
        };
        let Decoded { mut photo, alpha, gamma, lease } = read_as(&self.photo_path, &request)?;
        let mut opacity = alpha.as_ref().filter(|_| keeps_opacity).map(|alpha| grey(own, alpha));
        let alpha = alpha.map(|values| Mask { width: own.0, height: own.1, values });
        let is_transparent = alpha.as_ref().is_some_and(Mask::hides);
        let mut mask = Mask::of_both(mask, alpha.filter(|_| options.alpha == AlphaUse::Mask));
        let is_fisheye =
            used.projection.orders_by_distance() && used.projection != Projection::Equirectangular;
        let is_round = is_fisheye && mask.is_none() && has_black_corners(&photo);
        if is_undistorted {
            mask = mask.map(|mask| mask.undistorted(&lens, &used));
            opacity = opacity.map(|opacity| undistort(&opacity, &lens, &used));
            photo = undistort(&photo, &lens, &used).scaled_to(scaled.0, scaled.1)?;
        }
        let opacity = opacity.map(|opacity| opacity.scaled_to(scaled.0, scaled.1)).transpose()?;
        drop(lease);
        let is_hidden = mask.as_ref().is_some_and(Mask::hides_all);
        let photo_use = PhotoUse { is_hidden, mask_is_cut_out, is_transparent, gamma, is_round };
        Ok((self.view_of(photo, opacity, mask)?, photo_use))
    }

    /// Size at which the photo or its part will be used.
    pub(super) fn size(&self, options: &DatasetOptions) -> (u32, u32) {
        self.used_of(options.resolution.apply(self.used.width, self.used.height))
    }

    /// Camera of the photo's crop, at the loaded size.
    pub(super) fn used_camera(&self, options: &DatasetOptions) -> Result<Camera> {
        let (width, height) = options.resolution.apply(self.used.width, self.used.height);
        self.part_of(self.camera().scaled_to(width, height))
    }

    /// Camera of the used part of `camera`'s picture.
    fn part_of(&self, camera: Camera) -> Result<Camera> {
        match self.crop.map(|part| part.in_picture((camera.width, camera.height))) {
            Some((corner, size)) => camera.part(corner, size),
            None => Ok(camera),
        }
    }

    /// Share of the photo that is used, at the camera's own size.
    pub(super) fn share_used(&self) -> f64 {
        let pixels = |(width, height): (u32, u32)| f64::from(width) * f64::from(height);
        let whole = (self.used.width, self.used.height);
        pixels(self.used_of(whole)) / pixels(whole)
    }

    /// Size of the used part of a picture of size `whole`.
    fn used_of(&self, whole: (u32, u32)) -> (u32, u32) {
        self.crop.map_or(whole, |part| part.in_picture(whole).1.into())
    }

    /// Estimated bytes of the photo and its mask. A device needs about as much.
    pub(super) fn texel_bytes(&self, options: &DatasetOptions) -> u64 {
        let (width, height) = self.size(options);
        4 * u64::from(width) * u64::from(height)
    }

    /// The view of a photo, its opacity in grey, and its mask at the file's size.
    fn view_of(&self, mut photo: Photo, mut opacity: Option<Photo>, mask: Option<Mask>) -> Result<View> {
        let original_camera = self.camera();
        let (width, height) = (photo.width, photo.height);
        let coarse = self.coarse_mask.as_ref().map(|mask| mask.stretched_to(width, height));
        let mut mask = Mask::of_both(mask.map(|mask| mask.scaled_to(width, height)), coarse);
        let camera = self.part_of(original_camera.scaled_to(width, height))?;
        if let Some(PicturePart { left, top, .. }) = camera.part {
            let (corner, size) = ([left, top], [camera.width, camera.height]);
            photo = cut_photo(&photo, corner, size);
            opacity = opacity.map(|opacity| cut_photo(&opacity, corner, size));
            mask = mask.map(|mask| mask.cut(corner, size));
        }
        let mask = mask.and_then(Mask::into_values);
        let photo = match opacity {
            None => StoredPhoto::new(photo, mask),
            Some(grey) => {
                let opacity: Vec<u8> = grey.rgb.into_iter().step_by(3).collect();
                StoredPhoto::with_opacity(photo, &opacity, mask)
            }
        };
        Ok(View {
            name: self.name.clone(),
            image_id: self.image_id,
            camera_id: self.camera_id,
            camera,
            original_camera,
            photo,
            inverse_depth: None,
            depth_points: None,
        })
    }
}

/// True if the corners are black and the middle is not.
fn has_black_corners(photo: &Photo) -> bool {
    const BLACK: u8 = 8;
    let pixels = photo.rgb.as_chunks::<3>().0;
    let (width, count) = (photo.width as usize, pixels.len());
    let is_black = |at: usize| pixels.get(at).is_some_and(|rgb| rgb.iter().all(|&value| value <= BLACK));
    let corners = [0, width.saturating_sub(1), count.saturating_sub(width), count.saturating_sub(1)];
    corners.into_iter().all(is_black) && !is_black(count / 2 + width / 2)
}
