//! Prints an evaluation as a table or as JSON.

use super::{Evaluation, SceneSize, ViewResult};
use crate::progress::thousands;
use serde_json::{Map, Value, json};

pub fn print(json: bool, evaluation: &Evaluation, device: &str) {
    let scene = evaluation.scene;
    if json {
        let value = json!({
            "gaussians": scene.map(|scene| scene.gaussians),
            "scene_bytes": scene.and_then(|scene| scene.bytes),
            "device": device,
            "mean": evaluation.summary(),
            "aligned_views": evaluation.aligned.as_ref().map(|aligned| {
                aligned.views.iter().map(|view| json_of(view, &aligned.measures)).collect::<Vec<_>>()
            }),
            "views": evaluation.views.iter().map(|view| json_of(view, &evaluation.measures)).collect::<Vec<_>>(),
        });
        say!("{value:#}");
        return;
    }
    let columns = |values: &mut dyn Iterator<Item = (&str, String)>| -> String {
        values.map(|(name, value)| format!(" {value:>0$}", name.len().max(8))).collect()
    };
    let heads = columns(&mut evaluation.measures.iter().map(|name| (*name, (*name).to_owned())));
    say!("{:<28} {:>8} {:>8}{heads}", "view", "PSNR", "SSIM");
    for view in &evaluation.views {
        let named = evaluation.measures.iter().zip(&view.lpips);
        let lpips = columns(&mut named.map(|(name, value)| (*name, format!("{value:.4}"))));
        say!("{:<28} {:>8.3} {:>8.4}{lpips}", view.name, view.psnr, view.ssim);
    }
    if evaluation.views.is_empty() {
        say!("no view was measured");
        return;
    }
    let mean = format!("mean of {}", evaluation.views.len());
    let lpips = columns(&mut evaluation.lpips().map(|(name, value)| (name, format!("{value:.4}"))));
    say!("{mean:<28} {:>8.3} {:>8.4}{lpips}", evaluation.psnr(), evaluation.ssim());
    if let Some(aligned) = &evaluation.aligned {
        say!("{:<28} {:>8.3} {:>8.4}", "  with cameras aligned", aligned.psnr(), aligned.ssim());
    }
    if let Some(SceneSize { gaussians, bytes }) = scene {
        let file = bytes.map_or_else(String::new, |bytes| format!(", {:.2} MB", bytes as f64 * 1e-6));
        let time = evaluation.frame_ms().unwrap_or(f64::NAN);
        say!("{} Gaussians{file}, {time:.2} ms per frame on {device}", thousands(gaussians));
    }
    if evaluation.measures.is_empty() {
        say!("LPIPS is not measured: it needs the weights of a network (--lpips-weights FILE)");
    }
}

fn json_of(view: &ViewResult, measures: &[&str]) -> Value {
    let mut value = Map::new();
    value.insert("name".into(), json!(view.name));
    value.insert("PSNR".into(), json!(view.psnr));
    value.insert("SSIM".into(), json!(view.ssim));
    measures
        .iter()
        .zip(&view.lpips)
        .for_each(|(name, lpips)| drop(value.insert((*name).into(), json!(lpips))));
    view.frame_ms.map(|time| value.insert("frame_ms".into(), json!(time)));
    Value::Object(value)
}
