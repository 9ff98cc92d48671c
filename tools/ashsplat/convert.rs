//! `ashsplat convert`.

use crate::args::HostArguments;
use crate::model::Model;
use crate::progress::thousands;
use crate::render::parse_numbers;
use ashsplat::scene::{Cut, Similarity};
use ashsplat::{Error, Result};
use ashsplat_files::splats::{self, ConvertOptions, Format, Target};
use clap::Args;
use glam::{DQuat, DVec3, EulerRot};
use std::path::PathBuf;

/// Convert Gaussians between formats, and change them on the way.
///
/// The formats are those of the extensions .ply (the reference's), .compressed.ply (PlayCanvas), .splat, .spz
/// (version 4, or 2; 3 is read too), .glb and .gltf (KHR_gaussian_splatting). Changes are made in this order:
/// --sh-degree, --min-opacity, --min-density, --crop-box, --rotate, --scale, --translate, --decimate.
#[derive(Args)]
pub struct Arguments {
    /// A file of Gaussians, or a model folder
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// The new file; its extension says the format
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Iteration of the model folder's PLY [default: what was saved last]
    #[arg(long, value_name = "N")]
    iteration: Option<u32>,
    /// Highest degree of the spherical harmonics that is kept, 0 to 3
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=3))]
    sh_degree: Option<u32>,
    /// Leave out Gaussians that are fainter, 0 to 1
    #[arg(long, value_name = "X")]
    min_opacity: Option<f32>,
    /// Leave out floaters, which are faint for their size: Gaussians whose opacity / (1 - opacity) per largest standard
    /// deviation is less, in the input's units of length; `ashsplat info` tells how they spread
    #[arg(long, value_name = "X")]
    min_density: Option<f32>,
    /// Leave out Gaussians with centres outside this box: two opposite corners, in the input's axes; sides may be inf or -inf
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true, value_parser = parse_box)]
    crop_box: Option<[DVec3; 2]>,
    /// Rotate by these angles about the x, then the y, then the z axis, degrees
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point)]
    rotate: Option<DVec3>,
    /// Scale by this factor, after the rotation
    #[arg(long, value_name = "X")]
    scale: Option<f64>,
    /// Move by this, after rotation and scaling
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point)]
    translate: Option<DVec3>,
    /// Merge neighbours until N, or N percent, are left
    #[arg(long, value_name = "N|N%", value_parser = parse_target)]
    decimate: Option<Target>,
    /// Version of SPZ: 2 or 4 for .spz [default: 4]; 2 for .glb packs it as KHR_gaussian_splatting_compression_spz_2, which CesiumJS
    /// reads
    #[arg(long, value_name = "N")]
    spz_version: Option<u32>,
    /// Drop the Gaussians whose parameters are not finite, instead of refusing the file
    #[arg(long)]
    drop_invalid: bool,
    #[command(flatten)]
    host: HostArguments,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

fn parse_box(text: &str) -> Result<[DVec3; 2], String> {
    let corners = parse_numbers(text).filter(|numbers: &[f64; 6]| !numbers.iter().any(|v| v.is_nan()));
    let [a, b, c, x, y, z] = corners.ok_or("expected six numbers with commas between them")?;
    Ok([DVec3::new(a, b, c), DVec3::new(x, y, z)])
}

fn parse_point(text: &str) -> Result<DVec3, String> {
    let point = parse_numbers(text).map(DVec3::from_array).filter(|point| point.is_finite());
    point.ok_or_else(|| "expected three numbers with commas between them".into())
}

pub fn parse_target(text: &str) -> Result<Target, String> {
    let problem = || "expected a number above 0, or 0 to 100 with %".to_owned();
    match text.strip_suffix('%') {
        Some(percent) => match percent.trim().parse::<f64>() {
            Ok(percent) if (0.0..=100.0).contains(&percent) && percent > 0.0 => {
                Ok(Target::Share(percent / 100.0))
            }
            _ => Err(problem()),
        },
        None => text.parse().ok().filter(|&count| count > 0).map(Target::Count).ok_or_else(problem),
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let options = arguments.options()?;
    let input = Model::locate(&arguments.input, arguments.iteration)?.ply;
    let same = |input: PathBuf| arguments.output.canonicalize().is_ok_and(|output| input == output);
    if input.canonicalize().is_ok_and(same) {
        let problem = format!("{} is the input itself; give another file", arguments.output.display());
        return Err(Error::argument("OUT", problem));
    }
    let replaced = arguments.output.exists();
    let done = splats::convert(&input, &arguments.output, &options)?;
    for warning in &done.warnings {
        tell!("warning: {warning}");
    }
    if !arguments.quiet {
        let (from, to) = (input.display(), arguments.output.display());
        let input = &done.input;
        say!(
            "{from} ({}, {} Gaussians, SH degree {}) -> {to} ({}, {} Gaussians, SH degree {}){}{}",
            input.format,
            thousands(input.count),
            input.sh_degree,
            done.format,
            thousands(done.written),
            done.sh_degree,
            if input.antialiased { ", antialiased" } else { "" },
            if replaced { ", in place of an earlier file" } else { "" },
        );
    }
    Ok(())
}

impl Arguments {
    fn options(&self) -> Result<ConvertOptions> {
        let scale = self.scale.unwrap_or(1.0);
        if !(scale.is_finite() && scale > 0.0) {
            return Err(Error::argument("--scale", format!("{scale} is not a positive number")));
        }
        if let Some(opacity) = self.min_opacity.filter(|o| !(0.0..=1.0).contains(o)) {
            return Err(Error::argument("--min-opacity", format!("{opacity} is not between 0 and 1")));
        }
        let min_density = self.min_density.unwrap_or_default();
        if !(min_density.is_finite() && min_density >= 0.0) {
            return Err(Error::argument("--min-density", format!("{min_density} is not 0 or more")));
        }
        let format = Format::of_extension(&self.output)?;
        splats::check_spz_version(format, self.spz_version).map_err(|_| {
            Error::argument("--spz-version", "give 2 or 4 for .spz, 2 for .glb, none for others")
        })?;
        let [x, y, z] = self.rotate.unwrap_or_default().to_array().map(f64::to_radians);
        Ok(ConvertOptions {
            read: self.host.reading(self.drop_invalid),
            sh_degree: self.sh_degree,
            cut: Cut { min_opacity: self.min_opacity.unwrap_or_default(), min_density, ..Cut::default() },
            crop_box: self.crop_box,
            similarity: Similarity {
                // The last is applied first.
                rotation: DQuat::from_euler(EulerRot::ZYX, z, y, x),
                scale,
                translation: self.translate.unwrap_or_default(),
            },
            decimate: self.decimate,
            format: Some(format),
            spz_version: self.spz_version,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_targets() {
        let corners = parse_box("500000.125,-2,3, -inf,2,0").expect("a box");
        assert_eq!(corners, [DVec3::new(500_000.125, -2.0, 3.0), DVec3::new(f64::NEG_INFINITY, 2.0, 0.0)]);
        assert!(parse_box("1,2,3").is_err() && parse_box("1,2,3,4,5,nan").is_err());
        assert_eq!(parse_target("12"), Ok(Target::Count(12)));
        assert_eq!(parse_target("12.5%"), Ok(Target::Share(0.125)));
        for wrong in ["0", "-3", "0%", "101%", "x", "NaN%"] {
            assert!(parse_target(wrong).is_err(), "{wrong}");
        }
    }
}
