//! Costs of frames for the host: heap allocations of `record`.

use crate::auxiliary::flight::{OutputRequest, Outputs};
use crate::auxiliary::truth::Screens;
use crate::counting::allocations;
use crate::cut_outs::HIDES;
use crate::stage::*;

pub fn shipped(host: &Host, timestamps: bool) -> Context {
    let options = ContextOptions { timestamps, hazard_check: false, ..ContextOptions::default() };
    // SAFETY: as in `guest`.
    unsafe { Context::from_foreign(&host.foreign(), &options) }.expect("a context")
}

/// The most heap allocations of one call of `record`, of 100 scenes in one buffer or in buffers of their own, after the first
/// frames.
pub fn record_allocations(host: &Host, together: bool) -> u64 {
    const SCENES: u32 = 100;
    let context = shipped(host, false);
    let gaussians = cloud(8, 1);
    let scenes: Vec<_> = match together {
        true => DeviceScene::upload_all(&context, &[&gaussians; SCENES as usize]).expect("scenes"),
        false => (0..SCENES).map(|_| uploaded(&context, &gaussians)).collect(),
    };
    let placed: Vec<Placed> = scenes.iter().map(Placed::from).collect();
    let wanted = Reservation { slots: 2, scenes: SCENES, ..Reservation::new(8 * SCENES, 1, 64, 48) };
    let mut renderer = reserved(&context, &wanted);
    let in_flight = [0; 2].map(|_| Commands::new(host));
    let (view, mut max_asked) = (camera(0.3, 64, 48), 0);
    for number in 0..7 {
        let (slot, frame) = (number % 2, &in_flight[number % 2]);
        let commands = frame.begun(&context);
        let recorded = frame_of(&placed, &view);
        let (asked, done) = allocations(|| renderer.record(commands, slot as u32, &recorded));
        done.expect("a recording");
        frame.finish();
        max_asked = if number < 4 { 0 } else { max_asked.max(asked) };
    }
    drop(renderer);
    max_asked
}

fn steady_allocations(host_options: &HostOptions, timestamps: bool) {
    with_host(host_options, |host| {
        let context = shipped(host, timestamps);
        let (gaussians, few, view) = (cloud(600, 1), cloud(50, 2), camera(0.3, 96, 64));
        let scenes = [&gaussians, &few, &few].map(|g| uploaded(&context, g));
        let reservation = Reservation {
            slots: 2,
            scenes: 4,
            occlusion: true,
            tint: true,
            cut_outs: 2,
            selection: true,
            pick: true,
            motion: true,
            staging_bytes: Reservation::update_bytes(600, 1),
            ..Reservation::new(700, 1, 96, 64)
        };
        let mut renderer = reserved(&context, &reservation);
        let volume = Volume::Ellipsoid { radii: Vec3::ONE };
        let cut_outs = [CutOut { volume, pose: Pose::IDENTITY, inside: Inside::Kept }; 2];
        let bits = mask_of(&context, &[0x55; 8]);
        let selection = Some(Selection { mask: &bits, color: [1.0, 0.5, 0.0], share: 0.5 });
        let (mut images, wanted) =
            (Outputs::new(host, &context, [96, 64], HIDES.0), OutputRequest::hidden(&view));
        let screens = Screens::new(host, &context, [96, 64]);
        let in_flight = Commands::new(host);
        let updates = [Update { scene: &scenes[0], first: 0, gaussians: &gaussians }];
        let mut asked = Vec::new();
        for number in 0..8 {
            let slot = number % 2;
            let commands = in_flight.begun(&context);
            let tinted = SceneSettings { tint: [1.0, 0.5, 0.5], opacity: 0.5, ..SceneSettings::default() };
            let placed = [
                Placed::from(&scenes[0]),
                Placed { settings: SceneSettings { cut_outs: &cut_outs, ..tinted }, ..(&scenes[1]).into() },
                Placed { settings: SceneSettings { visible: false, ..tinted }, ..(&scenes[0]).into() },
                Placed { settings: SceneSettings { selection, ..tinted }, ..(&scenes[2]).into() },
            ];
            let (pick, motion) = (Some(screens.pick()), Some(screens.motion(&view)));
            let frame = RecordedFrame { pick, motion, updates: &updates, ..frame_of(&placed, &view) };
            let frame = images.with(frame, &wanted);
            let (count, recorded) = allocations(|| renderer.record(commands, slot, &frame));
            images.note(&recorded.expect("a recording"));
            in_flight.finish();
            let report = report_of(&mut renderer, slot);
            assert!(report.visible > 100 && !report.overflow, "{report:?}");
            renderer.release_slot(slot).expect("over");
            asked.push(count);
        }
        assert!(asked[0] > 0, "the allocator counts");
        assert_eq!(asked[2..], [0; 6], "heap allocations of {asked:?}");
        drop(renderer);
    });
}

#[test]
fn record_takes_nothing_from_the_heap() {
    // Validation enables VK_EXT_debug_utils and hence labels.
    for (host_options, push_descriptors, timestamps) in [
        (options(), true, true),
        (HostOptions::default(), true, false),
        (HostOptions::default(), false, true),
    ] {
        steady_allocations(&HostOptions { push_descriptors, ..host_options }, timestamps);
    }
}
