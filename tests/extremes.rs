//! Parameters that no training should produce: no hang, no write out of bounds, no spreading NaN.

use crate::common::prelude::*;
use ashsplat::train::Densified;
use ashsplat_files::splats;
use ashsplat_files::splats::{Format, ReadOptions, WriteOptions};
use proptest::prelude::*;
use std::sync::OnceLock;

const EXTREMES: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    1e30,
    -1e30,
    1e-30,
    f32::MAX,
    f32::MIN_POSITIVE,
    1e-45,
    0.0,
    88.0,
    -100.0,
];

#[track_caller]
fn assert_unbreached(context: &Context) {
    assert_eq!(context.breached_guards().expect("read"), Vec::<&str>::new());
}

/// A separate device with guard bands around every buffer.
fn guarded() -> &'static Context {
    static CONTEXT: OnceLock<Context> = OnceLock::new();
    // `options` is called each time, because it makes the calling test the only one with such a device.
    let options = ContextOptions { guard_bands: true, ..options() };
    CONTEXT.get_or_init(|| Context::new(&options).expect("a device with guards"))
}

/// The first `sound` Gaussians of [`start`] unchanged, the others with some extreme parameters; some at one
/// position.
fn spoilt(seed: u64, sound: usize) -> Gaussians {
    let mut scene = start();
    let mut random = Random::new(seed);
    for i in sound..scene.len() {
        // Either one parameter or all of them.
        let often = [60, 3, 1][random.below(3) as usize];
        let mut spoil = |value: &mut f32| {
            if random.below(often) == 0 {
                *value = EXTREMES[random.below(EXTREMES.len() as u32) as usize];
            }
        };
        scene.means[i].iter_mut().for_each(&mut spoil);
        scene.quats[i].iter_mut().for_each(&mut spoil);
        scene.log_scales[i].iter_mut().for_each(&mut spoil);
        spoil(&mut scene.opacity_logits[i]);
        scene.sh[i * 9..(i + 1) * 9].iter_mut().flatten().for_each(&mut spoil);
        match random.below(4) {
            0 => scene.quats[i] = [0.0; 4],
            1 => scene.means[i] = scene.means[0],
            _ => {}
        }
    }
    scene
}

fn is_finite(scene: &Gaussians, i: usize) -> bool {
    let sh = scene.sh_of(i).iter().flatten();
    let geometry = scene.means[i].iter().chain(&scene.quats[i]).chain(&scene.log_scales[i]);
    geometry.chain([&scene.opacity_logits[i]]).chain(sh).all(|x| x.is_finite())
}

/// Renders, trains and (above a gradient) densifies spoilt Gaussians. Returns the densification's counts.
fn check(seed: u64, sound: usize, gradient: f64) -> Densified {
    let context = guarded();
    let scene = spoilt(seed, sound);
    let mut renderer = loaded(context, &scene);
    let settings = RenderSettings { inverse_depth: true, ..RenderSettings::default() };
    for antialias in [false, true] {
        let settings = RenderSettings { antialias, ..settings };
        let frame = renderer.render(&camera(&small_view([70, 50])), &settings).expect("a frame");
        let bad = frame.color.iter().flatten().chain(&frame.transmittance).filter(|x| !x.is_finite()).count();
        assert_eq!(bad, 0, "seed {seed}: not finite in the picture");
    }
    assert_unbreached(context);
    let settings = TrainSettings {
        sh_degree: 2,
        sh_degree_interval: 1,
        densify_from_iter: 1,
        densification_interval: 3,
        densify_grad_threshold: gradient,
        min_opacity: 0.0,
        ..TrainSettings::reference()
    };
    let mut trainer = Run::new(context, views(2, 50), settings).starting_at(&scene).begin();
    trainer.steps(2);
    assert_unbreached(context);
    let after = trainer.trained();
    for i in 0..after.len() {
        assert!(!is_finite(&scene, i) || is_finite(&after, i), "seed {seed}: Gaussian {i} was sound");
    }
    // Also in densification: a Gaussian that is not finite has a spoilt ancestor, each with at most two descendants.
    let unsound = |scene: &Gaussians| (0..scene.len()).filter(|&i| !is_finite(scene, i)).count();
    let reports = trainer.steps(3);
    assert_unbreached(context);
    let densified = reports.iter().find_map(|r| r.densified).expect("one is due after three iterations");
    let after = trainer.trained();
    let spoilt = scene.len() - sound;
    assert!(unsound(&after) <= 2 * spoilt, "seed {seed}: {} of {spoilt}", unsound(&after));
    assert!(after.len() >= sound, "seed {seed}: {} sound ones are {}", sound, after.len());
    assert_silent(context);
    densified
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn extremes_neither_hang_nor_spread(seed in any::<u64>(), sound in 0..150_usize, grows in any::<bool>()) {
        check(seed, sound, if grows { 1e-7 } else { 1.0 });
    }
}

/// A few spoilt Gaussians among many, all of which are cloned or split.
#[test]
fn extremes_do_not_spread_by_densification() {
    for seed in 0..3 {
        let densified = check(seed, 140, 0.0);
        assert!(densified.cloned + densified.split >= 140, "{densified:?}");
    }
}

/// More (tile, Gaussian) instances than 32 bits count: their prefix sums wrap around, and an error names the
/// problem. If a device does not check bounds, the guards detect writes outside.
#[test]
fn extremes_of_more_instances_than_32_bits_are_refused() {
    let context = guarded();
    // Every other Gaussian meets all of 128 x 128 tiles, those in between few. The sums wrap around at 524,288,
    // shortly before 524,400, where a search by quarters and eighths meets small sums again.
    let count = 699_200;
    let is_large = |i: usize| !i.is_multiple_of(2);
    let scene = Gaussians {
        sh_degree: 0,
        means: vec![[0.0; 3]; count],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: (0..count).map(|i| [if is_large(i) { 6.0 } else { -6.0 }; 3]).collect(),
        opacity_logits: vec![2.0; count],
        sh: vec![[0.5; 3]; count],
    };
    let camera = camera(&small_view([2048, 2048]));
    let refused = loaded(context, &scene).render(&camera, &RenderSettings::default());
    assert_says(refusal(refused), &["instances"]);
    assert_unbreached(context);
    assert_silent(context);
}

type Replace = fn(&mut Gaussians, usize, f32);

const PARAMETERS: [(&str, Replace); 6] = [
    ("mean", |scene, i, value| scene.means[i][i % 3] = value),
    ("quaternion", |scene, i, value| scene.quats[i][i % 4] = value),
    ("log-scale", |scene, i, value| scene.log_scales[i][i % 3] = value),
    ("opacity", |scene, i, value| scene.opacity_logits[i] = value),
    ("colour", |scene, i, value| {
        let coefficients = scene.sh.len() / scene.len();
        scene.sh[i * coefficients][i % 3] = value;
    }),
    ("harmonics", |scene, i, value| {
        let coefficients = scene.sh.len() / scene.len();
        scene.sh[(i + 1) * coefficients - 1][i % 3] = value;
    }),
];

/// Huge finite values in a file of any format: one error names them, or the picture is finite.
#[test]
fn extremes_in_files_are_refused_or_give_finite_pictures() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut renderer = Renderer::new(guarded()).expect("a renderer");
    let sound = start();
    // A log-scale of 69 is a scale of 1e30 in formats without logarithms.
    let huge = [1e30, -1e30, f32::MAX, f32::MIN, 1e17, 69.0];
    let (mut refused, mut brightest) = (Vec::new(), 0.0_f32);
    for (format, (name, replace)) in Format::WRITTEN.iter().flat_map(|f| PARAMETERS.map(|p| (f, p))) {
        for value in huge {
            let mut scene = sound.with_sh_degree(sound.sh_degree.min(format.max_sh_degree()));
            (0..scene.len()).step_by(3).for_each(|i| replace(&mut scene, i, value));
            let place = format!("{name} {value:e} in {format}");
            let path = folder.path().join(format!("scene{}", format.extension()));
            let written = splats::write(&path, &scene, &WriteOptions::default());
            let read = written.and_then(|_| splats::read(&path, &ReadOptions::default()));
            let scene = match read {
                Ok(read) => read.gaussians,
                Err(error) => {
                    let message = error.to_string();
                    let named = message.starts_with(path.to_str().expect("UTF-8"));
                    assert!(named && !message.contains('\n'), "{place}: {message}");
                    refused.push((*format, name, value));
                    continue;
                }
            };
            renderer.upload(&scene).expect("upload");
            for antialias in [false, true] {
                let settings = RenderSettings { antialias, inverse_depth: true, ..RenderSettings::default() };
                let frame = renderer.render(&camera(&small_view([70, 50])), &settings).expect("a frame");
                let depths = frame.inverse_depth.iter().flatten();
                let values = frame.color.iter().flatten().chain(&frame.transmittance).chain(depths);
                assert!(values.copied().all(f32::is_finite), "{place}: not finite");
                brightest = frame.color.iter().flatten().copied().fold(brightest, f32::max);
            }
        }
    }
    let refuses = |case: (Format, &str, f32)| refused.contains(&case);
    for format in [Format::Ply, Format::Splat, Format::Glb] {
        assert!(refuses((format, "mean", 1e30)) && !refuses((format, "mean", 1e17)), "{format}");
    }
    for name in ["log-scale", "colour", "harmonics"] {
        assert!(refuses((Format::Ply, name, f32::MAX)), "{name}");
        assert_eq!(refuses((Format::Ply, name, 1e30)), name == "log-scale");
    }
    assert!(refuses((Format::Ply, "quaternion", 1e30)) && !refuses((Format::Ply, "log-scale", 69.0)));
    // Accepted Gaussians are drawn.
    assert!(brightest > 1e25, "{brightest:e}");
    assert_unbreached(guarded());
}

/// Values beyond a format's range become its largest value, and do not wrap around.
#[test]
fn extremes_of_harmonics_are_packed_to_the_nearest() {
    let folder = tempfile::tempdir().expect("a folder");
    for format in [Format::Spz, Format::CompressedPly] {
        for (value, sign) in [(1e30, 1.0), (-1e30, -1.0), (5.0, 1.0)] {
            let mut scene = start();
            scene.sh.chunks_mut(9).flat_map(|sh| &mut sh[1..]).for_each(|c| *c = [value; 3]);
            let path = folder.path().join(format!("scene{}", format.extension()));
            splats::write(&path, &scene, &WriteOptions::default()).expect("written");
            let read = splats::read(&path, &ReadOptions::default()).expect("read").gaussians;
            let worst = read.sh.chunks(9).flat_map(|sh| &sh[1..]).flatten().map(|c| c * sign);
            let worst = worst.fold(f32::INFINITY, f32::min);
            assert!(worst > 0.9, "{value:e} in {format}: {worst}");
        }
    }
}
