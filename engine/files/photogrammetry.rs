//! Cameras of photogrammetry programs: Metashape's XML, and the CSV or XMP files of RealityScan (once RealityCapture).

mod metashape;
mod reality_scan;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use roxmltree::{Document, Node};

use crate::colmap::model::{Model, ModelFolder};
use crate::colmap::records::{CameraModel, ColmapCamera, ColmapImage};
use crate::names::{entries, has_one_of};
use crate::transforms::cloud_beside;
use crate::{host_memory, ply, regular_file, text};
use ashsplat::scene::SourcePoints;
use ashsplat::{Error, Result};

/// Files with the cameras of a data set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// Metashape's XML.
    Metashape(PathBuf),
    /// RealityScan's "Internal/External camera parameters".
    RealityScanCsv(PathBuf),
    /// RealityScan's XMP files, beside the photos of this folder.
    RealityScanXmp(PathBuf),
}

impl Source {
    /// The file, or the folder with several.
    pub fn path(&self) -> &Path {
        match self {
            Self::Metashape(path) | Self::RealityScanCsv(path) | Self::RealityScanXmp(path) => path,
        }
    }
}

/// Finds files with cameras in a data set's folder, and beside its photos in the folder `images`. There should be one source.
pub fn find(dataset: &Path, images: &str) -> Vec<Source> {
    let start_of = |path: &Path| {
        /// The marks of all formats lie near the beginning.
        const START_BYTES: u64 = 4096;
        text::decoded(regular_file::start(path, START_BYTES).unwrap_or_default())
    };
    let files = |folder: &Path, ending: &'static str| {
        let mut files: Vec<PathBuf> = entries(folder).map(|entry| entry.path()).collect();
        files.retain(|path| has_one_of(path, &[ending]));
        files.sort_unstable();
        files.into_iter()
    };
    let mut found = Vec::new();
    found.extend(
        files(dataset, "xml").filter(|path| start_of(path).contains("<document")).map(Source::Metashape),
    );
    let csv = files(dataset, "csv").filter(|path| reality_scan::Columns::of(&start_of(path)).is_some());
    found.extend(csv.map(Source::RealityScanCsv));
    let folders = [dataset.join(images), dataset.to_owned()];
    let has_xmp = |folder: &&PathBuf| {
        // Other programs leave such files as well.
        files(folder, "xmp").take(100).any(|path| start_of(&path).contains(reality_scan::NAMESPACE))
    };
    found.extend(folders.iter().find(has_xmp).cloned().map(Source::RealityScanXmp));
    found
}

/// One of COLMAP's camera models with its parameters.
type Lens = (CameraModel, Vec<f64>);

/// Contents of a file or of a folder's XMP files.
#[derive(Default)]
struct Scene {
    cameras: Vec<ColmapCamera>,
    images: Vec<ColmapImage>,
    warnings: Vec<String>,
    /// One line about what was read.
    note: String,
}

impl Scene {
    /// The id of the camera with these properties, which is added if there is none.
    fn camera(&mut self, (width, height): (u32, u32), (model, parameters): Lens) -> u32 {
        let (width, height) = (width.into(), height.into());
        let is_same = |own: &&ColmapCamera| {
            (own.model, own.width, own.height, &own.parameters) == (model, width, height, &parameters)
        };
        // Photos that share a camera are listed near each other.
        if let Some(own) = self.cameras.iter().rev().take(16).find(is_same) {
            return own.id;
        }
        let id = self.cameras.len() as u32;
        self.cameras.push(ColmapCamera { id, model, width, height, parameters });
        id
    }
}

/// Reads the cameras of a source as a model, with the points of a PLY in the data set's folder. `size_of`
/// returns the size in pixels of the photo with a name. Names may lack their extension.
///
/// # Errors
/// [`Error::Input`] naming the file and the place in it.
pub fn read(
    source: &Source,
    dataset: &Path,
    size_of: &mut dyn FnMut(&str) -> Result<(u32, u32)>,
) -> Result<Model> {
    let path = source.path();
    let scene = match source {
        Source::Metashape(path) => metashape::read(path)?,
        Source::RealityScanCsv(path) => reality_scan::read_csv(path, size_of)?,
        Source::RealityScanXmp(folder) => reality_scan::read_xmp(folder, size_of)?,
    };
    let Scene { cameras, images, mut warnings, note } = scene;
    let mut names = HashSet::new();
    if let Some(twice) = images.iter().find(|image| !names.insert(image.name.as_str())) {
        let problem = format!("two photos are called {:?}", twice.name);
        return Err(Error::input(path, problem, "give each photo its own name and export again"));
    }
    let file = if path == dataset { dataset.join("*.xmp") } else { path.to_owned() };
    let points = match cloud_beside(&file, &mut warnings) {
        Some(file) => ply::read_points(&file, &mut warnings)?,
        None => SourcePoints::default(),
    };
    let source =
        ModelFolder { folder: path.to_owned(), list: Some(path.to_owned()), text: true, warning: None };
    let cameras = cameras.into_iter().map(|camera| (camera.id, camera)).collect();
    Ok(Model { source, cameras, images, points, warnings, notes: vec![note] })
}

/// A perspective camera with the radial factor 1 + k1 s + k2 s² + k3 s³ + k4 s⁴ and COLMAP's p1 and p2.
fn perspective([fx, fy]: [f64; 2], [cx, cy]: [f64; 2], k: [f64; 4], [p1, p2]: [f64; 2]) -> Lens {
    let [k1, k2, k3, k4] = k;
    if k == [0.0; 4] && [p1, p2] == [0.0; 2] {
        return (CameraModel::PINHOLE, vec![fx, fy, cx, cy]);
    }
    let mut parameters = vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0];
    parameters.extend((k4 != 0.0).then_some(k4));
    (CameraModel::FULL_OPENCV, parameters)
}

/// A photo whose camera has these axes (x right, y down, z forward) and this centre.
fn posed((id, camera_id): (u32, u32), name: &str, camera_from_source: DMat3, center: DVec3) -> ColmapImage {
    let quat = DQuat::from_mat3(&camera_from_source).normalize();
    let translation = -(DMat3::from_quat(quat) * center);
    let quat = [quat.w, quat.x, quat.y, quat.z];
    ColmapImage { id, camera_id, name: name.to_owned(), quat, translation: translation.to_array() }
}

/// The rotation with these rows; `None` if they are not one.
fn rotation(rows: [f64; 9]) -> Option<DMat3> {
    const TOLERANCE: f64 = 1e-3;
    let rotation = DMat3::from_cols_array(&rows).transpose();
    let off = rotation * rotation.transpose() - DMat3::IDENTITY;
    let is_one = rotation.determinant() > 0.0 && off.to_cols_array().iter().all(|v| v.abs() < TOLERANCE);
    is_one.then_some(rotation)
}

/// The finite numbers of a text, if there are `N`.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let mut numbers = [0.0; N];
    let mut words = text.split_whitespace();
    for number in &mut numbers {
        *number = words.next()?.parse().ok().filter(|number: &f64| number.is_finite())?;
    }
    words.next().is_none().then_some(numbers)
}

/// Memory of an element with its text, and of an attribute, bytes.
const NODE_BYTES: u64 = 400;
const ATTRIBUTE_BYTES: u64 = 160;
/// Most attributes of an element. Parsing takes the square of their number.
const ATTRIBUTES: usize = 256;
/// Most namespaces. Each element may hold a list of them.
const NAMESPACES: usize = 64;

/// Parses an XML file, if the machine has free memory for its contents.
fn parse_xml<'t>(path: &Path, text: &'t str) -> Result<Document<'t>> {
    let error = |problem: String| Error::input(path, problem, "export it again");
    let count = |byte: u8| text.bytes().filter(|own| *own == byte).count() as u64;
    let bytes = NODE_BYTES * count(b'<') + ATTRIBUTE_BYTES * count(b'=');
    host_memory::check_free(path, bytes + text.len() as u64)?;
    if text.split('<').any(|tag| tag.matches('=').nth(ATTRIBUTES).is_some()) {
        return Err(error(format!("has an element of more than {ATTRIBUTES} attributes")));
    }
    if text.matches("xmlns").nth(NAMESPACES).is_some() {
        return Err(error(format!("has more than {NAMESPACES} namespaces")));
    }
    Document::parse(text).map_err(|e| error(format!("is not XML: {e}")))
}

/// The elements of this name directly in `node`, in any namespace.
fn named<'a, 't>(node: Node<'a, 't>, name: &'static str) -> impl Iterator<Item = Node<'a, 't>> {
    node.children().filter(move |child| child.tag_name().name() == name)
}

/// The first element of this name directly in `node`.
fn first<'a, 't>(node: Node<'a, 't>, name: &'static str) -> Option<Node<'a, 't>> {
    named(node, name).next()
}
