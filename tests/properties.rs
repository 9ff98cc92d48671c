//! Random scenes, cameras and modes: the device's picture and gradients equal the twin's.

use crate::common::engine::{settings, twins};
use crate::common::frame::unstable_pixels;
use crate::common::prelude::*;
use crate::gradients::{color_weights, narrowed};
use crate::reference::pipeline::{Frame, backward, render};
use proptest::prelude::*;

#[derive(Clone, Debug)]
struct Case {
    seed: u64,
    count: usize,
    view: View,
}

fn cases() -> impl Strategy<Value = Case> {
    let modes = (any::<bool>(), any::<bool>(), any::<bool>(), 0..=3_u32);
    let sight = (1..90_u32, 1..70_u32, -0.5..0.5_f64, 0.5..2.0_f64, 0.3..0.7_f64);
    (any::<u64>(), 0..200_usize, modes, sight).prop_map(|(seed, count, modes, sight)| {
        let (reference, antialias, symmetric_limit, sh_degree) = modes;
        let (width, height, angle, zoom, center) = sight;
        let single = |x: f64| f64::from(x as f32);
        let view = View {
            camera_from_world: rotation_about_y(angle),
            focal_px: [single(zoom * 60.0), single(zoom * 58.0)],
            center_px: [single(center * f64::from(width)), single((1.0 - center) * f64::from(height))],
            sh_degree,
            antialias,
            symmetric_limit,
            extent: if reference { Extent::Reference } else { Extent::Exact },
            ..small_view([width, height])
        };
        Case { seed, count, view }
    })
}

/// True for pixels at which a decision may depend on float32 rounding. The reference extent also rounds rectangles of tiles,
/// so pixels count for which a slightly moved picture blends another number of entries.
fn unstable(case: &Case, scene: &[Gaussian], frame: &Frame) -> Vec<bool> {
    let view = &case.view;
    let nudged: Vec<Frame> = [-1.0, 1.0]
        .iter()
        .flat_map(|by: &f64| [[*by, 0.0], [0.0, *by]])
        .map(|[x, y]| {
            let center_px = [view.center_px[0] + 2e-4 * x, view.center_px[1] + 2e-4 * y];
            render(scene, &View { center_px, ..view.clone() })
        })
        .collect();
    let mut unstable = unstable_pixels(view, frame, 1e-4);
    for (index, unstable) in unstable.iter_mut().enumerate() {
        *unstable |= nudged.iter().any(|other| other.pixels[index].blended != frame.pixels[index].blended);
    }
    unstable
}

fn check(case: &Case) -> Result<(), String> {
    let _gpu = Gpu::new();
    let view = &case.view;
    let mut random = Random::new(case.seed);
    let scene = mixed_scene(&mut random, case.count, 16);
    let frame = render(&scene, view);
    let unstable = unstable(case, &scene, &frame);
    let mut renderer = renderer();
    let fail = |e: ashsplat::Error| e.to_string();
    renderer.upload(&gaussians(&scene)).map_err(fail)?;
    let actual = renderer.render(&camera(view), &settings(view)).map_err(fail)?;
    let bound = PixelTolerance { max: 1e-4, mean: 2e-6, unstable: 0.1 };
    let color: Vec<f64> = frame.pixels.iter().flat_map(|p| p.color).collect();
    pixels("colour", &widen(&actual.color), &color, &unstable, bound)?;

    let weights = color_weights(&mut random, &unstable);
    let (target, _) = narrowed(&weights);
    let actual = renderer.gradients(&camera(view), &settings(view), &target, None).map_err(fail)?;
    drop(renderer);
    let expected = backward(&scene, view, &frame, &weights).parameters;
    let none = vec![false; scene.len()];
    for (name, actual, expected) in by_parameter(&twins(&actual.parameters), &expected) {
        let bound = match name {
            "opacities" | "log-scales" => 1e-3,
            "quaternions" => 5e-3,
            // Colours are not compared, because rounding decides about their clamp.
            _ => continue,
        };
        let tolerance = GradientTolerance { relative_l2: bound, max_over_max: bound };
        gradient(name, &actual, &expected, &none, tolerance)?;
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 40,
        failure_persistence: None,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    #[test]
    fn property_the_device_renders_what_the_twin_renders(case in cases()) {
        check(&case).map_err(|message| TestCaseError::fail(format!("{message}: {case:?}")))?;
    }
}
