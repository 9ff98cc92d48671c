//! Random features in frame after frame: scene settings, outputs, picks and motion.

use super::{filtered, pose, removing, volumes};
use crate::auxiliary::flight::{Flight, OutputPixels, OutputRequest, Outputs, PickAndMotion};
use crate::auxiliary::parallel;
use crate::auxiliary::truth::shifted;
use crate::scene_settings::{SIZE, Stage, placed};
use crate::stage::*;
use crate::updates::replace;
use ashsplat::kernels::constants::NOT_PICKED;

/// Numbers of scenes that are drawn alone, and of small ones in one buffer, which are batched.
const LARGE: usize = 3;
const SMALL: usize = 9;
/// Largest number of Gaussians of an update.
const MAX_GAUSSIANS: u32 = 12;
/// Value of the host's depth, and the z that it means.
pub const HIDES: (f32, f32) = (0.25, 4.0);

pub struct Random(pub u32);

impl Random {
    pub fn below(&mut self, max: u32) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 16) % max
    }
}

/// Features of the frames. A reservation with all has so many kernels that short runs test a part each.
#[derive(Clone, Copy)]
pub struct Kinds {
    /// The host's depth, expected depth, tints, and cut-outs if not all frames have them.
    pub surfaces: bool,
    /// Picks, motion, parallel rays, selections.
    pub tools: bool,
    /// Inverse depth, filters.
    pub others: bool,
}

impl Kinds {
    pub const SURFACES: Self = Self { surfaces: true, tools: false, others: false };
    pub const TOOLS: Self = Self { surfaces: false, tools: true, others: false };
    pub const ALL: Self = Self { surfaces: true, tools: true, others: true };

    pub fn of(self, wanted: Reservation) -> Reservation {
        Reservation {
            occlusion: self.surfaces,
            expected_depth: self.surfaces,
            tint: self.surfaces,
            pick: self.tools,
            motion: self.tools,
            orthographic: self.tools,
            selection: self.tools,
            inverse_depth: self.others,
            filter_3d: self.others,
            ..wanted
        }
    }
}

/// Mapping whose depth hides everything farther than the middle.
pub fn mapping(camera: &Camera) -> DepthMapping {
    let (value, z) = HIDES;
    let linear = camera.is_orthographic();
    let scale = if linear { z / value } else { 1.0 / (z * value) };
    DepthMapping { scale, offset: 0.0, clear_value: 1.0, linear }
}

struct Wants<'a> {
    outputs: OutputRequest,
    /// Picks, motion.
    beside: [bool; 2],
    before: &'a Camera,
}

#[derive(PartialEq)]
struct FrameResult {
    pixels: Vec<[f32; 4]>,
    outputs: OutputPixels,
    beside: PickAndMotion,
}

struct Shot<'a> {
    in_flight: Commands<'a>,
    staging: Staging<'a>,
    flight: Flight<'a>,
    outputs: Outputs<'a>,
    slot: u32,
}

type Awaited = (FrameResult, OutputRequest, [bool; 2]);

impl<'a> Shot<'a> {
    fn new(host: &'a Host, context: &Context, slot: u32) -> Self {
        let in_flight = Commands::new(host);
        let staging = Staging::new(host, 16 * u64::from(SIZE[0] * SIZE[1]));
        let flight = Flight::new(host, context, SIZE);
        Self { in_flight, staging, flight, outputs: Outputs::new(host, context, SIZE, HIDES.0), slot }
    }

    fn record(&mut self, renderer: &mut Renderer, frame: RecordedFrame<'_>, wants: &Wants<'_>) {
        let Self { in_flight, flight, outputs, slot, .. } = self;
        let commands = in_flight.begun(renderer.context());
        outputs.record_clear(in_flight, &wants.outputs);
        let drawn = outputs.with(frame, &wants.outputs);
        let drawn = flight.with(drawn, wants.before, wants.beside);
        let release = renderer.record(commands, *slot, &drawn).expect("a recording");
        flight.record_read(in_flight, wants.beside);
        outputs.record_read(in_flight, &wants.outputs, &release);
        if wants.outputs.target.is_none() {
            copy_pixels(renderer, *slot, in_flight, &self.staging);
        }
    }

    fn finish(&self, outputs: &OutputRequest, beside: [bool; 2]) -> FrameResult {
        self.in_flight.wait();
        let pixels = if outputs.target.is_none() { self.staging.read() } else { Vec::new() };
        FrameResult { pixels, outputs: self.outputs.read(outputs), beside: self.flight.read(beside) }
    }
}

/// Index in the scene of each remaining Gaussian.
fn places(part: &Gaussians, left: &Gaussians) -> Vec<u32> {
    let mut all = (0..).zip(&part.means);
    left.means.iter().map(|mean| all.find(|(_, own)| *own == mean).expect("of the scene").0).collect()
}

/// Random cut-outs of each scene. Either all small scenes have some, or none.
fn cut_outs(random: &mut Random) -> Vec<Vec<CutOut>> {
    let are_cut = random.below(2) > 0;
    let mut set = |scene: usize| {
        let count = if scene < LARGE { random.below(4) } else { u32::from(are_cut) };
        let mut one = |_| {
            let cut_out = volumes()[random.below(3) as usize];
            if random.below(2) == 0 { cut_out } else { removing(cut_out) }
        };
        (0..count).map(&mut one).collect()
    };
    (0..LARGE + SMALL).map(&mut set).collect()
}

fn scene_settings<'a>(
    random: &mut Random,
    sets: &'a [Vec<CutOut>],
    (selection, kinds): (Selection<'a>, Kinds),
) -> Vec<SceneSettings<'a>> {
    let are_tinted = random.below(2) as usize;
    let settings = |(scene, cut_outs): (usize, &'a Vec<CutOut>)| {
        let mut of_three = |is_large: bool| if is_large { random.below(3) } else { 0 };
        let is_large = scene < LARGE;
        let (opacity, degree) = (of_three(is_large), of_three(is_large));
        let tinted = if is_large { random.below(2) as usize } else { are_tinted };
        SceneSettings {
            visible: random.below(4) > 0 || !is_large,
            tint: [[1.0; 3], [0.5, 1.5, 1.0]][if kinds.surfaces { tinted } else { 0 }],
            opacity: [1.0, 0.5, 0.0][if kinds.surfaces { opacity as usize } else { 0 }],
            sh_degree: [None, Some(0), Some(3)][degree as usize],
            cut_outs,
            selection: (random.below(2) > 0 && is_large && kinds.tools).then_some(selection),
        }
    };
    sets.iter().enumerate().map(settings).collect()
}

fn outputs(random: &mut Random, camera: &Camera, kinds: Kinds) -> OutputRequest {
    let behind = [Background::Nothing, Background::Color([0.5, 0.25, 0.75]), Background::Image];
    let encodings = [
        ColorEncoding::AsTrained,
        ColorEncoding::LINEAR,
        ColorEncoding::LinearSrgb { exposure: 0.5 + random.below(4) as f32 },
    ];
    let image = (behind[random.below(3) as usize], encodings[random.below(3) as usize]);
    OutputRequest {
        target: (random.below(2) > 0).then_some(image),
        depth: random.below(3) == 0 && kinds.surfaces,
        occluder: (random.below(3) == 0 && kinds.surfaces).then(|| mapping(camera)),
    }
}

fn render_settings(random: &mut Random, kinds: Kinds) -> RenderSettings {
    RenderSettings {
        antialias: random.below(3) == 0,
        inverse_depth: random.below(4) == 0 && kinds.others,
        filter_3d: random.below(4) == 0 && kinds.others,
        sh_degree: (random.below(4) == 0).then_some(0),
        // Frames ignore it.
        background: [f32::NAN; 3],
        ..RenderSettings::default()
    }
}

/// A frame with cut-outs is bit-identical to one of scenes that the host has filtered. Two slots with the same memory
/// alternate: the second is submitted while the first is in flight.
fn at_random(host: &Host, kinds: Kinds, frames: u32) {
    assert!(frames.is_multiple_of(2));
    let mut parts = vec![cloud(200, 1), cloud(150, 2), cloud(120, 3)];
    parts.extend((0..SMALL as u32).map(|seed| cloud(16, 10 + seed)));
    let all: Vec<&Gaussians> = parts.iter().collect();
    let staging_bytes = Reservation::update_bytes(MAX_GAUSSIANS, 1);
    let wanted = |wanted| Reservation { slots: 2, cut_outs: 40, staging_bytes, ..kinds.of(wanted) };
    let mut stage = Stage::new(host, &all, &wanted);
    let context = stage.renderer.context().clone();
    stage.scenes.truncate(LARGE);
    stage.scenes.extend(DeviceScene::upload_all(&context, &all[LARGE..]).expect("scenes"));
    let mut plain = Stage::of(host, &context, &all, &wanted);
    let mut shots = [0, 1].map(|slot| Shot::new(host, &context, slot));
    let mut apart = Shot::new(host, &context, 0);
    // Selects all remaining Gaussians.
    let bits = mask_of(&context, &[0xFF; 28]);
    let selection = Selection { mask: &bits, color: [1.0, 0.5, 0.0], share: 0.5 };
    let mut random = Random(1);
    // Expected outputs of a slot's frame.
    let mut awaited = [const { None::<Awaited> }; 2];
    let mut batched = 0;
    let mut finish = |shot: &Shot<'_>, frame: u32, awaited: &mut Option<Awaited>, renderer: &mut Renderer| {
        let Some((expected, outputs, beside)) = awaited.take() else { return };
        let shown = shot.finish(&outputs, beside);
        assert!(shown.pixels == expected.pixels, "frame {frame}");
        assert!(shown.outputs == expected.outputs, "images of frame {frame}");
        assert!(shown.beside == expected.beside, "beside frame {frame}");
        let report = report_of(renderer, shot.slot);
        assert!(!report.overflow, "frame {frame}: {report:?}");
        batched += report.batched_scenes;
    };
    for frame in 0..frames {
        // Both are submitted without a wait in between.
        let slot = (frame % 2) as usize;
        finish(&shots[slot], frame.wrapping_sub(2), &mut awaited[slot], &mut stage.renderer);
        let changed = random.below(parts.len() as u32) as usize;
        let new = cloud(random.below(MAX_GAUSSIANS + 1) as usize, 100 + frame);
        let first = random.below((parts[changed].len() - new.len()) as u32 + 1);
        let is_updated = random.below(3) == 0;
        if is_updated {
            replace(&mut parts[changed], first as usize, &new);
        }
        let sets = cut_outs(&mut random);
        let settings = scene_settings(&mut random, &sets, (selection, kinds));
        let camera = if random.below(3) == 0 && kinds.tools { parallel(&stage.camera) } else { stage.camera };
        let before = shifted(&camera, [random.below(9) as f32 * 0.01, 0.0, 0.02]);
        let before = if random.below(4) == 0 && kinds.tools { parallel(&before) } else { before };
        let own = render_settings(&mut random, kinds);
        let wants = Wants {
            outputs: outputs(&mut random, &camera, kinds),
            beside: [(); 2].map(|()| random.below(3) == 0 && kinds.tools),
            before: &before,
        };
        let earlier: Vec<Pose> =
            parts.iter().map(|_| pose(0.01 * random.below(9) as f32, Vec3::ZERO, 1.0)).collect();
        let left: Vec<_> = parts.iter().zip(&sets).map(|(part, set)| filtered(part, set)).collect();
        let upload = |part: &Gaussians| uploaded(&context, part);
        plain.scenes = left.iter().map(upload).collect();
        let without: Vec<_> = settings.iter().map(|own| SceneSettings { cut_outs: &[], ..*own }).collect();
        let of_left = come_from(placed(&plain.scenes, &[], &without), &earlier);
        apart.record(&mut plain.renderer, RecordedFrame::new(&of_left, &camera, &own), &wants);
        apart.in_flight.submit();
        let mut expected = apart.finish(&wants.outputs, wants.beside);
        let places: Vec<_> = parts.iter().zip(&left).map(|(part, left)| places(part, left)).collect();
        for [gaussian, scene, ..] in expected.beside.0.iter_mut().filter(|pick| pick[1] != NOT_PICKED) {
            *gaussian = places[*scene as usize][*gaussian as usize];
        }

        let all = come_from(placed(&stage.scenes, &[], &settings), &earlier);
        let updates = [Update { scene: &stage.scenes[changed], first, gaussians: &new }];
        let drawn = RecordedFrame {
            updates: if is_updated { &updates } else { &[] },
            ..RecordedFrame::new(&all, &camera, &own)
        };
        shots[slot].record(&mut stage.renderer, drawn, &wants);
        awaited[slot] = Some((expected, wants.outputs, wants.beside));
        if slot == 1 {
            shots.iter().for_each(|shot| shot.in_flight.submit());
        }
    }
    for slot in 0..2 {
        finish(&shots[slot], frames - 2 + slot as u32, &mut awaited[slot], &mut stage.renderer);
    }
    assert!(batched > frames, "{batched} scenes in batches");
    drop((stage, plain));
}

fn come_from<'a>(mut placed: Vec<Placed<'a>>, earlier: &[Pose]) -> Vec<Placed<'a>> {
    for (placed, pose) in placed.iter_mut().zip(earlier) {
        placed.previous_pose = Some(*pose);
    }
    placed
}

#[test]
fn settings_of_scenes_change_from_frame_to_frame() {
    with_host(&options(), |host| {
        for kinds in [Kinds::SURFACES, Kinds::TOOLS] {
            at_random(host, kinds, 30);
        }
    });
}

#[test]
#[ignore = "60 of them are enough for CI"]
fn settings_of_scenes_change_a_thousand_times() {
    with_host(&options(), |host| at_random(host, Kinds::ALL, 1000));
}
