//! Finds what photos show of the trained block: by the division's file, else by the depths of the initial scene, which
//! is drawn small, once per photo.
//!
//! Only that part of a photo is used. Without the block's surroundings, pixels that show them do not count.

use ashsplat::vk::Context;
use ashsplat::{Error, Gaussians, RenderSettings, Renderer, Result};
use ashsplat_files::Gallery;
use ashsplat_program::blocks::job::Job;
use ashsplat_program::blocks::parts::{BlockPixels, Part, small};
use ashsplat_program::config::Settings;
use ashsplat_program::progress::counting;
use ashsplat_program::session;
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

/// Selects the used parts and pixels of the photos by the settings, and removes photos that do not show the block.
/// Returns a note, if any.
pub fn look(
    context: &Context,
    gallery: &mut Gallery,
    (scene, settings, job): (Option<&Gaussians>, &Settings, Option<&Job>),
    (quiet, stop): (bool, &AtomicBool),
) -> Result<Option<String>> {
    let frame = gallery.frame();
    let (masked, parts) = (settings.data.masked_block(frame)?, settings.data.block_of_parts(frame)?);
    if let (Some(block), Some(scene)) = (masked.or(parts), scene) {
        let mut renderer = Renderer::new(context)?;
        renderer.upload(scene)?;
        let look = RenderSettings { inverse_depth: true, ..settings.train.render_settings() };
        let cameras = gallery.cameras();
        let held_out = gallery.held_out();
        let bar = counting("what photos show", cameras.len() as u64, quiet);
        let (mut kept, mut trained) = (BTreeSet::new(), 0_usize);
        for (index, (named, held_out)) in cameras.iter().zip(held_out).enumerate() {
            session::check(stop)?;
            let camera = small(&named.camera);
            let shown = BlockPixels::of(&camera, &renderer.render(&camera, &look)?, block);
            let mut is_used = true;
            if parts.is_some() {
                let part = shown.part();
                is_used = part.is_some();
                part.map_or(Ok(()), |part| use_part(gallery, index, part))?;
            }
            if masked.is_some() {
                let counts = shown.counting();
                // Without parts, held-out photos stay whole.
                is_used &= counts.contains(&true) || held_out && parts.is_none();
                gallery.hide(index, (camera.width, camera.height), &counts)?;
            }
            if is_used {
                kept.insert(named.name.clone());
                trained += usize::from(!held_out);
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        if kept.is_empty() || parts.is_some() && trained == 0 {
            return Err(Error::argument("block", "no photo shows any of it; give another box or margin"));
        }
        let without = cameras.len() - kept.len();
        if without > 0 {
            errln!("{without} of {} photos show nothing of the block: left out", cameras.len());
            gallery.keep(&kept)?;
        }
    }
    if let Some(job) = job.filter(|_| settings.data.uses_parts_of_job()) {
        for (index, named) in gallery.cameras().iter().enumerate() {
            let part = job.block().parts.get(&named.name);
            part.map_or(Ok(()), |&part| use_part(gallery, index, part))?;
        }
    }
    let shares: Vec<f64> =
        (0..gallery.held_out().len()).filter_map(|index| gallery.share_used(index)).collect();
    let used = shares.iter().sum::<f64>() / shares.len().max(1) as f64;
    Ok((used < 1.0).then(|| {
        format!("of the photos {:.0} % are used: what shows the block (--photo-parts)", 100.0 * used)
    }))
}

fn use_part(gallery: &mut Gallery, index: usize, part: Part) -> Result<()> {
    let Part { of: [width, height], columns, rows } = part;
    gallery.use_part(index, (width, height), columns[0]..columns[1], rows[0]..rows[1])
}
