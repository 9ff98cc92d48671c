//! Costs of two eyes with one sort, against two recordings.

use super::record_groups;
use crate::array_image::ArrayImage;
use crate::cost::{ratio, shipped};
use crate::stage::*;

/// CPU time of this process so far, ms, in steps of ten.
fn cpu_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = stat.rsplit(')').next().unwrap_or_default().split_whitespace().skip(11).take(2);
    ticks.filter_map(|word| word.parse::<f64>().ok()).sum::<f64>() * 10.0
}

/// Milliseconds of the depth sorts and of all processors, for groups of views, each group in one recording.
fn shot(in_flight: &Commands<'_>, renderer: &mut Renderer, groups: &[&[RecordedFrame]]) -> [f64; 2] {
    let cpu = cpu_ms();
    in_flight.begin();
    record_groups(in_flight, renderer, groups);
    in_flight.finish();
    let scopes = (0..groups.len() as u32).flat_map(|slot| report_of(renderer, slot).scopes);
    let sorts = scopes.filter(|scope| scope.depth == 0 && scope.name == "depth sort");
    [sorts.map(|scope| scope.nanoseconds / 1e6).sum(), cpu_ms() - cpu]
}

#[test]
#[ignore = "prints numbers of the guide"]
fn costs() {
    const GAUSSIANS: usize = 200_000;
    const SIZE: [u32; 2] = [640, 480];
    with_host(&HostOptions::default(), |host| {
        let context = shipped(host, true);
        let scene = uploaded(&context, &cloud(GAUSSIANS, 1));
        let placed = [Placed::from(&scene)];
        let left = camera(0.7, SIZE[0], SIZE[1]);
        let cameras = [left, left.moved_aside([0.064, 0.0])];
        let array = ArrayImage::new(host, &context, SIZE, 2);
        let views = array.frames(&placed, &cameras);
        let wanted = Reservation::new(GAUSSIANS as u32, 1, SIZE[0], SIZE[1]);
        let wanted = Reservation { slots: 2, views: 2, images_only: true, ..wanted };
        let mut renderers =
            [false, true].map(|shared_sort| reserved(&context, &Reservation { shared_sort, ..wanted }));
        let in_flight = Commands::new(host);
        let recordings = [&[&views[..1], &views[1..]][..], &[&views[..]]];
        // The figures of two recordings, and of one with one sort.
        let mut shots = [0; 2].map(|_| [0; 2].map(|_| Vec::new()));
        for round in 0..32 {
            for ((renderer, groups), shots) in renderers.iter_mut().zip(recordings).zip(&mut shots) {
                let figures = shot(&in_flight, renderer, groups);
                if round > 1 {
                    shots.iter_mut().zip(figures).for_each(|(all, figure)| all.push(figure));
                }
            }
        }
        let [two, one] = shots;
        for (name, (one, two)) in ["depth sort", "processor time"].into_iter().zip(one.iter().zip(&two)) {
            println!("{name}: {:.2} of that of two recordings", ratio(one, two));
        }
    });
}
