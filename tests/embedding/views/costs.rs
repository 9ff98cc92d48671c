//! Costs of two eyes in two recordings, in one, and with one sort.

use super::record_groups;
use crate::array_image::ArrayImage;
use crate::cost::shipped;
use crate::stage::*;
use std::time::Instant;

const CASES: [&str; 3] = ["two recordings", "one", "one, shared sort"];
const FIGURES: [&str; 7] =
    ["device, ms", "cull", "project", "depth sort", "the rest", "CPU, ms", "record, us"];

/// CPU time of this process so far, ms, in steps of ten.
fn cpu_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = stat.rsplit(')').next().unwrap_or_default().split_whitespace().skip(11).take(2);
    ticks.filter_map(|word| word.parse::<f64>().ok()).sum::<f64>() * 10.0
}

fn shot(in_flight: &Commands<'_>, renderer: &mut Renderer, groups: &[&[RecordedFrame]]) -> [f64; 7] {
    let cpu = cpu_ms();
    in_flight.begin();
    let recording = Instant::now();
    record_groups(in_flight, renderer, groups);
    let recorded = recording.elapsed().as_secs_f64() * 1e6;
    in_flight.finish();
    let mut scopes = Vec::new();
    for slot in 0..groups.len() as u32 {
        scopes.extend(report_of(renderer, slot).scopes);
    }
    let sum = |name: &str| -> f64 {
        let own = scopes.iter().filter(|scope| scope.depth == 0 && (name.is_empty() || scope.name == name));
        own.map(|scope| scope.nanoseconds / 1e6).sum()
    };
    let [all, cull, project, sort] = ["", "cull", "project", "depth sort"].map(sum);
    [all, cull, project, sort, all - cull - project - sort, cpu_ms() - cpu, recorded]
}

#[test]
#[ignore = "prints a table of the guide"]
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
        let mut renderers = [false, true].map(|shared_sort| {
            let mut renderer = Renderer::new(&context).expect("kernels");
            let reserved = Reservation { shared_sort, ..wanted };
            let bytes = renderer.reservation_bytes(&reserved).expect("bytes");
            println!("shared sort {shared_sort}: {:.2} MiB", bytes as f64 / 1024.0 / 1024.0);
            renderer.reserve(&reserved).expect("memory");
            renderer
        });
        let in_flight = Commands::new(host);
        let mut shots = [const { Vec::new() }; CASES.len()];
        for round in 0..32 {
            for (case, shots) in shots.iter_mut().enumerate() {
                let renderer = &mut renderers[usize::from(case == 2)];
                let (alone, both) = ([&views[..1], &views[1..]], [&views[..]]);
                let groups = if case == 0 { &alone[..] } else { &both[..] };
                let figures = shot(&in_flight, renderer, groups);
                if round > 1 {
                    shots.push(figures);
                }
            }
        }
        println!("mean, least, and median of the ratios of pairs to two recordings");
        println!("recorded as | {}", FIGURES.join(" | "));
        for (name, own) in CASES.iter().zip(&shots) {
            print!("{name}");
            for figure in 0..FIGURES.len() {
                let mean = own.iter().map(|shot| shot[figure]).sum::<f64>() / own.len() as f64;
                let least = own.iter().map(|shot| shot[figure]).fold(f64::INFINITY, f64::min);
                let pairs = own.iter().zip(&shots[0]);
                let mut ratios: Vec<f64> =
                    pairs.map(|(own, other)| own[figure] / other[figure].max(1e-9)).collect();
                ratios.sort_by(f64::total_cmp);
                print!(" | {mean:.1}, {least:.1}, {:.2}", ratios[ratios.len() / 2]);
            }
            println!();
        }
    });
}
