//! Converts the twins' scenes and views to the engine's types.

use super::context;
use crate::reference::types::{Extent, Gaussian, View};
use ashsplat::frame::Dropout;
use ashsplat::scene::Projection;
use ashsplat::vk::Context;
use ashsplat::{Camera, Gaussians, Gradients, JacobianLimit, RenderSettings, Renderer};
use glam::{Mat3, Vec3};
use std::sync::{Mutex, MutexGuard, OnceLock};

/// Parameters, rounded to float32.
pub fn gaussians(twins: &[Gaussian]) -> Gaussians {
    let f = |x: f64| x as f32;
    let stored = twins.first().map_or(1, |g| g.sh.len());
    Gaussians {
        sh_degree: stored.isqrt() as u32 - 1,
        means: twins.iter().map(|g| g.mean.map(f)).collect(),
        quats: twins.iter().map(|g| g.quat.map(f)).collect(),
        log_scales: twins.iter().map(|g| g.log_scale.map(f)).collect(),
        opacity_logits: twins.iter().map(|g| f(g.opacity_logit)).collect(),
        sh: twins.iter().flat_map(|g| g.sh.iter().map(|c| c.map(f))).collect(),
    }
}

/// The inverse of [`gaussians`].
pub fn twins(gaussians: &Gaussians) -> Vec<Gaussian> {
    let f = |x: f32| f64::from(x);
    (0..gaussians.len())
        .map(|i| Gaussian {
            mean: gaussians.means[i].map(f),
            quat: gaussians.quats[i].map(f),
            log_scale: gaussians.log_scales[i].map(f),
            opacity_logit: f(gaussians.opacity_logits[i]),
            sh: gaussians.sh_of(i).iter().map(|c| c.map(f)).collect(),
        })
        .collect()
}

pub fn camera(view: &View) -> Camera {
    let f = |x: f64| x as f32;
    let [x, y, z] = view.camera_from_world.map(|row| Vec3::from_array(row.map(f)));
    Camera {
        camera_from_world: Mat3::from_cols(x, y, z).transpose(),
        translation: Vec3::from_array(view.translation.map(f)),
        fx: f(view.focal_px[0]),
        fy: f(view.focal_px[1]),
        cx: f(view.center_px[0]),
        cy: f(view.center_px[1]),
        width: view.size_px[0],
        height: view.size_px[1],
        projection: match view.drawn.orthographic {
            true => Projection::Orthographic,
            false => Projection::Perspective,
        },
        coefficients: Default::default(),
        part: None,
        shutter: None,
    }
}

pub fn settings(view: &View) -> RenderSettings {
    RenderSettings {
        extent: match view.extent {
            Extent::Exact => ashsplat::Extent::Exact,
            Extent::Reference => ashsplat::Extent::Reference,
        },
        jacobian_limit: match view.symmetric_limit {
            true => JacobianLimit::Symmetric,
            false => JacobianLimit::Edge,
        },
        distance_order: view.drawn.distance_order,
        antialias: view.antialias,
        antialias_detached: view.antialias_detached,
        dilation_px2: view.drawn.dilation_px2 as f32,
        filter_3d: view.filter_3d > 0.0,
        background: view.background.map(|x| x as f32),
        sh_degree: Some(view.sh_degree),
        inverse_depth: true,
        dropout: view.drawn.dropout.map(|dropout| Dropout {
            share: f64::from(dropout.below) / f64::from(1 << 24),
            seed: dropout.seed,
            iteration: dropout.iteration,
        }),
        ..RenderSettings::default()
    }
}

/// One renderer for all tests: its kernels are compiled once.
pub fn renderer() -> MutexGuard<'static, Renderer> {
    static RENDERER: OnceLock<Mutex<Renderer>> = OnceLock::new();
    let renderer = RENDERER.get_or_init(|| Mutex::new(Renderer::new(context()).expect("a renderer")));
    // A failed test does not leave the renderer in a bad state.
    renderer.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

pub fn loaded(context: &Context, scene: &Gaussians) -> Renderer {
    let mut renderer = Renderer::new(context).expect("a renderer");
    renderer.upload(scene).expect("upload");
    renderer
}

pub fn widen<const N: usize>(values: &[[f32; N]]) -> Vec<f64> {
    values.as_flattened().iter().map(|&x| f64::from(x)).collect()
}

/// Gradients of each parameter and of the 2D means, without the pose's gradient.
pub fn derivatives(gradients: &Gradients) -> [&[f32]; 6] {
    let Gaussians { means, quats, log_scales, opacity_logits, sh, .. } = &gradients.parameters;
    [
        means.as_flattened(),
        quats.as_flattened(),
        log_scales.as_flattened(),
        opacity_logits,
        sh.as_flattened(),
        gradients.mean2d_px.as_flattened(),
    ]
}
