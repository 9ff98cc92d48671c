//! Cameras of RealityScan, once RealityCapture: "Internal/External camera parameters" as CSV, and XMP files beside the photos.
//!
//! "RealityCapture XMP Camera Math" (support.capturingreality.com) gives the pose of an XMP: "the rotation is stored row wise",
//! `x = [R t] X` and `t = -R * Position`, and says that picture coordinates "are always in range <-0.5, 0.5>". Focal lengths are of
//! 36 mm film. Both are shares of a photo's longer side, as AliceVision and nerfstudio read them. Of the CSV there is no such page:
//! its angles are read as nerfstudio and Brush do. The article says that the lens "by default is set to Brown3, which stands for
//! 3-parametric polynomial Brown model without tangential distorsion". Those two programs take t1 and t2 for OpenCV's p1 and p2,
//! AliceVision for p2 and p1: they are refused.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use roxmltree::Node;

use super::{Lens, Scene, numbers, parse_xml, perspective, posed, rotation};
use crate::names::{entries, has_one_of};
use crate::{regular_file, text};
use ashsplat::{Error, Result};

/// Namespace of the properties in an XMP.
pub(super) const NAMESPACE: &str = "http://www.capturingreality.com/ns/xcr/1.1#";
/// Width of the film to which focal lengths refer, mm.
const FILM: f64 = 36.0;

/// The columns of a CSV, by name.
pub(super) struct Columns(HashMap<String, usize>);

impl Columns {
    const REQUIRED: [&'static str; 8] = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f"];

    /// The columns that the first line names; `None` if it is no list of cameras.
    pub(super) fn of(text: &str) -> Option<Self> {
        let line = text.trim_start_matches(text::MARK).lines().find(|line| !line.trim().is_empty())?;
        let name = |name: &str| name.trim().trim_start_matches('#').trim().to_ascii_lowercase();
        let columns = Self(line.split(',').enumerate().map(|(at, own)| (name(own), at)).collect());
        Self::REQUIRED.iter().all(|name| columns.0.contains_key(*name)).then_some(columns)
    }
}

pub(super) fn read_csv(path: &Path, size_of: &mut dyn FnMut(&str) -> Result<(u32, u32)>) -> Result<Scene> {
    const AGAIN: &str = "export the camera parameters again";
    let text = text::from_bytes(path, regular_file::read(path, 2)?)?;
    let columns = Columns::of(&text).ok_or_else(|| Error::input(path, "has no columns of cameras", AGAIN))?;
    let mut scene = Scene::default();
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).skip(1);
    for (index, (number, line)) in lines.enumerate() {
        let error = |problem: String| Error::input(path, format!("line {}: {problem}", number + 1), AGAIN);
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let field = |name: &str| columns.0.get(name).map(|&at| fields.get(at).copied().unwrap_or_default());
        let value = |name: &str| match field(name) {
            None => Ok(0.0),
            Some(word) => numbers::<1>(word)
                .map(|[value]| value)
                .ok_or_else(|| error(format!("{name} is not a number{}", text::not_a_number(word)))),
        };
        let name = field("name").unwrap_or_default();
        if name.is_empty() {
            return Err(error("names no photo".into()));
        }
        let size = size_of(name)?;
        let lens = FilmLens {
            focal_mm: value("f")?,
            center: [value("px")?, value("py")?],
            k: [value("k1")?, value("k2")?, value("k3")?, value("k4")?],
            tangential: [value("t1")?, value("t2")?],
        };
        let camera = scene.camera(size, lens.in_pixels(size).map_err(error)?);
        let [heading, pitch, roll] =
            [value("heading")?, value("pitch")?, value("roll")?].map(f64::to_radians);
        // From a camera that looks down with the picture's top to the north.
        let turn =
            DMat3::from_rotation_z(-heading) * DMat3::from_rotation_x(pitch) * DMat3::from_rotation_y(roll);
        let axes = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * turn.transpose();
        let center = DVec3::new(value("x")?, value("y")?, value("alt")?);
        scene.images.push(posed((index as u32, camera), name, axes, center));
    }
    if scene.images.is_empty() {
        return Err(Error::input(path, "lists no cameras", AGAIN));
    }
    let (count, cameras) = (scene.images.len(), scene.cameras.len());
    scene.note = format!(
        "{}: RealityScan's cameras of {count} photos, with {cameras} lenses; k1 to k4 are taken as those of its models Brown3 and Brown4",
        path.display()
    );
    Ok(scene)
}

pub(super) fn read_xmp(folder: &Path, size_of: &mut dyn FnMut(&str) -> Result<(u32, u32)>) -> Result<Scene> {
    let mut files: Vec<PathBuf> = entries(folder).map(|entry| entry.path()).collect();
    files.retain(|path| has_one_of(path, &["xmp"]));
    files.sort_unstable();
    let (mut scene, all) = (Scene::default(), files.len());
    for path in files {
        let error = |problem: String| Error::input(&path, problem, "export the metadata (XMP) again");
        let text = text::from_bytes(&path, regular_file::read(&path, 1)?)?;
        let document = parse_xml(&path, &text)?;
        let of_rs = |node: &Node<'_, '_>| {
            node.tag_name().name() == "Description"
                && node.namespaces().any(|namespace| namespace.uri() == NAMESPACE)
        };
        let Some(own) = document.descendants().find(of_rs) else { continue };
        let property = |name: &str| {
            let element = || own.children().find(|node| node.has_tag_name((NAMESPACE, name)));
            own.attribute((NAMESPACE, name)).or_else(|| element().map(|node| node.text().unwrap_or_default()))
        };
        let value = |name: &str, usual: f64| match property(name) {
            None => Ok(usual),
            Some(text) => {
                numbers::<1>(text).map(|[v]| v).ok_or_else(|| error(format!("{name} is not a number")))
            }
        };
        let (Some(rows), Some(position)) = (property("Rotation"), property("Position")) else { continue };
        let axes = numbers(rows).and_then(rotation).ok_or_else(|| error("Rotation is no rotation".into()))?;
        let center = numbers(position).ok_or_else(|| error("Position is not of 3 numbers".into()))?;
        let model = property("DistortionModel").unwrap_or("perspective");
        if !["perspective", "brown3", "brown4", "brown3t2", "brown4t2"].contains(&model) {
            return Err(error(format!("has the distortion model {model:?}; Brown3 and Brown4 are read")));
        }
        if value("Skew", 0.0)? != 0.0 || value("AspectRatio", 1.0)? != 1.0 {
            return Err(error("has a skew or an aspect ratio, which no lens here has".into()));
        }
        let coefficients: Vec<f64> = property("DistortionCoeficients")
            .unwrap_or_default()
            .split_whitespace()
            .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
            .collect::<Option<_>>()
            .ok_or_else(|| error("DistortionCoeficients are not numbers".into()))?;
        let coefficient = |at: usize| coefficients.get(at).copied().unwrap_or(0.0);
        let lens = FilmLens {
            focal_mm: value("FocalLength35mm", f64::NAN)?,
            center: [value("PrincipalPointU", 0.0)?, value("PrincipalPointV", 0.0)?],
            k: [0, 1, 2, 3].map(coefficient),
            tangential: [4, 5].map(coefficient),
        };
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let size = size_of(&name)?;
        let camera = scene.camera(size, lens.in_pixels(size).map_err(error)?);
        let id = scene.images.len() as u32;
        scene.images.push(posed((id, camera), &name, axes, DVec3::from_array(center)));
    }
    let count = scene.images.len();
    if count == 0 {
        let remedy = "align the photos in RealityScan and export their metadata (XMP) with poses";
        return Err(Error::input(folder, format!("{all} XMP files beside the photos have no pose"), remedy));
    }
    if count < all {
        scene.warnings.push(format!("{}: {} of {all} XMP files have no pose", folder.display(), all - count));
    }
    scene.note = format!(
        "{}: RealityScan's cameras of {count} photos, in XMP files, with {} lenses",
        folder.display(),
        scene.cameras.len()
    );
    Ok(scene)
}

/// A lens in shares of a photo's longer side.
struct FilmLens {
    /// Focal length for a film of 36 mm.
    focal_mm: f64,
    /// Offset of the principal point from the middle.
    center: [f64; 2],
    k: [f64; 4],
    tangential: [f64; 2],
}

impl FilmLens {
    fn in_pixels(&self, (width, height): (u32, u32)) -> Result<Lens, String> {
        if self.tangential != [0.0; 2] {
            return Err("has tangential distortion (t1, t2), whose order is not documented: align with Brown3 or Brown4".into());
        }
        let longer = f64::from(width.max(height));
        let focal = longer * self.focal_mm / FILM;
        let center = [0, 1].map(|axis| 0.5 * f64::from([width, height][axis]) + longer * self.center[axis]);
        Ok(perspective([focal; 2], center, self.k, [0.0; 2]))
    }
}
