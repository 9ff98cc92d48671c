//! What photos show of the block that is trained: by the depths of the scene that training begins with, drawn once per photo, small.
//!
//! Only that part of a photo is used, and without the block's surroundings pixels of the rest do not count.

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
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Less opaque pixels show nothing that could be told to lie outside.
const LEAST_OPACITY: f32 = 0.5;

/// Chooses what is used of the photos that are trained on, as the settings want it. Photos that show nothing of the block are left
/// out. A line about it, if there is anything to say.
pub fn look(
    context: &Context,
    gallery: &mut Gallery,
    (scene, settings): (Option<&Gaussians>, &Settings),
    (quiet, stop): (bool, &AtomicBool),
) -> Result<Option<String>> {
    let (masked, parts) = (settings.data.masked_block()?, settings.data.block_of_parts()?);
    let (Some((core, margin)), Some(scene)) = (masked.or(parts), scene) else { return Ok(None) };
    let mut renderer = Renderer::new(context)?;
    renderer.upload(scene)?;
    let look = RenderSettings { inverse_depth: true, ..settings.train.render_settings() };
    let cameras = gallery.cameras();
    let held_out = gallery.held_out().to_vec();
    let bar = counting("what photos show", cameras.len() as u64, quiet);
    let (mut kept, mut used, mut trained) = (BTreeSet::new(), 0.0, 0_usize);
    for (index, (named, held_out)) in cameras.iter().zip(held_out).enumerate() {
        session::check(stop)?;
        let camera = small(&named.camera);
        let size = (camera.width, camera.height);
        let shown = Shown::of(&camera, &renderer.render(&camera, &look)?, (core, margin));
        let part = shown.part();
        let mut is_used = held_out || part.is_some();
        if masked.is_some() {
            let counts = shown.counting();
            is_used = counts.contains(&true);
            gallery.hide(index, size, &counts)?;
        }
        if is_used {
            kept.insert(named.name.clone());
        }
        // Held-out photos are tests, which stay as they are.
        if is_used && !held_out {
            if let Some([columns, rows]) = part.filter(|_| parts.is_some()) {
                gallery.use_part(index, size, columns, rows)?;
            }
            used += gallery.share_used(index).unwrap_or(1.0);
            trained += 1;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if kept.is_empty() || parts.is_some() && trained == 0 {
        return Err(Error::argument("block", "no photo shows any of it; give another box or margin"));
    }
    let without = cameras.len() - kept.len();
    if without > 0 {
        tell!("{without} of {} photos show nothing of the block: left out", cameras.len());
        gallery.keep(&kept)?;
    }
    let share = used / trained.max(1) as f64;
    let line =
        || format!("of the photos {:.0} % are used: what shows the block (--photo-parts)", 100.0 * share);
    Ok((share < 1.0).then(line))
}

/// What the pixels of a small picture show.
struct Shown {
    size: [usize; 2],
    /// Whether that is the block, grown by its margin; None for nothing.
    inside: Vec<Option<bool>>,
}

impl Shown {
    fn of(camera: &Camera, frame: &Frame, (core, margin): (Bounds, f32)) -> Self {
        let inside = |place: glam::Vec3| SceneBlock::contains(core, margin, place.to_array());
        let pixels = places(camera, frame).into_iter().zip(&frame.transmittance);
        let inside = pixels
            .map(|(place, transmittance)| place.filter(|_| 1.0 - transmittance >= LEAST_OPACITY).map(inside));
        Self { size: [frame.width, frame.height].map(|side| side as usize), inside: inside.collect() }
    }

    /// Whether each pixel counts: they show the block, or nothing, or lie next to such a pixel.
    fn counting(&self) -> Vec<bool> {
        let [width, height] = self.size;
        let shown: Vec<bool> = self.inside.iter().map(|inside| *inside != Some(false)).collect();
        let around = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let any = |x: usize, y: usize| {
            around(y, height).any(|row| shown[row * width..][..width][around(x, width)].contains(&true))
        };
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| any(x, y)).collect()
    }

    /// The columns and rows with all pixels that show the block, and those next to them. None without any.
    fn part(&self) -> Option<[Range<u32>; 2]> {
        let [width, height] = self.size;
        let shows = |pixel: &usize| self.inside[*pixel] == Some(true);
        let shown = (0..self.inside.len()).filter(shows);
        let grown = |places: &mut dyn Iterator<Item = usize>, end: usize| {
            let (first, last) = places.fold((usize::MAX, 0), |(a, b), place| (a.min(place), b.max(place)));
            let part = first.saturating_sub(1) as u32..(last + 2).min(end) as u32;
            (first <= last).then_some(part)
        };
        let columns = grown(&mut shown.clone().map(|pixel| pixel % width), width)?;
        Some([columns, grown(&mut shown.map(|pixel| pixel / width), height)?])
    }
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
        let shown = |margin: f32| Shown::of(&camera, &frame, (core, margin));
        let counts = shown(0.0).counting();
        for (pixel, counts) in counts.iter().enumerate() {
            assert_eq!(*counts, !(21..34).contains(&(pixel % 40)), "{pixel}");
        }
        // A column is 2 tan(0.5) 2 / 40 = 0.055 wide.
        let wider = shown(0.1).counting();
        assert!(wider[22] && !wider[23]);
        assert_eq!((shown(0.0).part(), shown(0.1).part()), (Some([0..21, 0..20]), Some([0..23, 0..20])));
        let nothing = Bounds { min: Vec3::splat(9.0), max: everything };
        assert_eq!(Shown::of(&camera, &frame, (nothing, 0.0)).part(), None);
    }
}
