//! The golden vectors: one trial per set found in the folder and per implementation (the twins, the GPU).

mod gpu;
mod gpu_training;
mod rendering;
mod sets;
mod training;
mod twin;

use std::path::{Path, PathBuf};

use libtest_mimic::{Failed, Trial};

use crate::common::npz::Npz;

/// What a set is about, by the names of its fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Rendering,
    Loss,
    Adam,
    Rates,
    Densify,
    ResetOpacity,
    Train,
    Other,
}

impl Kind {
    fn of(fields: &[String]) -> Kind {
        let has = |name: &str| fields.iter().any(|field| field == name);
        match () {
            () if has("it1_image") => Kind::Train,
            () if has("means") && has("cam_K") && has("image") => Kind::Rendering,
            () if has("img") && has("gt") && has("d_img") => Kind::Loss,
            () if has("xyz_p0") => Kind::Adam,
            () if has("lr_xyz") => Kind::Rates,
            () if has("in_grad_accum") && has("out_kind") => Kind::Densify,
            () if has("logits") && has("out") => Kind::ResetOpacity,
            () => Kind::Other,
        }
    }
}

/// A file of the folder.
#[derive(Clone, Debug)]
pub struct SetFile {
    name: String,
    path: PathBuf,
    /// The set of the same name with the exact extent.
    exact: Option<PathBuf>,
    kind: Kind,
}

/// One trial per set and implementation; where the folder is absent, one that says so and is ignored.
pub fn trials(shared: &Path) -> Vec<Trial> {
    let folder = shared.join("golden");
    let sets = list(&folder);
    if sets.is_empty() {
        let reason = format!("no golden vectors in {}", folder.display());
        return vec![
            Trial::ignorable_test("golden_vectors_absent", move || Err(Failed::from(reason.clone())))
                .with_ignored_flag(true),
        ];
    }
    let mut trials = Vec::new();
    for set in &sets {
        trials.extend(twin::trials(set));
        trials.extend(gpu::trials(set));
    }
    trials
}

fn list(folder: &Path) -> Vec<SetFile> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut sets: Vec<SetFile> = entries
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
    sets.sort_by(|a, b| a.name.cmp(&b.name));
    sets
}

/// A trial from a check.
fn trial(name: String, check: impl FnOnce() -> Result<(), String> + Send + 'static) -> Trial {
    Trial::test(name, move || check().map_err(Failed::from))
}

/// Prints measured errors where `ASHSPLAT_GOLDEN_REPORT` is set.
fn report(text: impl FnOnce() -> String) {
    if std::env::var_os("ASHSPLAT_GOLDEN_REPORT").is_some() {
        println!("{}", text());
    }
}
