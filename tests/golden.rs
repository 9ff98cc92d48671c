//! The golden vectors: the device, and what the host computes, against each set.

mod absgrad;
mod antialias;
mod budget;
mod conventions;
mod depth;
mod exposure;
mod gpu;
mod importance;
mod lenses;
mod lpips;
mod mcmc;
mod npz;
mod poses;
mod rendering;
mod sets;
mod sparse_depth;
mod stages;
mod training;

use crate::absent_data;
use crate::common::root;
use crate::golden::npz::Npz;
use crate::reference::types::Extent;
use ashsplat::scene::sh::rgb_to_sh_dc;
use ashsplat::scene::{PointCloud, scene_extent};
use ashsplat_files::init::mean_squared_neighbour_distances;
use ashsplat_files::initial_gaussians;
use glam::Vec3;
use libtest_mimic::{Failed, Trial};
use std::path::{Path, PathBuf};

type Outcome = Result<(), Failed>;

type Check = fn(&Path) -> Outcome;

/// Subjects of sets: identifying fields, name, check. A set belongs to the first entry whose fields it has.
const SUBJECTS: [(&str, &str, Check); 19] = [
    ("it1_image", "train", training::train),
    ("fused_log_scales", "filter", antialias::filter),
    ("detached kernel", "antialias", antialias::check),
    ("obs_inv_z", "depth", depth::check),
    ("points_xy points_z", "sparse_depth", sparse_depth::check),
    ("adam_E", "exposure", exposure::check),
    ("img gt d_img", "loss", training::loss),
    ("xyz_p0", "adam", training::adam),
    ("lr_xyz", "rates", training::rates),
    ("in_grad_accum out_kind", "densify", training::densify),
    ("reg_loss", "regularizers", training::regularizers),
    ("u_relocate", "relocation", mcmc::relocation),
    ("xy_abs_pix", "absgrad", absgrad::check),
    ("edge_raw", "importance", importance::check),
    ("opacity_factor", "split", budget::split),
    ("budget_iteration", "growth", budget::schedule),
    ("alex_layers vgg_layers", "distance", lpips::check),
    ("d_pose", "poses", poses::check),
    ("logits out", "reset_opacity", training::reset_opacity),
];

#[derive(Clone, Debug)]
struct SetFile {
    name: String,
    path: PathBuf,
    /// The set of the same name with the exact extent.
    exact: Option<PathBuf>,
    /// Names of its arrays.
    fields: Vec<String>,
}

impl SetFile {
    /// The extents with results.
    fn extents(&self) -> impl Iterator<Item = Extent> {
        std::iter::once(Extent::Reference).chain(self.exact.is_some().then_some(Extent::Exact))
    }

    fn has(&self, fields: &str) -> bool {
        fields.split(' ').all(|name| self.fields.iter().any(|field| field == name))
    }

    fn trials(&self) -> Vec<Trial> {
        let trial = |implementation: &str, subject: &str, check: Check| {
            let path = self.path.clone();
            Trial::test(format!("golden_{implementation}_{subject}_{}", self.name), move || check(&path))
        };
        match SUBJECTS.iter().find(|(fields, ..)| self.has(fields)) {
            Some(&(_, subject, check)) => vec![trial("gpu", subject, check)],
            None if self.has("means cam_K image") => gpu::trials(self),
            None if self.has("metashape_frame_xy") => vec![trial("host", "files", conventions::of_files)],
            None if self.has("jac w_cov") => {
                vec![trial("host", "lens", lenses::of_host), trial("gpu", "lens", lenses::of_device)]
            }
            None if self.has("shutter w_cov") => vec![trial("gpu", "lens", lenses::of_device)],
            None if self.has("u_image params") => vec![trial("gpu", "picture", lenses::picture_of_device)],
            None if self.has("dist2") => {
                vec![trial("host", "start", |path| Ok(check_host(&Npz::read(path))?))]
            }
            None => vec![trial("unknown", "set", |_| Err("no test reads such a set".into()))],
        }
    }
}

const FOLDERS: [&str; 4] = ["golden", "golden/needles", "golden/training", "golden/cameras"];

/// One trial per set and implementation, for the project's own sets and those of the shared folder. If that folder
/// is missing, an extra trial says so.
pub fn trials(shared: &Path) -> Vec<Trial> {
    let sets = sets(shared);
    let mut trials = Vec::new();
    let folders = FOLDERS.map(|folder| shared.join(folder));
    if let Some(absent) = folders.iter().find(|folder| !folder.is_dir()) {
        let reason = format!("no further golden vectors in {}", absent.display());
        trials.push(absent_data("golden_vectors_absent", reason));
    }
    trials.extend(sets.iter().flat_map(SetFile::trials));
    trials
}

/// The project's own sets, a small selection.
fn own() -> PathBuf {
    root().join("tests/golden/sets")
}

fn sets(shared: &Path) -> Vec<SetFile> {
    let mut sets = list(&own());
    assert!(!sets.is_empty(), "no golden vectors in {}", own().display());
    let further = FOLDERS.iter().flat_map(|folder| list(&shared.join(folder)));
    let further: Vec<SetFile> = further.filter(|set| sets.iter().all(|own| own.name != set.name)).collect();
    sets.extend(further);
    sets.sort_by(|a, b| a.name.cmp(&b.name));
    sets
}

fn list(folder: &Path) -> Vec<SetFile> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "npz"))
        .map(|path| {
            let exact = folder.join("exact").join(path.file_name().expect("a file"));
            SetFile {
                name: path.file_stem().expect("a file").to_string_lossy().into_owned(),
                fields: Npz::names(&path),
                exact: exact.exists().then_some(exact),
                path,
            }
        })
        .collect()
}

/// The initial Gaussians and the scene extent, which the host computes.
fn check_host(set: &Npz) -> Result<(), String> {
    let [positions, rgb, centers] = ["xyz", "rgb", "cam_centers"].map(|name| set.rows::<3>(name));
    let single = |rows: &[[f64; 3]]| rows.iter().map(|row| row.map(|v| v as f32)).collect::<Vec<_>>();
    let positions = single(&positions);
    let dist2 = mean_squared_neighbour_distances(&positions).map_err(|error| error.to_string())?;
    assert_close("dist2", &dist2, set, 1e-6);

    // A point cloud's colours have 8 bits, so the set's colours are stored in the coefficients afterwards.
    let points = PointCloud { positions: positions.clone(), colors: vec![[0; 3]; positions.len()] };
    let gaussians = initial_gaussians(&points, 3).expect("Gaussians");
    gaussians.check_shapes().expect("vectors that fit together");
    assert_eq!(gaussians.means, positions);
    assert!(gaussians.quats.iter().all(|&q| q == [1.0, 0.0, 0.0, 0.0]));
    let flat = |values: &[[f32; 3]]| values.as_flattened().iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    assert_close("log_scales", &flat(&gaussians.log_scales), set, 2e-6);
    let logits: Vec<f64> = gaussians.opacity_logits.iter().map(|&v| f64::from(v)).collect();
    assert_close("opacity_logits", &logits, set, 1e-6);
    let mut sh = gaussians.sh;
    for (index, rgb) in single(&rgb).into_iter().enumerate() {
        sh[16 * index] = rgb.map(rgb_to_sh_dc);
    }
    assert_close("sh", &flat(&sh), set, 1e-6);
    let extent = scene_extent(single(&centers).into_iter().map(Vec3::from_array));
    assert_close("scene_extent", &[f64::from(extent)], set, 1e-6);
    Ok(())
}

/// Elementwise: the error is at most `tolerance`, relative above 1 and absolute below.
fn assert_close(name: &str, computed: &[f64], set: &Npz, tolerance: f64) {
    let expected = set.values(name);
    assert_eq!(computed.len(), expected.len(), "{name}");
    for (index, (a, b)) in computed.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= tolerance * b.abs().max(1.0), "{name}[{index}]: {a}, expected {b}");
    }
}
