//! Rendering sets as the twins' types.

use crate::golden::npz::{Npz, rows};
use crate::reference::blend_backward::PixelGradient;
use crate::reference::types::{Extent, Gaussian, Style, View};
use std::path::Path;

/// The extents with the prefix of their fields.
pub const EXTENTS: [(Extent, &str); 2] = [(Extent::Exact, ""), (Extent::Reference, "ref_")];

pub struct RenderingSet {
    /// Inputs, and results with the reference extent.
    pub npz: Npz,
    /// Results with the exact extent.
    pub exact: Option<Npz>,
    pub gaussians: Vec<Gaussian>,
    /// Camera, the reference extent.
    pub view: View,
}

impl RenderingSet {
    pub fn read(path: &Path, exact: Option<&Path>) -> RenderingSet {
        let npz = Npz::read(path);
        let gaussians = gaussians(&npz, "");
        let view = view(&npz);
        RenderingSet { exact: exact.map(Npz::read), gaussians, view, npz }
    }

    /// Reads a set of a training feature: one file with the results of both extents, and the first of its cameras.
    pub fn of_feature(path: &Path) -> RenderingSet {
        let exact = Npz::read(path);
        let (gaussians, npz) = (gaussians(&exact, ""), exact.with_prefix("ref_"));
        let view = views(&exact).swap_remove(0);
        RenderingSet { exact: Some(exact), gaussians, view, npz }
    }

    pub fn results(&self, extent: Extent) -> &Npz {
        match extent {
            Extent::Reference => &self.npz,
            Extent::Exact => self.exact.as_ref().expect("trials exist only where the file does"),
        }
    }

    pub fn view_with(&self, extent: Extent) -> View {
        View { extent, ..self.view.clone() }
    }

    /// dL/dpixel.
    pub fn image_gradient(&self, extent: Extent) -> Vec<PixelGradient> {
        let results = self.results(extent);
        let mut pixels = pixel_gradients(results.rows("G"));
        if results.has("Gd") {
            let all = pixels.iter_mut().zip(results.values("Gd"));
            all.for_each(|(pixel, &inverse_depth)| pixel.inverse_depth = inverse_depth);
        }
        pixels
    }

    /// Flags of Gaussians; for the bits see the README of the vectors.
    pub fn gaussian_flag(&self, bit: u8) -> Vec<bool> {
        if !self.npz.has("g_unstable") {
            return vec![false; self.gaussians.len()];
        }
        self.npz.values("g_unstable").iter().map(|&flags| flags as u8 & bit != 0).collect()
    }
}

/// dL/dpixel of colours alone.
pub fn pixel_gradients(colors: impl IntoIterator<Item = [f64; 3]>) -> Vec<PixelGradient> {
    colors.into_iter().map(|color| PixelGradient { color, inverse_depth: 0.0 }).collect()
}

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

pub fn view(npz: &Npz) -> View {
    views(npz).swap_remove(0)
}

pub fn views(npz: &Npz) -> Vec<View> {
    (0..npz.values("cam_t").len() / 3).map(|index| view_of(npz, index)).collect()
}

fn view_of(npz: &Npz, index: usize) -> View {
    let part = |name: &str, count: usize| &npz.values(name)[count * index..][..count];
    let k = part("cam_K", 4);
    let size = part("size_wh", 2);
    let flag = |name: &str| npz.has(name) && npz.scalar(name) != 0.0;
    View {
        camera_from_world: rows(part("cam_R", 9)).try_into().expect("3×3"),
        translation: rows(part("cam_t", 3))[0],
        focal_px: [k[0], k[1]],
        center_px: [k[2], k[3]],
        size_px: [size[0] as u32, size[1] as u32],
        background: rows(part("bg", 3))[0],
        sh_degree: if npz.has("deg") { npz.scalar("deg") as u32 } else { 0 },
        antialias: flag("antialias"),
        antialias_detached: flag("detached"),
        filter_3d: 0.0,
        symmetric_limit: flag("lim_sym"),
        extent: Extent::Reference,
        drawn: match npz.has("kernel") {
            true => Style { dilation_px2: npz.scalar("kernel"), ..Style::AS_THEY_ARE },
            false => Style::AS_THEY_ARE,
        },
    }
}
