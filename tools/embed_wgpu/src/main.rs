//! A wgpu host that lends ashsplat its frames: how to embed beside wgpu.
//!
//!     tools/embed_wgpu/check
//!     cargo run --release -- [SCENE] [-o PICTURE.png] [--check]
//!
//! `device.rs` and `guest.rs` are what a host adds; `passes.rs` is what it has already. `--check` compares the picture with
//! `Renderer::render`'s, and fails if they differ or if the validation layer reports anything.

mod device;
mod guest;
#[path = "../../embed/messages.rs"]
mod messages;
mod passes;

use ashsplat::glam::Vec3;
use ashsplat::scene::{Camera, Gaussians, Intrinsics};
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{RenderSettings, Renderer};
use ashsplat_files::{Photo, PhotoFileFormat, splats};
use device::Host;
use guest::Guest;
use messages::Messages;
use passes::Passes;
use std::path::PathBuf;
use std::process::ExitCode;

pub type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const SIZE: [u32; 2] = [480, 360];
const FRAMES: u32 = 5;
const FRAMES_IN_FLIGHT: u32 = 2;
/// The target holds 16-bit floats, and the picture is rounded to 8 bits: one step where they round differently.
const LARGEST_DIFFERENCE: u8 = 1;

struct Arguments {
    scene: Option<PathBuf>,
    picture: PathBuf,
    check: bool,
}

impl Arguments {
    fn read() -> Result<Self> {
        let mut read = Self { scene: None, picture: "embed_wgpu.png".into(), check: false };
        let mut all = std::env::args_os().skip(1);
        while let Some(argument) = all.next() {
            match argument.to_str() {
                Some("--check") => read.check = true,
                Some("-o") => read.picture = all.next().ok_or("-o: a file is missing")?.into(),
                Some(option) if option.starts_with('-') => {
                    return Err(format!("unknown option {option}: there are -o FILE and --check").into());
                }
                _ => read.scene = Some(argument.into()),
            }
        }
        Ok(read)
    }
}

fn main() -> ExitCode {
    match Arguments::read().and_then(|arguments| run(&arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let gaussians = match &arguments.scene {
        Some(path) => splats::read(path, &Default::default())?.gaussians,
        None => ball(),
    };
    let validation = ashsplat::vk::validation_available();
    let instance = device::instance(validation)?;
    // SAFETY: with validation the extension is present; finished below, before the instance is dropped.
    let messages = validation.then(|| unsafe { device::messages(&instance) }).transpose()?;
    let rgb = draw(&instance, &gaussians, validation);
    let said = messages.map(Messages::finish);
    let rgb = rgb?;
    let [width, height] = SIZE;
    Photo { width, height, rgb: rgb.clone() }.write_png(&arguments.picture)?;
    println!("{}", arguments.picture.display());
    match &said {
        Some(texts) => println!("{} validation messages", texts.len()),
        None => println!("there is no validation layer"),
    }
    if arguments.check {
        if let Some(first) = said.iter().flatten().next() {
            return Err(format!("the validation layer said: {first}").into());
        }
        compare(&rgb, &expected(&gaussians)?)?;
    }
    Ok(())
}

/// Draws some frames of a moving camera; returns the pixels of the last one.
fn draw(instance: &wgpu::Instance, gaussians: &Gaussians, debug_utils: bool) -> Result<Vec<u8>> {
    let host = Host::new(instance)?;
    let target = passes::texture(&host, "target", guest::FORMAT, guest::USAGES, SIZE);
    let passes = Passes::new(&host, &target);
    // SAFETY: variables are dropped in reverse order, the context before the host; there is one thread.
    let context = unsafe { host.context(debug_utils)? };
    // SAFETY: the guest is dropped before the target, which matches its constants.
    let mut guest = unsafe { Guest::new(&context, gaussians, &target, FRAMES_IN_FLIGHT)? };
    let mut in_flight = std::collections::VecDeque::new();
    for frame in 0..FRAMES {
        let slot = frame % FRAMES_IN_FLIGHT;
        if in_flight.len() == FRAMES_IN_FLIGHT as usize {
            finish(&host, &mut guest, slot, in_flight.pop_front())?;
        }
        // SAFETY: the slot's frame is finished; the buffer is submitted here, between the two that it needs.
        let splats = unsafe { guest.record(&host, slot, &camera(frame))? };
        in_flight.push_back(host.queue.submit([passes.before(&host), splats, passes.behind(&host)]));
    }
    let rest = FRAMES - in_flight.len() as u32..FRAMES;
    for (frame, submission) in rest.zip(in_flight) {
        finish(&host, &mut guest, frame % FRAMES_IN_FLIGHT, Some(submission))?;
    }
    passes.read(&host)
}

/// Waits for a slot's submission, as its fence.
fn finish(
    host: &Host,
    guest: &mut Guest,
    slot: u32,
    submission: Option<wgpu::SubmissionIndex>,
) -> Result<()> {
    host.device.poll(wgpu::PollType::Wait { submission_index: submission, timeout: None })?;
    guest.finish(slot)
}

/// The last frame by `Renderer::render`, on its own device, over the same backdrop.
fn expected(gaussians: &Gaussians) -> Result<Vec<[f32; 3]>> {
    let context = Context::new(&ContextOptions::default())?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload(gaussians)?;
    let settings = RenderSettings { background: [0.0; 3], ..RenderSettings::default() };
    let frame = renderer.render(&camera(FRAMES - 1), &settings)?;
    let over = |(i, (color, transmittance)): (usize, (&[f32; 3], &f32))| {
        let behind = passes::backdrop(i as u32 / frame.width, frame.height);
        [0, 1, 2].map(|c| color[c] + transmittance * behind[c])
    };
    Ok(frame.color.iter().zip(&frame.transmittance).enumerate().map(over).collect())
}

fn compare(drawn: &[u8], expected: &[[f32; 3]]) -> Result<()> {
    let rounded = expected.as_flattened().iter().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8);
    let differences = drawn.iter().zip(rounded).map(|(a, b)| a.abs_diff(b));
    let (largest, unlike) =
        differences.fold((0, 0), |(largest, unlike), d| (d.max(largest), unlike + usize::from(d > 0)));
    println!(
        "against Renderer::render: largest difference {largest} of 255, {unlike} of {} values differ",
        drawn.len()
    );
    let backdrop =
        (0..SIZE[1]).flat_map(|y| std::iter::repeat_n(passes::backdrop(y, SIZE[1]), SIZE[0] as usize));
    let splats = expected.iter().zip(backdrop).filter(|(a, b)| (a[0] - b[0]).abs() > 0.1).count();
    match () {
        () if drawn.len() != 3 * expected.len() => Err("the pictures have different sizes".into()),
        () if splats < expected.len() / 50 => Err("a picture without splats proves nothing".into()),
        () if largest > LARGEST_DIFFERENCE => Err("the picture differs from Renderer::render's".into()),
        () => Ok(()),
    }
}

/// A camera that circles the centre; y points down.
fn camera(frame: u32) -> Camera {
    let angle = 0.3 * frame as f32;
    let eye = Vec3::new(2.6 * angle.sin(), -0.7, -2.6 * angle.cos());
    let intrinsics = Intrinsics::from_fov_x(0.9, SIZE[0], SIZE[1]);
    Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, intrinsics)
}

/// A ball of Gaussians whose colours depend on the direction.
fn ball() -> Gaussians {
    let mut ball = Gaussians::default();
    for i in 0..3000 {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / 3000.0;
        let (turn, radius) = (i as f32 * 2.399_963, (1.0 - y * y).sqrt());
        let direction = [radius * turn.cos(), y, radius * turn.sin()];
        ball.means.push(direction.map(|x| 0.8 * x));
        ball.quats.push([1.0, 0.0, 0.0, 0.0]);
        ball.log_scales.push([-3.6; 3]);
        ball.opacity_logits.push(1.5);
        // Degree 0 holds the colour minus one half, divided by the constant harmonic.
        ball.sh.push(direction.map(|x| 0.45 * x / 0.282_094_8));
    }
    ball
}
