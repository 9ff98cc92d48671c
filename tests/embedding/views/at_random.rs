//! Random views, scenes and settings in frame after frame: one recording equals each view alone.

use super::{BLACK, SIZE, hard_cloud};
use crate::array_image::ArrayImage;
use crate::auxiliary::flight::{Flight, OutputRequest, Outputs};
use crate::auxiliary::parallel;
use crate::auxiliary::truth::shifted;
use crate::cut_outs::{HIDES, Kinds, Random, mapping};
use crate::stage::*;
use std::ops::Range;

/// Largest number of views of a recording.
const MAX_VIEWS: u32 = 3;
const SMALL: u32 = 20;

struct View<'a> {
    scenes: &'a [Placed<'a>],
    camera: &'a Camera,
    settings: &'a RenderSettings,
    before: &'a Camera,
    outputs: OutputRequest,
    /// Picks, motion.
    beside: [bool; 2],
}

/// The images of each view, twice: for views together, and for each alone.
struct Screens<'a> {
    array: ArrayImage<'a>,
    flights: Vec<Flight<'a>>,
    outputs: Vec<Outputs<'a>>,
}

impl<'a> Screens<'a> {
    fn new(host: &'a Host, context: &Context) -> Self {
        let array = ArrayImage::new(host, context, SIZE, 2 * MAX_VIEWS);
        let flights = (0..2 * MAX_VIEWS).map(|_| Flight::new(host, context, SIZE)).collect();
        let outputs = (0..2 * MAX_VIEWS).map(|_| Outputs::new(host, context, SIZE, HIDES.0)).collect();
        Self { array, flights, outputs }
    }

    fn render(
        &mut self,
        host: &Host,
        renderer: &mut Renderer,
        (views, group, bank): (&[View<'_>], Range<usize>, usize),
    ) {
        let frame = |number: usize| {
            let (view, place) = (&views[number], bank + number);
            let target = into(&self.array.layers[place], BLACK, [0; 2]);
            let frame =
                RecordedFrame { target, ..RecordedFrame::new(view.scenes, view.camera, view.settings) };
            let frame = self.outputs[place].with(frame, &view.outputs);
            self.flights[place].with(frame, view.before, view.beside)
        };
        let frames: Vec<RecordedFrame> = group.clone().map(frame).collect();
        let releases = render_views(host, renderer, &frames);
        group.zip(&releases).for_each(|(number, release)| self.outputs[bank + number].note(release));
    }

    fn shown(&self, colors: &[Vec<[f32; 4]>], view: &View<'_>, place: usize) -> [Vec<u32>; 4] {
        let [width, height] = [view.camera.width as usize, view.camera.height as usize];
        let cropped = |texels: &[u32]| -> Vec<u32> {
            let words = texels.len() / (SIZE[0] * SIZE[1]) as usize;
            let rows = texels.chunks((SIZE[0] as usize * words).max(1)).take(height);
            rows.flat_map(|row| row[..width * words].to_vec()).collect()
        };
        let (picks, motions) = self.flights[place].now(view.beside);
        // Two half floats per word.
        let motions: Vec<u32> = bytemuck::pod_collect_to_vec(&motions);
        let depths = if view.outputs.depth { self.outputs[place].depths() } else { Vec::new() };
        [
            cropped(bytemuck::cast_slice(&colors[place])),
            cropped(bytemuck::cast_slice(&picks)),
            cropped(&motions),
            cropped(&depths),
        ]
    }
}

/// Cameras side by side can share a sort if they draw the same list. Small scenes of one buffer are batched, a large
/// one never.
fn at_random(host: &Host, kinds: Kinds, frames: u32) {
    let context = guest(host);
    let small: Vec<Gaussians> = (0..SMALL).map(|seed| cloud(12, 20 + seed)).collect();
    let mut scenes = DeviceScene::upload_all(&context, &small.iter().collect::<Vec<_>>()).expect("scenes");
    scenes.push(uploaded(&context, &hard_cloud()));
    let mut screens = Screens::new(host, &context);
    let [mut together, mut alone] = [true, false].map(|shared_sort| {
        let wanted = Reservation {
            views: if shared_sort { MAX_VIEWS } else { 1 },
            shared_sort,
            images_only: true,
            scenes: SMALL + 1,
            cut_outs: if kinds.surfaces { SMALL + 1 } else { 0 },
            ..kinds.of(Reservation::new(SMALL * 256 + 900, 1, SIZE[0], SIZE[1]))
        };
        reserved(&context, &wanted)
    });
    let half = [CutOut {
        volume: Volume::Box { half_size: Vec3::new(0.4, 2.0, 2.0) },
        pose: Pose::IDENTITY,
        inside: Inside::Removed,
    }];
    let mask = mask_of(&context, &[0x5A; 128]);
    let selection = Selection { mask: &mask, color: [1.0, 0.5, 0.0], share: 0.5 };
    let mut random = Random(7);
    let mut below = |max: u32| random.below(max);
    let (mut sorts, mut batched, mut differing) = ([0; MAX_VIEWS as usize + 1], 0, 0);
    for frame in 0..frames {
        let lists: [Vec<Placed>; 2] = [(); 2].map(|()| {
            // A batch needs equal values of these.
            let [tinted, cut, plain] = [(); 3].map(|()| below(2) > 0);
            let [tinted, cut] = [tinted, cut].map(|is_so| is_so && kinds.surfaces);
            let mut placed = |scene| {
                let settings = SceneSettings {
                    visible: below(6) > 0,
                    tint: [[1.0; 3], [0.5, 1.0 + 0.1 * below(5) as f32, 1.0]][usize::from(tinted)],
                    opacity: [1.0, [1.0, 0.75, 0.5, 0.0][below(4) as usize]][usize::from(tinted)],
                    sh_degree: [None, Some(0)][usize::from(plain || below(9) == 0)],
                    cut_outs: if cut && below(9) > 0 { &half } else { &[] },
                    selection: (below(12) == 0 && kinds.tools).then_some(selection),
                };
                let pose = Pose {
                    world_from_object: Mat3::from_rotation_y(0.3 * below(20) as f32),
                    translation: Vec3::new(0.1 * below(9) as f32 - 0.4, 0.05 * below(9) as f32, 0.0),
                    scale: [1.0, 0.5, 1.25][below(3) as usize],
                };
                let before = Pose { translation: pose.translation + Vec3::splat(0.02), ..pose };
                let previous_pose = (below(3) == 0).then_some(before);
                Placed { settings, previous_pose, ..Placed::at(scene, pose) }
            };
            scenes.iter().map(&mut placed).collect()
        });
        // Every eighth frame has two views with one sort, one with motion, which chance would rarely give.
        let is_pair = frame % 8 == 5;
        let base = camera(0.2 * below(30) as f32, SIZE[0], SIZE[1]);
        let base = if below(4) == 0 && kinds.tools { parallel(&base) } else { base };
        let cameras: Vec<Camera> = (0..MAX_VIEWS)
            .map(|_| match below(4) {
                0 if !is_pair => camera(0.2 * below(30) as f32, 40, 30),
                _ => base.moved_aside([0.1 * below(9) as f32 - 0.4, 0.0]),
            })
            .collect();
        let settings = [None, Some(0)].map(|sh_degree| RenderSettings { sh_degree, ..Default::default() });
        let own = settings[below(2) as usize];
        let before: Vec<Camera> = cameras.iter().map(|now| shifted(now, [0.03, 0.0, 0.02])).collect();
        // Scenes with motion are not batched.
        let may_move = below(2) > 0 && kinds.tools;
        let views: Vec<View> = cameras
            .iter()
            .zip(&before)
            .enumerate()
            .map(|(number, (camera, before))| View {
                scenes: &lists[usize::from(below(3) == 0 && !is_pair)],
                camera,
                settings: &own,
                before,
                outputs: OutputRequest {
                    depth: below(3) == 0 && kinds.surfaces,
                    occluder: (below(3) == 0 && kinds.surfaces).then(|| mapping(camera)),
                    ..OutputRequest::default()
                },
                beside: [
                    below(3) == 0 && kinds.tools,
                    if is_pair { number == 0 && kinds.tools } else { may_move && below(2) > 0 },
                ],
            })
            .collect();
        // Each remaining view has its own recording, so that all layers are drawn. The other renderer draws each
        // alone.
        let first = if is_pair { 2 } else { 1 + below(MAX_VIEWS) as usize };
        let of_together = (first..views.len()).map(|view| view..view + 1).chain(std::iter::once(0..first));
        for group in of_together {
            screens.render(host, &mut together, (&views, group, 0));
        }
        let report = report_of(&mut together, 0);
        assert!(!report.overflow && report.sorts as usize <= first, "frame {frame}: {report:?}");
        sorts[first - report.sorts as usize] += 1;
        batched += report.batched_scenes;
        let moving = views[..first].iter().filter(|view| view.beside[1]).count();
        differing += u32::from(first == 2 && report.sorts == 1 && moving == 1);
        for view in 0..views.len() {
            screens.render(host, &mut alone, (&views, view..view + 1, MAX_VIEWS as usize));
        }
        let texels = screens.array.read();
        for (number, view) in views.iter().enumerate() {
            let [shown, expected] =
                [0, MAX_VIEWS as usize].map(|bank| screens.shown(&texels, view, bank + number));
            assert!(shown == expected, "frame {frame}, view {number}, {first} at once");
        }
    }
    assert!(sorts[0] > 0 && sorts[1] > 0 && batched > frames, "{sorts:?} sorts spared, {batched} in batches");
    assert!(differing > 0 || !kinds.tools, "no two views of one sort had motion in one of them");
    drop((together, alone));
}

#[test]
fn views_change_from_frame_to_frame() {
    with_host(&options(), |host| at_random(host, Kinds::TOOLS, 16));
}

#[test]
#[ignore = "16 of them, without occluders and depth, are enough for CI"]
fn views_change_a_thousand_times() {
    with_host(&options(), |host| at_random(host, Kinds::ALL, 1000));
}
