//! LPIPS of views, with weights that the user gives.

use crate::args::HostArguments;
use ashsplat::lpips::{Lpips, Weights};
use ashsplat::vk::Context;
use ashsplat::{Error, Frame, Result};
use ashsplat_files::{Gallery, View, WeightsFile};
use std::path::PathBuf;

/// Reads weight files, before any other work.
pub fn read_weights(files: &[PathBuf], host: &HostArguments) -> Result<Vec<Weights>> {
    let mut all: Vec<Weights> = Vec::new();
    for path in files {
        let weights = Weights::read(path, &host.memory())?;
        if all.iter().any(|other| other.network == weights.network) {
            let problem = format!("has the weights of {} once more", weights.network.name());
            return Err(Error::input(path, problem, "give one file for each network"));
        }
        all.push(weights);
    }
    Ok(all)
}

/// Refuses photos that are too small for a network. With `halves`, only the right half of held-out photos counts.
pub fn check_sizes(weights: &[Weights], gallery: &Gallery, chosen: &[usize], halves: bool) -> Result<()> {
    for (network, &index) in weights.iter().flat_map(|of| chosen.iter().map(|index| (of.network, index))) {
        let Some((width, height)) = gallery.size(index) else { continue };
        let width = if halves && gallery.held_out()[index] { width - width / 2 } else { width };
        if let Err(Error::Argument { problem, .. }) = network.check_size(width, height) {
            let name = gallery.cameras().swap_remove(index).name;
            let half = if halves { " (of held-out photos the right half counts)" } else { "" };
            let is_part = gallery.share_used(index).is_some_and(|share| share < 1.0);
            let (part, whole) = match is_part {
                true => ("the part that shows the block of ", "--photo-parts off, "),
                false => ("", ""),
            };
            return Err(Error::argument(
                "--lpips-weights",
                format!("{part}photo {name} {problem}{half}; give {whole}larger photos (-r), or no LPIPS"),
            ));
        }
    }
    Ok(())
}

/// LPIPS networks on the device.
pub struct Perceptual {
    networks: Vec<Lpips>,
}

impl Perceptual {
    /// Returns `None` without weights.
    pub fn new(context: &Context, weights: &[Weights]) -> Result<Option<Perceptual>> {
        let networks =
            weights.iter().map(|weights| Lpips::new(context, weights)).collect::<Result<Vec<_>>>()?;
        Ok((!networks.is_empty()).then_some(Perceptual { networks }))
    }

    /// Names of the measures.
    pub fn names(&self) -> Vec<&'static str> {
        self.networks.iter().map(|lpips| lpips.network().measure()).collect()
    }

    /// One value for each name. Masked pixels are black in both pictures.
    pub fn measure(&mut self, view: &View, frame: &Frame) -> Result<Vec<f64>> {
        let mut photo = view.photo.photo()?.to_f32();
        let mut color = std::borrow::Cow::Borrowed(&frame.color);
        if let Some(mask) = view.photo.mask()? {
            let hide = |picture: &mut Vec<[f32; 3]>| {
                picture
                    .iter_mut()
                    .zip(mask.iter())
                    .filter(|(_, counts)| **counts == 0)
                    .for_each(|(p, _)| *p = [0.0; 3]);
            };
            hide(&mut photo);
            hide(color.to_mut());
        }
        let size = (frame.width, frame.height);
        self.networks.iter_mut().map(|lpips| lpips.distance([&color, &photo], size)).collect()
    }
}
