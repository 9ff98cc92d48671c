//! Rendering sets as the twins' types.

use std::path::Path;

use crate::common::npz::{Npz, rows};
use crate::reference::types::{Drawn, Extent, Gaussian, View};

/// A rendering set.
pub struct RenderingSet {
    /// Inputs, and results with the reference extent.
    pub npz: Npz,
    /// Results with the exact extent.
    pub exact: Option<Npz>,
    /// Parameters.
    pub gaussians: Vec<Gaussian>,
    /// Camera, the reference extent.
    pub view: View,
}

impl RenderingSet {
    /// Reads a set.
    pub fn read(path: &Path, exact: Option<&Path>) -> RenderingSet {
        let npz = Npz::read(path);
        let gaussians = gaussians(&npz, "");
        let view = view(&npz);
        RenderingSet { exact: exact.map(Npz::read), gaussians, view, npz }
    }

    /// The results with an extent.
    pub fn results(&self, extent: Extent) -> &Npz {
        match extent {
            Extent::Reference => &self.npz,
            Extent::Exact => self.exact.as_ref().expect("trials exist only where the file does"),
        }
    }

    /// The view with an extent.
    pub fn view_with(&self, extent: Extent) -> View {
        View { extent, ..self.view.clone() }
    }

    /// dL/dimage and dL/d(inverse depth).
    pub fn image_gradient(&self, extent: Extent) -> (Vec<[f64; 3]>, Vec<f64>) {
        let results = self.results(extent);
        let color = results.rows("G");
        let inverse_depth = match results.has("Gd") {
            true => results.values("Gd").to_vec(),
            false => vec![0.0; color.len()],
        };
        (color, inverse_depth)
    }

    /// Flags of a Gaussian: see the bits in the README of the vectors.
    pub fn gaussian_flag(&self, bit: u8) -> Vec<bool> {
        self.npz.values("g_unstable").iter().map(|&flags| flags as u8 & bit != 0).collect()
    }
}

/// The Gaussians of an archive whose fields have a prefix.
pub fn gaussians(npz: &Npz, prefix: &str) -> Vec<Gaussian> {
    let field = |name: &str| format!("{prefix}{name}");
    let means = npz.rows::<3>(&field("means"));
    let quats = npz.rows::<4>(&field("quats"));
    let log_scales = npz.rows::<3>(&field("log_scales"));
    let logits = npz.values(&field("opacity_logits"));
    let sh = npz.rows::<3>(&field("sh"));
    let per_gaussian = npz.array(&field("sh")).shape[1];
    (0..means.len())
        .map(|i| Gaussian {
            mean: means[i],
            quat: quats[i],
            log_scale: log_scales[i],
            opacity_logit: logits[i],
            sh: sh[i * per_gaussian..(i + 1) * per_gaussian].to_vec(),
        })
        .collect()
}

/// The camera of an archive.
pub fn view(npz: &Npz) -> View {
    let k = npz.values("cam_K");
    let size = npz.values("size_wh");
    let flag = |name: &str| npz.has(name) && npz.scalar(name) != 0.0;
    View {
        camera_from_world: rows(npz.values("cam_R")).try_into().expect("3×3"),
        translation: rows(npz.values("cam_t"))[0],
        focal_px: [k[0], k[1]],
        center_px: [k[2], k[3]],
        size_px: [size[0] as u32, size[1] as u32],
        background: rows(npz.values("bg"))[0],
        sh_degree: if npz.has("deg") { npz.scalar("deg") as u32 } else { 0 },
        antialias: flag("antialias"),
        symmetric_limit: flag("lim_sym"),
        extent: Extent::Reference,
        drawn: Drawn::AS_THEY_ARE,
    }
}
