//! Metashape's "Export Cameras" as XML.
//!
//! Its Python reference says of a camera's transform "4x4 matrix describing photo location in the chunk coordinate system", and of
//! a chunk's "4x4 matrix specifying chunk location in the world coordinate system". Newer files have one per component. The
//! manual's appendix on camera models says of frame cameras `u = w * 0.5 + cx + x'f + x'B1 + y'B2`, `v = h * 0.5 + cy + y'f`, and
//! there P1 and P2 have the places of OpenCV's p2 and p1.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::{DMat3, DVec3};
use roxmltree::Node;

use super::{Lens, Scene, first, named, numbers, parse_xml, perspective, posed, rotation};
use crate::colmap::records::CameraModel;
use crate::names::ending;
use crate::{regular_file, text};
use ashsplat::{Error, Result};

/// COLMAP's THIN_PRISM_FISHEYE and EQUIRECTANGULAR.
const FISHEYE: i64 = 10;
const PANORAMA: i64 = 17;

pub(super) fn read(path: &Path) -> Result<Scene> {
    let text = text::from_bytes(path, regular_file::read(path, 1)?)?;
    let document = parse_xml(path, &text)?;
    let file = File { path };
    let chunk = file.chunk(document.root_element())?;
    let mut scene = Scene::default();
    let cameras = file.cameras(chunk, &mut scene.warnings)?;
    let component = cameras.first().and_then(|camera| camera.attribute("component_id"));
    let is_own = |own: &Node<'_, '_>| component.is_none() || own.attribute("id") == component;
    let of_component = first(chunk, "components").and_then(|all| named(all, "component").find(is_own));
    let placements = [of_component, Some(chunk)].into_iter().flatten();
    let placements: Vec<Placement> =
        placements.map(|holder| file.placement(holder)).collect::<Result<_>>()?;
    let sensors: BTreeMap<Option<&str>, Node<'_, '_>> = first(chunk, "sensors")
        .into_iter()
        .flat_map(|sensors| named(sensors, "sensor"))
        .map(|sensor| (sensor.attribute("id"), sensor))
        .collect();
    let (mut known, mut kinds) = (BTreeMap::new(), BTreeSet::new());
    for (index, camera) in cameras.iter().enumerate() {
        let label = camera.attribute("label").unwrap_or_default();
        let place = format!("camera {:?}", ending(label));
        let sensor = camera.attribute("sensor_id");
        let camera_id = match known.get(&sensor) {
            Some(&id) => id,
            None => {
                let found = sensors.get(&sensor).ok_or_else(|| file.error(&place, "has no sensor"))?;
                let (kind, size, lens) = file.lens(*found)?;
                kinds.insert(kind);
                *known.entry(sensor).or_insert(scene.camera(size, lens))
            }
        };
        let pose = first(*camera, "transform").and_then(|pose| numbers::<16>(pose.text()?));
        let pose = pose.ok_or_else(|| file.error(&place, "has a transform that is not of 16 numbers"))?;
        let rows: [f64; 9] = std::array::from_fn(|at| pose[at / 3 * 4 + at % 3]);
        let axes = rotation(rows).ok_or_else(|| file.error(&place, "has a transform that is no rotation"))?;
        let start = (axes, DVec3::new(pose[3], pose[7], pose[11]));
        let (axes, center) = placements.iter().fold(start, |(axes, center), placement| {
            let Placement { rotation, scale, translation } = *placement;
            (rotation * axes, scale * (rotation * center) + translation)
        });
        scene.images.push(posed((index as u32, camera_id), label, axes.transpose(), center));
    }
    let (used, sensors, kinds) = (scene.images.len(), known.len(), Vec::from_iter(kinds).join(", "));
    scene.note =
        format!("{}: Metashape's cameras of {used} photos, with {sensors} sensors ({kinds})", path.display());
    Ok(scene)
}

/// Place of a component or of a chunk: `scale * rotation * point + translation`.
struct Placement {
    rotation: DMat3,
    scale: f64,
    translation: DVec3,
}

struct File<'p> {
    path: &'p Path,
}

impl File<'_> {
    fn error(&self, place: &str, problem: impl std::fmt::Display) -> Error {
        Error::input(self.path, format!("{place} {problem}"), "export the cameras from Metashape again")
    }

    fn chunk<'a, 't>(&self, root: Node<'a, 't>) -> Result<Node<'a, 't>> {
        let chunks: Vec<Node<'a, 't>> = named(root, "chunk").collect();
        let (problem, remedy) = match chunks.as_slice() {
            [chunk] => return Ok(*chunk),
            [] => ("has no chunk".into(), "export the cameras of an aligned chunk from Metashape"),
            several => {
                let count = several.len();
                (
                    format!("has {count} chunks, each in its own coordinates"),
                    "export the cameras of one chunk",
                )
            }
        };
        Err(Error::input(self.path, problem, remedy))
    }

    /// The cameras with a pose, of the component that has the most of them.
    fn cameras<'a, 't>(&self, chunk: Node<'a, 't>, warnings: &mut Vec<String>) -> Result<Vec<Node<'a, 't>>> {
        let is_used = |camera: &Node<'_, '_>| !matches!(camera.attribute("enabled"), Some("false" | "0"));
        let all = first(chunk, "cameras").into_iter().flat_map(|cameras| cameras.descendants());
        let all: Vec<Node<'a, 't>> =
            all.filter(|node| node.tag_name().name() == "camera" && is_used(node)).collect();
        let mut by_component: BTreeMap<Option<&str>, Vec<Node<'a, 't>>> = BTreeMap::new();
        for camera in all.iter().filter(|camera| first(**camera, "transform").is_some()) {
            by_component.entry(camera.attribute("component_id")).or_default().push(*camera);
        }
        let of_rigs = all.iter().filter(|camera| camera.has_attribute("master_id")).count();
        let (all, posed) = (all.len(), by_component.values().map(Vec::len).sum::<usize>());
        let rigs = match of_rigs {
            0 => String::new(),
            count => format!(" ({count} are of rigs, placed by a master)"),
        };
        let without = format!("{} of its {all} cameras have no pose{rigs}", all - posed);
        let Some(chosen) = by_component.into_values().rev().max_by_key(Vec::len) else {
            let remedy = "align the photos in Metashape, and export rigs as a model of COLMAP";
            return Err(Error::input(self.path, without, remedy));
        };
        if posed < all {
            warnings.push(format!("{}: {without} and are not used", self.path.display()));
        }
        if chosen.len() < posed {
            let (path, others) = (self.path.display(), posed - chosen.len());
            warnings.push(format!("{path}: {others} cameras of other components are not used"));
        }
        Ok(chosen)
    }

    fn placement(&self, holder: Node<'_, '_>) -> Result<Placement> {
        let transform = first(holder, "transform");
        let place = format!("the transform of its {}", holder.tag_name().name());
        let text_of = |name| {
            transform.and_then(|transform| first(transform, name)).map(|node| node.text().unwrap_or_default())
        };
        let rows = text_of("rotation").map(|text| numbers(text).and_then(rotation));
        let translation = text_of("translation").map(|text| numbers(text).map(DVec3::from_array));
        let scale = text_of("scale").map(|text| numbers::<1>(text).filter(|[scale]| *scale > 0.0));
        let wrong = |what: &str| self.error(&place, format!("has a wrong {what}"));
        Ok(Placement {
            rotation: rows.unwrap_or(Some(DMat3::IDENTITY)).ok_or_else(|| wrong("rotation"))?,
            translation: translation.unwrap_or(Some(DVec3::ZERO)).ok_or_else(|| wrong("translation"))?,
            scale: scale.unwrap_or(Some([1.0])).ok_or_else(|| wrong("scale"))?[0],
        })
    }

    /// The kind of a sensor, the size of its pictures, and its lens.
    fn lens(&self, sensor: Node<'_, '_>) -> Result<(String, (u32, u32), Lens)> {
        let place = format!("sensor {:?}", ending(sensor.attribute("label").unwrap_or_default()));
        let error = |problem: String| self.error(&place, problem);
        let calibrations: Vec<Node<'_, '_>> = named(sensor, "calibration").collect();
        let is_adjusted = |own: &&Node<'_, '_>| own.attribute("class") == Some("adjusted");
        let calibration = calibrations.iter().find(is_adjusted).or(calibrations.first()).copied();
        let kind =
            calibration.and_then(|own| own.attribute("type")).or(sensor.attribute("type")).unwrap_or("frame");
        let resolution = first(sensor, "resolution").or_else(|| first(calibration?, "resolution"));
        let side = |name| resolution?.attribute(name)?.parse::<u32>().ok();
        let Some((width, height)) = side("width").zip(side("height")) else {
            return Err(error("has no resolution".into()));
        };
        let value = |name| match calibration.and_then(|own| first(own, name)) {
            None => Ok(0.0),
            Some(node) => {
                let number = numbers::<1>(node.text().unwrap_or_default());
                number
                    .map(|[number]| number)
                    .ok_or_else(|| error(format!("has a {name} that is not a number")))
            }
        };
        for name in ["b2", "p3", "p4"] {
            if value(name)? != 0.0 {
                let problem = format!("{place} has {name}, which no lens here has");
                return Err(Error::input(
                    self.path,
                    problem,
                    "fix it at 0 in Metashape and optimise the cameras again",
                ));
            }
        }
        let [f, b1] = [value("f")?, value("b1")?];
        let focal = [f + b1, f];
        let center = [value("cx")? + 0.5 * f64::from(width), value("cy")? + 0.5 * f64::from(height)];
        let k = [value("k1")?, value("k2")?, value("k3")?, value("k4")?];
        let p = [value("p2")?, value("p1")?];
        let of_number = |number| {
            let refused = || error(format!("is of type {kind}, which is not read"));
            CameraModel::from_number(number).ok_or_else(refused)
        };
        let lens = match kind {
            "frame" => perspective(focal, center, k, p),
            "fisheye" | "equidistant_fisheye" => {
                let ([fx, fy], [cx, cy], [k1, k2, k3, k4], [p1, p2]) = (focal, center, k, p);
                (of_number(FISHEYE)?, vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, 0.0, 0.0])
            }
            "spherical" if width != 2 * height => {
                return Err(error(format!("is a panorama of {width}x{height} pixels, which is not 2:1")));
            }
            "spherical" => (of_number(PANORAMA)?, vec![f64::from(width), f64::from(height)]),
            _ => {
                let problem = format!("{place} is of type {kind}, which is not read");
                return Err(Error::input(self.path, problem, "export undistorted photos and their cameras"));
            }
        };
        Ok((kind.to_owned(), (width, height), lens))
    }
}
