//! `ashsplat convert`.

use ashsplat::scene::{Cut, Similarity};
use ashsplat::{Error, Result};
use ashsplat_files::splats::{self, ConvertOptions, Format, Header, Input, Target};
use ashsplat_files::text::numbers;
use ashsplat_program::args::HostArguments;
use ashsplat_program::look::parse_target;
use ashsplat_program::model::Model;
use ashsplat_program::progress::thousands;
use clap::{ArgMatches, Args, FromArgMatches};
use glam::DVec3;
use std::path::PathBuf;

/// Convert Gaussians between formats, change them on the way, and join several files into one.
///
/// --list lists the formats. Changes are made in this order: --sh-degree, --min-opacity, --min-density, --crop-box, --rotate, --scale, --translate, --decimate. With several inputs --rotate,
/// --scale and --translate move the input before them, or everything where they come after OUT.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    inputs: Inputs,
    /// List the formats: what is read and written, what each holds and loses
    #[arg(long, exclusive = true)]
    list: bool,
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
    /// Merge neighbours until N, or N percent, are left
    #[arg(long, value_name = "N|N%", value_parser = parse_target)]
    decimate: Option<Target>,
    /// Version of SPZ: 2, 3 or 4 for .spz [default: 4]; 2 for .glb packs it as KHR_gaussian_splatting_compression_spz_2, which CesiumJS
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

/// Input, output and moves as given.
#[derive(Args)]
struct InputArguments {
    /// Files of Gaussians or model folders, and the new file, whose extension says the format
    #[arg(value_name = "IN... OUT", required = true)]
    paths: Vec<PathBuf>,
    /// The new file, instead of the last of the paths
    #[arg(short, long, value_name = "OUT")]
    out: Option<PathBuf>,
    /// Rotate by these angles about the x, then the y, then the z axis, degrees
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point)]
    rotate: Vec<DVec3>,
    /// Scale by this factor, after the rotation
    #[arg(long, value_name = "X")]
    scale: Vec<f64>,
    /// Move by this, after rotation and scaling
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point)]
    translate: Vec<DVec3>,
}

/// A value of `--rotate`, `--scale` or `--translate`.
#[derive(Clone, Copy)]
enum Step {
    Rotate(DVec3),
    Scale(f64),
    Translate(DVec3),
}

/// Parsed inputs, each with its own similarity.
struct Inputs {
    inputs: Vec<(PathBuf, Similarity)>,
    output: PathBuf,
    /// Similarity of the whole output.
    similarity: Similarity,
}

impl Args for Inputs {
    fn augment_args(command: clap::Command) -> clap::Command {
        InputArguments::augment_args(command)
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        InputArguments::augment_args_for_update(command)
    }
}

impl FromArgMatches for Inputs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let arguments = InputArguments::from_arg_matches(matches)?;
        let places = |name: &str| matches.indices_of(name).into_iter().flatten();
        let mut paths: Vec<(usize, PathBuf)> = places("paths").zip(arguments.paths).collect();
        let refused = |text: String| clap::Error::raw(clap::error::ErrorKind::ValueValidation, text + "\n");
        let last = paths.last().map_or(0, |last| last.0);
        let (place, output) = match arguments.out {
            // An --out before an input does not mark the end of the inputs.
            Some(out) => (places("out").next().filter(|at| *at > last).unwrap_or(usize::MAX), out),
            None if paths.len() > 1 => paths.remove(paths.len() - 1),
            None if matches.get_flag("list") => (0, PathBuf::new()),
            None => return Err(refused("OUT is missing: give the new file after the input".into())),
        };
        let rotate = places("rotate").zip(arguments.rotate.into_iter().map(Step::Rotate));
        let scale = places("scale").zip(arguments.scale.into_iter().map(Step::Scale));
        let translate = places("translate").zip(arguments.translate.into_iter().map(Step::Translate));
        let mut steps: Vec<(usize, Step)> = rotate.chain(scale).chain(translate).collect();
        let of = |steps: Vec<Step>| similarity(&steps).map_err(refused);
        let everything = steps.extract_if(.., |(at, _)| *at > place || paths.len() == 1);
        let everything = of(everything.map(|(_, step)| step).collect())?;
        let mut inputs = Vec::new();
        while let Some((start, path)) = paths.pop() {
            let own = steps.extract_if(.., |(at, _)| *at > start).map(|(_, step)| step).collect();
            inputs.insert(0, (path, of(own)?));
        }
        if !steps.is_empty() {
            let problem = "--rotate, --scale and --translate come after the input that they move";
            return Err(refused(problem.into()));
        }
        Ok(Self { inputs, output, similarity: everything })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The similarity of one input: rotation, then scale, then translation.
fn similarity(steps: &[Step]) -> Result<Similarity, String> {
    let (mut rotate, mut scale, mut translate) = (None, None, None);
    for step in steps {
        let (earlier, name) = match *step {
            Step::Rotate(angles) => (rotate.replace(angles).is_some(), "--rotate"),
            Step::Scale(factor) => (scale.replace(factor).is_some(), "--scale"),
            Step::Translate(by) => (translate.replace(by).is_some(), "--translate"),
        };
        if earlier {
            return Err(format!("{name} is given twice for one scene"));
        }
    }
    let scale = scale.unwrap_or(1.0);
    if !(scale.is_finite() && scale > 0.0) {
        return Err(format!("--scale {scale} is not a positive number"));
    }
    Ok(Similarity::of_angles(rotate.unwrap_or_default(), scale, translate.unwrap_or_default()))
}

fn parse_box(text: &str) -> Result<[DVec3; 2], String> {
    let corners = numbers(text).filter(|numbers: &[f64; 6]| !numbers.iter().any(|v| v.is_nan()));
    let [a, b, c, x, y, z] = corners.ok_or("expected six numbers with commas between them")?;
    Ok([DVec3::new(a, b, c), DVec3::new(x, y, z)])
}

fn parse_point(text: &str) -> Result<DVec3, String> {
    let point = numbers(text).map(DVec3::from_array).filter(|point| point.is_finite());
    point.ok_or_else(|| "expected three numbers with commas between them".into())
}

pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.list {
        Format::ALL.iter().for_each(|format| outln!("{}", format.description()));
        return Ok(());
    }
    let options = arguments.options()?;
    let output = &arguments.inputs.output;
    let inputs = &arguments.inputs.inputs;
    let has_folder = inputs.iter().any(|(path, _)| path.is_dir());
    // Files and model folders may be mixed.
    let iteration_of = |path: &PathBuf| arguments.iteration.filter(|_| path.is_dir() || !has_folder);
    let located = |(path, _): &(PathBuf, Similarity)| Ok(Model::locate(path, iteration_of(path))?.ply);
    let files = inputs.iter().map(located).collect::<Result<Vec<PathBuf>>>()?;
    let replaced = output.canonicalize();
    let is_output =
        |file: &PathBuf| replaced.is_ok() && file.canonicalize().ok() == replaced.as_ref().ok().cloned();
    if files.iter().any(is_output) {
        let problem = format!("{} is the input itself; give another file", output.display());
        return Err(Error::argument("OUT", problem));
    }
    let inputs: Vec<Input<'_>> = files
        .iter()
        .zip(&arguments.inputs.inputs)
        .map(|(path, (_, similarity))| Input { similarity: *similarity, ..Input::new(path) })
        .collect();
    let done = splats::join(&inputs, output, &options)?;
    for warning in &done.warnings {
        errln!("warning: {warning}");
    }
    if !arguments.quiet {
        let described = |(file, input): (&PathBuf, &Header)| {
            let (count, degree) = (thousands(input.count), input.sh_degree);
            format!("{} ({}, {count} Gaussians, SH degree {degree})", file.display(), input.format)
        };
        let from: Vec<String> = files.iter().zip(&done.inputs).map(described).collect();
        outln!(
            "{} -> {} ({}, {} Gaussians, SH degree {}){}{}",
            from.join(" + "),
            output.display(),
            done.format,
            thousands(done.written),
            done.sh_degree,
            if done.inputs.iter().any(|input| input.antialiased) { ", antialiased" } else { "" },
            if replaced.is_ok() { ", in place of an earlier file" } else { "" },
        );
    }
    Ok(())
}

impl Arguments {
    fn options(&self) -> Result<ConvertOptions> {
        if let Some(opacity) = self.min_opacity.filter(|o| !(0.0..=1.0).contains(o)) {
            return Err(Error::argument("--min-opacity", format!("{opacity} is not between 0 and 1")));
        }
        let min_density = self.min_density.unwrap_or_default();
        if !(min_density.is_finite() && min_density >= 0.0) {
            return Err(Error::argument("--min-density", format!("{min_density} is not 0 or more")));
        }
        let format = Format::of_extension(&self.inputs.output)?;
        splats::check_spz_version(format, self.spz_version).map_err(|_| {
            Error::argument("--spz-version", "give 2, 3 or 4 for .spz, 2 for .glb, none for others")
        })?;
        Ok(ConvertOptions {
            read: self.host.reading(self.drop_invalid),
            sh_degree: self.sh_degree,
            cut: Cut { min_opacity: self.min_opacity.unwrap_or_default(), min_density, ..Cut::default() },
            crop_box: self.crop_box,
            similarity: self.inputs.similarity,
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
