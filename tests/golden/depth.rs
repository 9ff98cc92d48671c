//! Inverse-depth maps: the fit of their scale, the loss and its gradients; host and device against the vectors.

use super::Outcome;
use super::rendering::SINGLE;
use super::sets::{EXTENTS, gaussians, view};
use crate::common::engine;
use crate::common::prelude::*;
use crate::common::terms::inverse_depth_l1;
use crate::golden::npz::Npz;
use ashsplat_files::depth_fit::{DepthFit, ObservedPoint};
use ashsplat_files::images::DepthMap;
use std::path::Path;

struct Computed {
    inverse_depth: Vec<f64>,
    loss: f64,
    of_inverse_depth: Vec<f64>,
    /// Gradients of means, quaternions, log-scales, opacity logits.
    gradients: [Vec<f64>; 4],
}

fn judge(npz: &Npz, prefix: &str, computed: &Computed) -> Result<(), String> {
    let field = |name: &str| npz.values(&format!("{prefix}{name}"));
    let unstable = npz.flags("pix_unstable");
    pixels("inverse depth", &computed.inverse_depth, field("inv_depth"), &unstable, SINGLE.image)?;
    elementwise("loss", &[computed.loss], field("loss"), 0.0, 1e-5)?;
    gradient("d_inv_depth", &computed.of_inverse_depth, field("d_inv_depth"), &unstable, SINGLE.gradient)?;
    let names = ["dx_means", "dx_quats", "dx_log_scales", "dx_opacity_logits"];
    for (name, values) in names.into_iter().zip(&computed.gradients) {
        let expected = field(name);
        let skip = vec![false; npz.values("opacity_logits").len()];
        let bound = if name == "dx_quats" { SINGLE.quats } else { SINGLE.gradient };
        gradient(name, values, expected, &skip, bound)?;
    }
    Ok(())
}

fn targets(npz: &Npz) -> Vec<Option<f64>> {
    let pairs = npz.values("target").iter().zip(npz.values("mask"));
    pairs.map(|(&target, &mask)| Some(target).filter(|_| mask != 0.0)).collect()
}

pub fn check(path: &Path) -> Outcome {
    of_host(path)?;
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let map: Vec<f32> =
        targets(&npz).iter().map(|target| target.map_or(f32::INFINITY, |x| x as f32)).collect();
    for (extent, prefix) in EXTENTS {
        let view = View { extent, ..view(&npz) };
        let size = view.size_px.map(|side| side as usize);
        let settings = RenderSettings { inverse_depth: true, ..engine::settings(&view) };
        let camera = engine::camera(&view);
        let mut renderer = engine::renderer();
        renderer.upload(&engine::gaussians(&gaussians(&npz, "")))?;
        let frame = renderer.render(&camera, &settings)?;
        let depth = frame.inverse_depth.expect("asked for");
        let mut found = Vec::new();
        for strips in [false, true] {
            found.push(inverse_depth_l1(&gpu, &depth, &map, size, (npz.scalar("weight"), strips, 0.0)));
        }
        let (loss, of_inverse_depth) = found.remove(0);
        elementwise("loss of strips", &[found[0].0], &[loss], 0.0, 1e-6)?;
        equal("gradient of strips", &found[0].1, &of_inverse_depth)?;
        let narrow: Vec<f32> = of_inverse_depth.iter().map(|&x| x as f32).collect();
        let none = vec![[0.0; 3]; narrow.len()];
        let all = renderer.gradients(&camera, &settings, &none, Some(&narrow))?.parameters;
        drop(renderer);
        let gradients = [
            engine::widen(&all.means),
            engine::widen(&all.quats),
            engine::widen(&all.log_scales),
            all.opacity_logits.iter().map(|&x| f64::from(x)).collect(),
        ];
        let inverse_depth = depth.into_iter().map(f64::from).collect();
        let computed = Computed { inverse_depth, loss, of_inverse_depth, gradients };
        judge(&npz, prefix, &computed).map_err(|e| format!("{extent:?}: {e}"))?;
    }
    Ok(())
}

/// Scales and offsets of the maps, the maps kept, and the target of one.
fn of_host(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let &[maps, height, width] = &npz.array("mono").shape[..] else { return Err("no maps".into()) };
    let mono: Vec<f32> = npz.values("mono").iter().map(|&x| x as f32).collect();
    let maps: Vec<DepthMap> = mono
        .chunks(height * width)
        .take(maps)
        .map(|values| DepthMap { width: width as u32, height: height as u32, values: values.to_vec() })
        .collect();
    let full = npz.values("full_wh");
    let camera_size = (full[0] as u32, full[1] as u32);
    let observed: Vec<(usize, ObservedPoint)> = npz
        .values("obs_image")
        .iter()
        .zip(npz.rows::<2>("obs_xy"))
        .zip(npz.values("obs_inv_z"))
        .map(|((&image, position_px), &inverse_z)| (image as usize, ObservedPoint { position_px, inverse_z }))
        .collect();
    let ratio = height as f64 / full[1];
    for ((image, point), (&expected, valid)) in
        observed.iter().zip(npz.values("obs_mono").iter().zip(npz.flags("obs_valid")))
    {
        let [x, y] = point.position_px.map(|place| place * ratio);
        if valid {
            elementwise("sample", &[maps[*image].sample(x, y)], &[expected], 1e-6, 1e-6)?;
        }
    }
    let fits: Vec<DepthFit> = maps
        .iter()
        .enumerate()
        .map(|(image, map)| {
            let own = observed.iter().filter(|(of, _)| *of == image).map(|(_, point)| *point);
            DepthFit::of(map, camera_size, &own.collect::<Vec<_>>()).0
        })
        .collect();
    let column = |of: fn(&DepthFit) -> f64| fits.iter().map(of).collect::<Vec<f64>>();
    elementwise("scale", &column(|fit| fit.scale), npz.values("scale"), 1e-5, 1e-5)?;
    elementwise("offset", &column(|fit| fit.offset), npz.values("offset"), 1e-5, 1e-5)?;
    let median = DepthFit::median_scale(&fits);
    elementwise("median", &[median], npz.values("median_scale"), 1e-5, 1e-5)?;
    let kept = |fit: &DepthFit| f64::from(u8::from(fit.is_reliable(median)));
    equal("kept", &fits.iter().map(kept).collect::<Vec<_>>(), npz.values("reliable"))?;
    let used = npz.scalar("used_map") as usize;
    let &[height, width] = &npz.array("target").shape[..] else { return Err("no target".into()) };
    let target: Vec<f64> = maps[used]
        .resized(width as u32, height as u32)
        .values
        .iter()
        .map(|&x| fits[used].scale * f64::from(x) + fits[used].offset)
        .collect();
    elementwise("target", &target, npz.values("target"), 1e-6, 1e-6)?;
    Ok(())
}
