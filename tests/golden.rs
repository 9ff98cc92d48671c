//! The golden vectors: one trial per set and implementation (the twins, the GPU).

mod absgrad;
mod antialias;
mod budget;
mod depth;
mod exposure;
mod gpu;
mod gpu_training;
mod importance;
mod lpips;
mod mcmc;
pub mod npz;
mod poses;
mod rendering;
mod sets;
mod sparse_depth;
mod stages;
mod training;
mod twin;

use std::path::{Path, PathBuf};

use libtest_mimic::{Failed, Trial};

use crate::absent_data;
use crate::common::root;
use crate::golden::npz::Npz;

/// Subject of a set, from the names of its fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Rendering,
    Loss,
    Adam,
    Rates,
    Densify,
    ResetOpacity,
    Train,
    Regularizers,
    Relocation,
    Antialias,
    Filter3d,
    AbsoluteGradient,
    EdgeImportance,
    LongAxisSplit,
    GrowthSchedule,
    Exposure,
    Depth,
    SparseDepth,
    Lpips,
    Poses,
    /// `golden_host` tests it.
    Initial,
    Unknown,
}

impl Kind {
    fn of(fields: &[String]) -> Kind {
        let has = |name: &str| fields.iter().any(|field| field == name);
        match () {
            () if has("it1_image") => Kind::Train,
            () if has("fused_log_scales") => Kind::Filter3d,
            () if has("detached") && has("kernel") => Kind::Antialias,
            () if has("obs_inv_z") => Kind::Depth,
            () if has("points_xy") && has("points_z") => Kind::SparseDepth,
            () if has("means") && has("cam_K") && has("image") => Kind::Rendering,
            () if has("adam_E") => Kind::Exposure,
            () if has("img") && has("gt") && has("d_img") => Kind::Loss,
            () if has("xyz_p0") => Kind::Adam,
            () if has("lr_xyz") => Kind::Rates,
            () if has("in_grad_accum") && has("out_kind") => Kind::Densify,
            () if has("reg_loss") => Kind::Regularizers,
            () if has("u_relocate") => Kind::Relocation,
            () if has("xy_abs_pix") => Kind::AbsoluteGradient,
            () if has("edge_raw") => Kind::EdgeImportance,
            () if has("opacity_factor") => Kind::LongAxisSplit,
            () if has("budget_iteration") => Kind::GrowthSchedule,
            () if has("alex_layers") && has("vgg_layers") => Kind::Lpips,
            () if has("d_pose") => Kind::Poses,
            () if has("logits") && has("out") => Kind::ResetOpacity,
            () if has("dist2") => Kind::Initial,
            () => Kind::Unknown,
        }
    }
}

/// A file of the folder.
#[derive(Clone, Debug)]
pub struct SetFile {
    pub name: String,
    pub path: PathBuf,
    /// The set of the same name with the exact extent.
    exact: Option<PathBuf>,
    kind: Kind,
}

/// One trial per set and implementation, for the project's own sets and those of the shared folder. If that folder
/// is missing, an extra trial says so.
pub fn trials(shared: &Path) -> Vec<Trial> {
    let sets = sets(shared);
    let mut trials = Vec::new();
    let folders = ["golden", "golden/needles", "golden/training"].map(|folder| shared.join(folder));
    if let Some(absent) = folders.iter().find(|folder| !folder.is_dir()) {
        let reason = format!("no further golden vectors in {}", absent.display());
        trials.push(absent_data("golden_vectors_absent", reason));
    }
    for set in &sets {
        trials.extend(twin::trials(set));
        trials.extend(gpu::trials(set));
    }
    trials
}

/// The project's own sets, a small selection.
fn own() -> PathBuf {
    root().join("tests/golden/sets")
}

/// The project's own sets, and those of the shared folder with other names.
pub fn sets(shared: &Path) -> Vec<SetFile> {
    let mut sets = list(&own());
    assert!(!sets.is_empty(), "no golden vectors in {}", own().display());
    let mut further = list(&shared.join("golden"));
    further.extend(list(&shared.join("golden/needles")));
    further.extend(list(&shared.join("golden/training")));
    further.retain(|set| sets.iter().all(|own| own.name != set.name));
    sets.append(&mut further);
    sets.sort_by(|a, b| a.name.cmp(&b.name));
    sets
}

fn list(folder: &Path) -> Vec<SetFile> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let sets: Vec<SetFile> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "npz"))
        .map(|path| {
            let exact = folder.join("exact").join(path.file_name().expect("a file"));
            SetFile {
                name: path.file_stem().expect("a file").to_string_lossy().into_owned(),
                kind: Kind::of(&Npz::names(&path)),
                exact: exact.exists().then_some(exact),
                path,
            }
        })
        .collect();
    sets
}

/// A trial from a check.
fn trial(name: String, check: impl FnOnce() -> Result<(), String> + Send + 'static) -> Trial {
    Trial::test(name, move || check().map_err(Failed::from))
}

/// Prints measured errors if `ASHSPLAT_GOLDEN_REPORT` is set.
fn report(text: impl FnOnce() -> String) {
    if std::env::var_os("ASHSPLAT_GOLDEN_REPORT").is_some() {
        println!("{}", text());
    }
}
