//! Scale and offset of inverse-depth maps, which monocular depth networks leave open. They are fitted to the sparse
//! points, as in the reference implementation's `make_depth_scale.py`.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use super::images::DepthMap;
use super::{cost, text};
use ashsplat::{Error, Result};

/// Name of the file with the parameters, beside a COLMAP model.
pub const DEPTH_PARAMS_FILE: &str = "depth_params.json";

/// A fit needs more than this many points.
const FEWEST: usize = 10;
/// Least range of the points' inverse depths, 1 / world units.
const LEAST_RANGE: f64 = 1e-3;
/// A map is skipped if its scale is outside of this range, times the median.
const RELIABLE: [f64; 2] = [0.2, 5.0];

/// Inverse depth of a map's value, 1 / world units: `scale * value + offset`. Both are 0 if the map cannot be fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub struct DepthFit {
    /// Factor.
    pub scale: f64,
    /// Summand.
    pub offset: f64,
}

/// A sparse point and its place in a photo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthPoint {
    /// Position in the photo, pixels of its camera.
    pub position_px: [f64; 2],
    /// 1 / z in the camera's frame, 1 / world units.
    pub inverse_z: f64,
}

impl DepthFit {
    /// Fits a map to its photo's points: medians and mean absolute deviations agree. `camera_size`: of the photo's camera.
    /// The flag is true if the map's values fall as points come nearer: it then holds depths.
    pub fn of(map: &DepthMap, camera_size: (u32, u32), points: &[DepthPoint]) -> (Self, bool) {
        let ratio = f64::from(map.height) / f64::from(camera_size.1.max(1));
        let ends = [camera_size.0, camera_size.1].map(|side| f64::from(side) * ratio);
        let mut pairs = Vec::new();
        for point in points {
            cost::step();
            let [x, y] = point.position_px.map(|place| f64::from((place * ratio) as f32));
            let inside = x >= 0.0 && y >= 0.0 && x < ends[0] && y < ends[1];
            if inside && point.inverse_z > 0.0 {
                pairs.push((point.inverse_z, map.sample(x, y)));
            }
        }
        let all = points.iter().map(|point| point.inverse_z);
        let range = all.clone().fold(f64::NEG_INFINITY, f64::max) - all.fold(f64::INFINITY, f64::min);
        if pairs.len() <= FEWEST || range.is_nan() || range <= LEAST_RANGE {
            return (Self::default(), false);
        }
        let (depths, values): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
        let (middle, middle_of_map) = (median(depths.clone()), median(values.clone()));
        let deviation = |all: &[f64], middle: f64| {
            all.iter().map(|value| (value - middle).abs()).sum::<f64>() / all.len() as f64
        };
        let scale = deviation(&depths, middle) / deviation(&values, middle_of_map);
        let together: f64 =
            depths.iter().zip(&values).map(|(depth, value)| (depth - middle) * (value - middle_of_map)).sum();
        let fit = match scale.is_finite() {
            true => Self { scale, offset: middle - scale * middle_of_map },
            // A map with a single value cannot be fitted.
            false => Self::default(),
        };
        (fit, together < 0.0)
    }

    /// The median of all positive scales; 0 if there are none.
    pub fn median_scale<'a>(fits: impl IntoIterator<Item = &'a Self>) -> f64 {
        median(fits.into_iter().map(|fit| fit.scale).filter(|&scale| scale > 0.0).collect())
    }

    /// True if a map may be used beside others of this median scale.
    pub fn is_reliable(&self, median_scale: f64) -> bool {
        let [low, high] = RELIABLE;
        self.scale > 0.0 && self.scale >= low * median_scale && self.scale <= high * median_scale
    }

    /// Reads `depth_params.json`: an object from photos' names without extension to scale and offset.
    pub fn read_all(path: impl AsRef<Path>) -> Result<BTreeMap<String, Self>> {
        let path = path.as_ref();
        let remedy =
            "expected {\"photo\": {\"scale\": 1.5, \"offset\": 0.1}, …}; without the file, they are fitted";
        let fits: BTreeMap<String, Self> = text::json(path, "a list of depth parameters", remedy)?;
        let finite = |fit: &Self| {
            cost::step();
            (fit.scale as f32).is_finite() && (fit.offset as f32).is_finite()
        };
        match fits.iter().find(|(_, fit)| !finite(fit)) {
            None => Ok(fits),
            Some((name, _)) => {
                Err(Error::input(path, format!("{name} has a number that is too large"), remedy))
            }
        }
    }
}

/// The middle value, or the mean of the two middle ones; 0 without values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        odd if odd % 2 == 1 => values[odd / 2],
        even => 0.5 * (values[even / 2 - 1] + values[even / 2]),
    }
}
