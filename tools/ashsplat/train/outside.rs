//! What photos show outside of a block that is trained without its surroundings: pixels that do not count.

use crate::blocks::places::{places, small};
use crate::config::Settings;
use crate::progress::counting;
use crate::session;
use ashsplat::scene::{Bounds, Camera};
use ashsplat::trainer::SceneBlock;
use ashsplat::vk::Context;
use ashsplat::{Error, Frame, Gaussians, RenderSettings, Renderer, Result};
use ashsplat_files::Gallery;
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

/// Less opaque pixels show nothing that could be told to lie outside.
const LEAST_OPACITY: f32 = 0.5;

/// Hides what the photos show outside of a block, if the settings want that: by the depths of the scene that training begins
/// with, drawn once per photo, small. Photos of which nothing is left are left out.
pub fn hide(
    context: &Context,
    gallery: &mut Gallery,
    (scene, settings): (Option<&Gaussians>, &Settings),
    (quiet, stop): (bool, &AtomicBool),
) -> Result<()> {
    let (Some((core, margin)), Some(scene)) = (settings.data.masked_block()?, scene) else { return Ok(()) };
    let mut renderer = Renderer::new(context)?;
    renderer.upload(scene)?;
    let look = RenderSettings { inverse_depth: true, ..settings.train.render_settings() };
    let cameras = gallery.cameras();
    let bar = counting("masks", cameras.len() as u64, quiet);
    let mut kept = BTreeSet::new();
    for (index, named) in cameras.iter().enumerate() {
        session::check(stop)?;
        let camera = small(&named.camera);
        let counts = counting_pixels(&camera, &renderer.render(&camera, &look)?, (core, margin));
        if counts.contains(&true) {
            kept.insert(named.name.clone());
        }
        gallery.hide(index, (camera.width, camera.height), &counts)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    if kept.is_empty() {
        return Err(Error::argument("block", "no photo shows any of it; give another box or margin"));
    }
    let without = cameras.len() - kept.len();
    if without > 0 {
        tell!("{without} of {} photos show nothing of the block: left out", cameras.len());
        gallery.keep(&kept)?;
    }
    Ok(())
}

/// Whether the pixels of a frame count: they show the block grown by its margin, or nothing, or lie next to such a pixel.
fn counting_pixels(camera: &Camera, frame: &Frame, (core, margin): (Bounds, f32)) -> Vec<bool> {
    let [width, height] = [frame.width, frame.height].map(|side| side as usize);
    let shown = places(camera, frame).into_iter().zip(&frame.transmittance).map(|(place, transmittance)| {
        let inside = |place: glam::Vec3| SceneBlock::contains(core, margin, place.to_array());
        1.0 - transmittance < LEAST_OPACITY || place.is_some_and(inside)
    });
    let shown: Vec<bool> = shown.collect();
    let around = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
    let any = |x: usize, y: usize| {
        around(y, height).any(|row| shown[row * width..][..width][around(x, width)].contains(&true))
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| any(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::scene::Intrinsics;
    use glam::{Vec3, vec3};

    /// A wall at depth 2, of which the left half is the block; there is nothing in front of its last columns.
    #[test]
    fn pixels_of_the_block_and_next_to_it_count_and_those_of_nothing() {
        let intrinsics = Intrinsics::from_fov_x(1.0, 40, 20);
        let camera = Camera::look_at(vec3(0.0, 0.0, -2.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
        let transmittance: Vec<f32> = (0..800).map(|pixel| if pixel % 40 < 35 { 0.0 } else { 0.9 }).collect();
        let inverse_depth = Some(transmittance.iter().map(|t| (1.0 - t) / 2.0).collect());
        let color = vec![[0.0; 3]; 800];
        let frame = Frame { width: 40, height: 20, color, transmittance, inverse_depth, ..Frame::default() };
        let everything = Vec3::splat(f32::INFINITY);
        let core = Bounds { min: -everything, max: everything.with_x(0.0) };
        let counts = counting_pixels(&camera, &frame, (core, 0.0));
        for (pixel, counts) in counts.iter().enumerate() {
            assert_eq!(*counts, !(21..34).contains(&(pixel % 40)), "{pixel}");
        }
        // A column is 2 tan(0.5) 2 / 40 = 0.055 wide.
        let wider = counting_pixels(&camera, &frame, (core, 0.1));
        assert!(wider[22] && !wider[23]);
    }
}
