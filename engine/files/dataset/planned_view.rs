//! A view before its photo is read.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DMat3, DVec3, Vec3};

use crate::dataset::{AlphaUse, DatasetOptions, View};
use crate::depth_fit::DepthFit;
use crate::host_memory::HostMemory;
use crate::images::{
    Decoded, JpegPhoto, Photo, PhotoFileFormat, Request, StoredPhoto, photo_header, read_as, undistort,
};
use crate::regular_file;
use ashsplat::kernels::constants::TILE_SIZE;
use ashsplat::scene::{Camera, PhotoLens, PicturePart, Projection, Shutter, WorldFrame};
use ashsplat::{Error, Result};

/// True if a photo is rotated by its metadata, and its size after that, if it can be read.
pub(super) type FileSize = (bool, Option<(u32, u32)>);

pub(crate) struct PlannedView {
    pub(crate) name: String,
    /// Number among all views by name, usable or not.
    pub(super) rank: usize,
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
        lens: PhotoLens,
        used: PhotoLens,
        photo_path: PathBuf,
        (turned, file_size): FileSize,
    ) -> Self {
        Self {
            name: String::new(),
            rank: 0,
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

    /// The photo as it is decoded again when it is needed, if it is a JPEG that is neither scaled nor masked.
    pub(super) fn compressed(&self, options: &DatasetOptions) -> Option<JpegPhoto> {
        let size = (self.lens.width, self.lens.height);
        let is_whole = self.mask_path.is_none() && self.rim.is_none() && self.coarse_mask.is_none();
        let is_whole =
            is_whole && self.crop.is_none() && !self.is_undistorted() && self.size(options) == size;
        let is_jpeg = || regular_file::start(&self.photo_path, 2).is_ok_and(|start| start == [0xff, 0xd8]);
        let memory = options.host_memory.clone();
        (is_whole && is_jpeg()).then(|| JpegPhoto {
            path: self.photo_path.clone(),
            turned: self.turned,
            size,
            memory,
        })
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

/// One value per pixel, row-major. A pixel counts if its value is at least [`COUNTS`].
#[derive(Clone)]
pub(super) struct Mask {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) values: Vec<u8>,
}

/// Least mask value of a pixel that counts.
const COUNTS: u8 = 128;

impl Mask {
    /// A mask of any size, to be stretched to its photo: see [`Mask::stretched_to`].
    pub(super) fn coarse(width: u32, height: u32, counts: &[bool]) -> Result<Self> {
        if counts.is_empty() || counts.len() as u64 != u64::from(width) * u64::from(height) {
            let problem = format!("has {} values for {width}x{height} pixels", counts.len());
            return Err(Error::argument("mask", problem));
        }
        let values = counts.iter().map(|&counts| if counts { 255 } else { 0 }).collect();
        Ok(Self { width, height, values })
    }

    /// The mask at another size, with the nearest value for each pixel.
    fn stretched_to(&self, width: u32, height: u32) -> Self {
        let nearest = |at: u32, to: u32, from: u32| {
            ((2 * u64::from(at) + 1) * u64::from(from) / (2 * u64::from(to))) as usize
        };
        let row = |y: u32| nearest(y, height, self.height) * self.width as usize;
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let values = pixels.map(|(x, y)| self.values[row(y) + nearest(x, width, self.width)]).collect();
        Self { width, height, values }
    }

    /// Reads the mask of a photo of this size. A mask of a larger version of the photo is scaled down. The flag is true for a
    /// cut-out: a picture with transparent surroundings, whose alpha channel is the mask.
    pub(super) fn read(
        path: &Path,
        turned: bool,
        (width, height): (u32, u32),
        memory: &HostMemory,
    ) -> Result<(Self, bool)> {
        let size = photo_header(path)?.size(turned);
        if !is_enlarged(size, (width, height)) {
            let problem = format!("is {}x{} pixels, its photo {width}x{height}", size.0, size.1);
            let remedy = "masks must have their photo's size, or be larger with the same proportions";
            return Err(Error::input(path, problem, remedy));
        }
        // The mask's own values, and the scaled ones.
        let besides = 2 * u64::from(size.0) * u64::from(size.1);
        let request = Request { turned, size: Some(size), besides, ..Request::plain(Some([0.0; 3]), memory) };
        let Decoded { photo, alpha, .. } = read_as(path, &request)?;
        let cut_out = alpha.filter(|alpha| is_cut_out(&photo, alpha));
        let is_cut_out = cut_out.is_some();
        let mask = match cut_out {
            Some(values) => Self { width: size.0, height: size.1, values },
            None => Self::of_grey(photo).of_bits(),
        };
        Ok((mask.scaled_to(width, height), is_cut_out))
    }

    fn of_grey(grey: Photo) -> Self {
        let values = grey.rgb.chunks_exact(3).map(|rgb| rgb[0]).collect();
        Self { width: grey.width, height: grey.height, values }
    }

    /// Converts a mask that marks pixels with 1 instead of 255.
    fn of_bits(mut self) -> Self {
        if self.values.iter().all(|&value| value <= 1) {
            self.values.iter_mut().for_each(|value| *value *= 255);
        }
        self
    }

    /// A mask of the pixels whose centres lie within a radius (pixels) around the picture's middle.
    fn disc((width, height): (u32, u32), radius: f64) -> Self {
        let off = |at: u32, side: u32| f64::from(at) + 0.5 - 0.5 * f64::from(side);
        let value = |x: u32, y: u32| {
            if off(x, width).powi(2) + off(y, height).powi(2) <= radius * radius { 255 } else { 0 }
        };
        let values = (0..height).flat_map(|y| (0..width).map(move |x| value(x, y))).collect();
        Self { width, height, values }
    }

    /// A mask of the pixels that count in both masks, which have the same size. A missing mask hides nothing.
    fn of_both(one: Option<Self>, other: Option<Self>) -> Option<Self> {
        let (mut both, other) = match (one, other) {
            (Some(one), Some(other)) => (one, other),
            (one, other) => return one.or(other),
        };
        both.values.iter_mut().zip(&other.values).for_each(|(a, &b)| *a = (*a).min(b));
        Some(both)
    }

    /// The mask for the pinhole camera that replaces a lens.
    pub(super) fn undistorted(&self, lens: &PhotoLens, pinhole: &PhotoLens) -> Self {
        Self::of_grey(undistort(&grey((self.width, self.height), &self.values), lens, pinhole))
    }

    /// Scales the mask. A pixel counts if all pixels that it covers count, since its colour is their mean.
    pub(super) fn scaled_to(self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) {
            return self;
        }
        let covered = |at: u32, to: u32, from: u32| {
            let [at, to, from] = [at, to, from].map(u64::from);
            (at * from / to) as usize..((at + 1) * from).div_ceil(to) as usize
        };
        let lowest = |x: u32, y: u32| {
            let columns = covered(x, width, self.width);
            let rows = covered(y, height, self.height).map(|row| row * self.width as usize);
            rows.flat_map(|row| &self.values[row + columns.start..row + columns.end]).min().copied()
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let values = pixels.map(|(x, y)| lowest(x, y).unwrap_or_default()).collect();
        Self { width, height, values }
    }

    pub(super) fn cut(&self, corner: [u32; 2], size: [u32; 2]) -> Self {
        let values = cut(&self.values, (self.width, 1), corner, size);
        Self { width: size[0], height: size[1], values }
    }

    /// 255 for pixels that count, otherwise 0; `None` if all pixels count.
    pub(super) fn into_values(self) -> Option<Vec<u8>> {
        let value_of = |value: &u8| if *value >= COUNTS { 255 } else { 0 };
        self.hides().then(|| self.values.iter().map(value_of).collect())
    }

    fn hides_all(&self) -> bool {
        self.values.iter().all(|&value| value < COUNTS)
    }

    pub(super) fn hides(&self) -> bool {
        self.values.iter().any(|&value| value < COUNTS)
    }
}

/// True if some pixels are transparent, and many others are neither black nor white.
fn is_cut_out(photo: &Photo, alpha: &[u8]) -> bool {
    const BLACK_OR_WHITE: [u8; 2] = [32, 223];
    let opaque = photo.rgb.as_chunks::<3>().0.iter().zip(alpha).filter(|(_, alpha)| **alpha >= COUNTS);
    let is_between = |value: &u8| (BLACK_OR_WHITE[0]..BLACK_OR_WHITE[1]).contains(value);
    let (mut count, mut between) = (0, 0);
    for (rgb, _) in opaque {
        count += 1;
        between += usize::from(rgb.iter().any(is_between));
    }
    count < alpha.len() && 10 * between > count
}

pub(super) fn grey((width, height): (u32, u32), values: &[u8]) -> Photo {
    Photo { width, height, rgb: values.iter().flat_map(|&value| [value; 3]).collect() }
}

/// True if one size is the other one scaled, with rounded sides.
pub(super) fn is_scaled(one: (u32, u32), other: (u32, u32)) -> bool {
    is_enlarged(one, other) || is_enlarged(other, one)
}

/// True if a picture has the size of another one, or of a larger version that was scaled down to rounded sides.
fn is_enlarged(size: (u32, u32), of: (u32, u32)) -> bool {
    let [a, b] = [(size.0, of.0), (size.1, of.1)].map(|(larger, side)| {
        let [larger, side] = [larger, side].map(f64::from);
        // Range of factors by which the side may have been divided.
        (larger / (side + 1.0), if side > 1.0 { larger / (side - 1.0) } else { f64::INFINITY })
    });
    size == of || (size.0 >= of.0 && size.1 >= of.1 && a.0 < b.1 && b.0 < a.1)
}

/// Reach of a pixel's gradient, pixels: twice the radius of SSIM's window, for the windows that hold the pixel.
const WINDOW: u32 = 10;

/// The used part of a photo, independent of the photo's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crop {
    /// Size of the coarse picture.
    coarse: (u32, u32),
    columns: (u32, u32),
    rows: (u32, u32),
}

impl Crop {
    pub(super) fn of(coarse: (u32, u32), columns: Range<u32>, rows: Range<u32>) -> Result<Self> {
        let lies_in = |range: &Range<u32>, side: u32| !range.is_empty() && range.end <= side;
        if !lies_in(&columns, coarse.0) || !lies_in(&rows, coarse.1) {
            let problem = format!("{columns:?}, {rows:?} is none of {}x{} pixels", coarse.0, coarse.1);
            return Err(Error::argument("part", problem));
        }
        Ok(Self { coarse, columns: (columns.start, columns.end), rows: (rows.start, rows.end) })
    }

    /// Corner and size of the part in a picture of this size, with the border that gradients depend on, in whole tiles.
    pub(super) fn in_picture(self, (width, height): (u32, u32)) -> ([u32; 2], [u32; 2]) {
        let of = |(from, to): (u32, u32), coarse: u32, side: u32| {
            let [from, to, coarse, wide] = [from, to, coarse, side].map(u64::from);
            let (first, end) = ((from * wide / coarse) as u32, (to * wide).div_ceil(coarse) as u32);
            let (first, end) = (first.saturating_sub(WINDOW), (end + WINDOW).min(side));
            let size = (end - first).next_multiple_of(TILE_SIZE).min(side);
            (first.min(side - size), size)
        };
        let (left, width) = of(self.columns, self.coarse.0, width);
        let (top, height) = of(self.rows, self.coarse.1, height);
        ([left, top], [width, height])
    }
}

/// Cuts a part out of a picture that is `whole` pixels wide and has `each` values per pixel.
pub(super) fn cut<T: Copy>(
    values: &[T],
    (whole, each): (u32, usize),
    [left, top]: [u32; 2],
    [width, height]: [u32; 2],
) -> Vec<T> {
    let row = |y: u32| {
        let first = each * (y as usize * whole as usize + left as usize);
        &values[first..first + each * width as usize]
    };
    (top..top + height).flat_map(row).copied().collect()
}

fn cut_photo(photo: &Photo, corner: [u32; 2], size: [u32; 2]) -> Photo {
    let rgb = cut(&photo.rgb, (photo.width, 3), corner, size);
    Photo { width: size[0], height: size[1], rgb }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;

    #[test]
    fn a_part_covers_what_is_wanted_in_whole_tiles_and_no_part_is_refused() {
        let _turn = turn();
        let part = Crop::of((200, 150), 100..104, 0..150).expect("a part");
        // From 640 to 666 of 1280 pixels, with 10 more on each side.
        assert_eq!(part.in_picture((1280, 960)), ([630, 0], [48, 960]));
        // Pixels 50 and 51 of 100, from 40 to 62.
        assert_eq!(part.in_picture((100, 75)), ([40, 0], [32, 75]));
        let last = Crop::of((200, 150), 180..200, 149..150).expect("a part");
        assert_eq!(last.in_picture((100, 75)), ([68, 59], [32, 16]));
        let all = Crop::of((7, 5), 0..7, 0..5).expect("a part");
        assert_eq!(all.in_picture((123, 45)), ([0, 0], [123, 45]));
        for (columns, rows) in [(3..3, 0..5), (0..8, 0..5), (0..7, 5..6)] {
            let part = Crop::of((7, 5), columns.clone(), rows.clone());
            assert!(part.is_err(), "{columns:?} {rows:?} is no part");
        }
    }
}
