//! Reading Gaussians and points from PLY files.

use std::path::Path;

use super::header::Element;
use super::rows::PlyFile;
use crate::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use crate::scene::{Gaussians, PointCloud};
use crate::{Error, Result};

/// Largest usable coordinate: the square of a larger one overflows.
const MAX_COORDINATE: f32 = 1e18;

/// Largest usable log-scale: the exponential of a larger one overflows.
const MAX_LOG_SCALE: f32 = 88.0;

/// How to read Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlyOptions {
    /// Leave out Gaussians with unusable parameters instead of refusing the file.
    pub drop_invalid: bool,
}

/// Gaussians from a file, and what was left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlyScene {
    /// The usable Gaussians, in the file's order.
    pub gaussians: Gaussians,
    /// Number of Gaussians that were left out because a parameter is not usable.
    pub dropped: u64,
    /// Which those are, in words ("5 of 16 Gaussians have …, first vertex 0: x = NaN").
    pub warning: Option<String>,
}

/// Reads Gaussians: any property order, encoding and scalar type; more properties and elements are ignored; the
/// SH degree follows from the number of `f_rest` properties.
///
/// A parameter is unusable when it is not finite, except an opacity logit of ±∞ (opacity 1 or 0), when a
/// coordinate exceeds 1e18 or a log-scale 88 (both overflow in the projection).
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Input`] when it is not a PLY file with Gaussians, is cut
/// short or damaged, or has unusable parameters and [`PlyOptions::drop_invalid`] is not set.
pub fn read(path: impl AsRef<Path>, options: &PlyOptions) -> Result<PlyScene> {
    let path = path.as_ref();
    let mut file = PlyFile::open(path)?;
    let element = file.seek_element("vertex")?;
    let layout = Layout::new(path, &element)?;
    let mut gaussians = Gaussians::with_capacity(layout.sh_degree, capacity(&element));
    let mut invalid = Invalid { count: 0, first: None };
    file.for_each_row(&element, &layout.names, |index, row| match layout.unusable(row) {
        None => layout.push(row, &mut gaussians),
        Some(column) => {
            invalid.count += 1;
            invalid.first.get_or_insert_with(|| (index, column, row[column]));
        }
    })?;
    let warning = invalid.describe(&element, &layout);
    match warning {
        Some(problem) if !options.drop_invalid => {
            Err(Error::input(path, problem, "--drop-invalid leaves them out"))
        }
        warning => Ok(PlyScene { gaussians, dropped: invalid.count, warning }),
    }
}

/// Reads coloured points: x y z and red green blue (0 to 255), by name; white where there are no colours.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read, [`Error::Input`] when it is no PLY file with points, is cut short or
/// damaged, or has a position that is not finite.
pub fn read_points(path: impl AsRef<Path>) -> Result<PointCloud> {
    let path = path.as_ref();
    let mut file = PlyFile::open(path)?;
    let element = file.seek_element("vertex")?;
    let coloured = ["red", "green", "blue"].iter().all(|name| element.has(name));
    let names = if coloured { &["x", "y", "z", "red", "green", "blue"][..] } else { &["x", "y", "z"] };
    let names: Vec<String> = names.iter().map(|name| name.to_string()).collect();
    let mut points = PointCloud::default();
    points.positions.reserve(capacity(&element));
    points.colors.reserve(capacity(&element));
    let mut bad = None;
    file.for_each_row(&element, &names, |index, row| {
        if row[..3].iter().any(|v| !v.is_finite()) {
            bad.get_or_insert(index);
        }
        points.positions.push([row[0], row[1], row[2]]);
        let color = if coloured { [row[3], row[4], row[5]] } else { [255.0; 3] };
        points.colors.push(color.map(|c| c.round().clamp(0.0, 255.0) as u8));
    })?;
    match bad {
        None => Ok(points),
        Some(index) => Err(Error::input(path, format!("vertex {index}: the position is not finite"), "")),
    }
}

/// Rows to reserve for; the header's count was checked against the file's size.
fn capacity(element: &Element) -> usize {
    usize::try_from(element.count).unwrap_or(0)
}

/// Where the parameters stand in a row: `x y z opacity scale_* rot_* f_dc_* f_rest_*`.
struct Layout {
    names: Vec<String>,
    sh_degree: u32,
}

const OPACITY: usize = 3;
const SCALE: usize = 4;
const QUATERNION: usize = 7;
const SH_DC: usize = 11;
const SH_REST: usize = 14;
const REQUIRED: [&str; SH_REST] = [
    "x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "f_dc_0",
    "f_dc_1", "f_dc_2",
];

impl Layout {
    fn new(path: &Path, element: &Element) -> Result<Self> {
        if let Some(missing) = REQUIRED.iter().find(|name| !element.has(name)) {
            return Err(missing_property(path, element, missing));
        }
        let rest = element.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
        let gap = (0..rest).find(|i| !element.has(&format!("f_rest_{i}")));
        let degree = (0..=MAX_SH_DEGREE).find(|&d| rest == 3 * (sh_coefficients(d) - 1));
        match (gap, degree) {
            (None, Some(sh_degree)) => {
                let rest = (0..rest).map(|i| format!("f_rest_{i}"));
                let names = REQUIRED.iter().map(|name| name.to_string()).chain(rest).collect();
                Ok(Self { names, sh_degree })
            }
            (Some(gap), _) => {
                let problem = format!("property f_rest_{gap} is missing, though there are {rest} of f_rest");
                Err(Error::input(path, problem, "write the file again with all of them"))
            }
            (None, None) => {
                let problem = format!("{rest} f_rest properties fit no SH degree");
                Err(Error::input(path, problem, "degrees 0 to 3 have 0, 9, 24 and 45"))
            }
        }
    }

    /// The first column with an unusable value.
    fn unusable(&self, row: &[f32]) -> Option<usize> {
        row.iter().enumerate().position(|(column, &value)| match column {
            0..OPACITY => !value.is_finite() || value.abs() > MAX_COORDINATE,
            OPACITY => value.is_nan(),
            SCALE..QUATERNION => !value.is_finite() || value > MAX_LOG_SCALE,
            _ => !value.is_finite(),
        })
    }

    fn push(&self, row: &[f32], gaussians: &mut Gaussians) {
        gaussians.means.push([row[0], row[1], row[2]]);
        gaussians.opacity_logits.push(row[OPACITY]);
        gaussians.log_scales.push([row[SCALE], row[SCALE + 1], row[SCALE + 2]]);
        gaussians.quats.push(std::array::from_fn(|i| row[QUATERNION + i]));
        gaussians.sh.push([row[SH_DC], row[SH_DC + 1], row[SH_DC + 2]]);
        let rest = &row[SH_REST..];
        let per_channel = rest.len() / 3;
        gaussians
            .sh
            .extend((0..per_channel).map(|i| [0, 1, 2].map(|channel| rest[channel * per_channel + i])));
    }
}

/// Says what the file is when it holds no Gaussians.
fn missing_property(path: &Path, element: &Element, missing: &str) -> Error {
    if element.has("packed_position") {
        let problem = "is a compressed PLY (packed_position), which is not read yet";
        return Error::input(
            path,
            problem,
            "convert it to a plain PLY first, for example with splat-transform",
        );
    }
    let any_gaussian_property = REQUIRED[OPACITY..].iter().any(|name| element.has(name));
    if !any_gaussian_property && element.has("x") {
        let problem = format!("is a point cloud or mesh, not Gaussians (property {missing} is missing)");
        return Error::input(path, problem, "give a point_cloud.ply that training wrote");
    }
    Error::input(
        path,
        format!("property {missing} of element vertex is missing"),
        "is it a file of Gaussians?",
    )
}

/// Gaussians with unusable parameters.
struct Invalid {
    count: u64,
    /// Row, column and value of the first.
    first: Option<(u64, usize, f32)>,
}

impl Invalid {
    fn describe(&self, element: &Element, layout: &Layout) -> Option<String> {
        let (row, column, value) = self.first?;
        let kind = if value.is_finite() { "too large" } else { "not finite" };
        let name = &layout.names[column];
        let (bad, all) = (self.count, element.count);
        let have = if bad == 1 { "Gaussian has" } else { "Gaussians have" };
        Some(format!(
            "{bad} of {all} {have} unusable parameters; the first, vertex {row}: {name} = {value} is {kind}"
        ))
    }
}
