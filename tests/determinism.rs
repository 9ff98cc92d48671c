//! The same inputs on the same device give the same bits, also in training.

use crate::common::engine::settings;
use crate::common::prelude::*;
use crate::common::training;
use ashsplat::scene::Fingerprint;
use ashsplat::train::verify::{Verdict, verify_determinism};

fn views() -> Vec<TrainView> {
    let scene = gaussians(&small_scene(&mut Random::new(11), 120, 4));
    let mut renderer = renderer();
    renderer.upload(&scene).expect("upload");
    (0..6)
        .map(|i| {
            let view = View { camera_from_world: rotation_about_y(f64::from(i)), ..small_view([70, 50]) };
            let frame = renderer.render(&camera(&view), &settings(&view)).expect("a photograph");
            let photo = Photo::from_f32(70, 50, &frame.color).expect("a photograph");
            TrainView::new(camera(&view), photo)
        })
        .collect()
}

fn train(gpu: &Gpu, seed: u32) -> (Vec<f32>, Gaussians) {
    let settings = TrainSettings {
        iterations: 70,
        sh_degree: 2,
        sh_degree_interval: 20,
        densify_from_iter: 15,
        densification_interval: 15,
        densify_until_iter: 60,
        opacity_reset_interval: 40,
        densify_grad_threshold: 5e-5,
        seed,
        ..TrainSettings::reference()
    };
    let start = gaussians(&small_scene(&mut Random::new(12), 200, 9));
    let mut trainer = Run { start, ..Run::new(gpu.context, views(), settings) }.begin();
    let reports = trainer.finish();
    assert!(reports.iter().all(|report| report.skipped_non_finite == 0));
    (reports.iter().map(|report| report.loss).collect(), trainer.trained())
}

/// Hashes of [`train`] by driver and instruction set, because compilers round differently. The program before other
/// strategies existed gave the same bytes in longer trainings (tools/strategies.md).
const REFERENCE: &[(&str, u64)] = &[
    ("llvmpipe (LLVM 15.0.6, 128 bits), llvmpipe Mesa 22.3.6 (LLVM 15.0.6), FMA", 0x87a9_127a_28f3_5ac3),
    ("llvmpipe (LLVM 15.0.6, 128 bits), llvmpipe Mesa 22.3.6 (LLVM 15.0.6), AVX-512", 0x87a9_127a_28f3_5ac3),
    ("llvmpipe (LLVM 15.0.6, 256 bits), llvmpipe Mesa 22.3.6 (LLVM 15.0.6), FMA", 0x742a_6caf_25a7_9d92),
    ("llvmpipe (LLVM 15.0.6, 256 bits), llvmpipe Mesa 22.3.6 (LLVM 15.0.6), AVX-512", 0x742a_6caf_25a7_9d92),
    ("llvmpipe (LLVM 15.0.6, 512 bits), llvmpipe Mesa 22.3.6 (LLVM 15.0.6), FMA", 0xd9c4_b828_1b8a_04f7),
    ("llvmpipe (LLVM 15.0.6, 512 bits), llvmpipe Mesa 22.3.6 (LLVM 15.0.6), AVX-512", 0xd9c4_b828_1b8a_04f7),
];

fn compiler_and_instructions(gpu: &Gpu) -> String {
    let description = gpu.context.description();
    #[cfg(target_arch = "x86_64")]
    let instructions = match (is_x86_feature_detected!("avx512f"), is_x86_feature_detected!("fma")) {
        (true, _) => "AVX-512",
        (false, true) => "FMA",
        (false, false) => "SSE",
    };
    #[cfg(not(target_arch = "x86_64"))]
    let instructions = std::env::consts::ARCH;
    let backend = std::env::var("ASHSPLAT_BACKEND").map_or(String::new(), |backend| format!(", {backend}"));
    format!("{}, {}, {instructions}{backend}", description.name, description.driver)
}

#[test]
fn determinism_of_training_keeps_the_bits_of_the_reference() {
    let gpu = Gpu::new();
    let (losses, trained) = train(&gpu, 3);
    let (again, second) = train(&gpu, 3);
    assert!(losses.iter().all(|loss| loss.is_finite()));
    assert_eq!(losses, again);
    assert!(trained == second, "two runs with one seed differ");
    assert_ne!(trained.len(), 200, "nothing was densified");
    assert!(trained != train(&gpu, 4).1, "the seed has no effect");
    let mut print = Fingerprint::new();
    print.add(bytemuck::cast_slice(&losses));
    print.add(bytemuck::cast_slice(&trained.means));
    print.add(bytemuck::cast_slice(&trained.quats));
    print.add(bytemuck::cast_slice(&trained.log_scales));
    print.add(bytemuck::cast_slice(&trained.opacity_logits));
    print.add(bytemuck::cast_slice(&trained.sh));
    let (key, hash) = (compiler_and_instructions(&gpu), print.finish());
    match REFERENCE.iter().find(|(known, _)| *known == key) {
        Some(&(_, known)) => assert_eq!(hash, known, "training by the reference has other bits on {key}"),
        None => eprintln!("skipped: no hash of \"{key}\"; this one is {hash:#x}"),
    }
}

fn short_trainer(context: &Context) -> ashsplat::Result<Trainer> {
    let settings =
        TrainSettings { densify_from_iter: 2, densification_interval: 2, ..TrainSettings::reference() };
    Run::new(context, training::views(3, 60), settings).try_begin()
}

#[test]
fn determinism_is_verified() {
    let gpu = Gpu::new();
    let mut hashes = Vec::new();
    let verdict = verify_determinism(
        || Ok(gpu.context.clone()),
        short_trainer,
        6,
        |run, iteration, hash| hashes.push((run, iteration, hash)),
    );
    assert_eq!(verdict.expect("two runs"), Verdict::Same);
    assert_eq!(hashes.len(), 12);
    assert!(hashes.windows(2).all(|pair| pair[0].2 != pair[1].2), "{hashes:?}");
}

/// SH degree 1 is active from the third iteration on.
fn graded_trainer(context: &Context) -> ashsplat::Result<Trainer> {
    let settings = TrainSettings { sh_degree_interval: 3, ..TrainSettings::reference() };
    Run::new(context, training::views(3, 60), settings).try_begin()
}

fn without_harmonics(kernel: &str) -> SpecOverride {
    SpecOverride { kernel: kernel.into(), constant: "SH_DEGREE".into(), bits: 0 }
}

/// Every second run uses a device whose kernel of this name behaves differently.
fn first_difference(kernel: &str) -> (u32, &'static str) {
    let mut runs = 0;
    let context = || {
        runs += 1;
        let overrides = if runs % 2 == 0 { vec![without_harmonics(kernel)] } else { Vec::new() };
        Context::new(&ContextOptions { overrides, ..options() })
    };
    match verify_determinism(context, graded_trainer, 5, |_, _, _| ()).expect("two runs") {
        Verdict::Differs { iteration, first: Some(first), problem: None } => {
            assert_eq!(first.iteration, iteration);
            (iteration, first.record.kernel)
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn determinism_verification_names_the_first_kernel_that_differs() {
    assert_eq!(first_difference("forward/project"), (3, "forward/project"));
}

/// Without memory for the search, the verification still reports that two runs differ.
#[test]
fn determinism_verification_says_so_without_memory_for_more() {
    let mut contexts = 0;
    let context = || {
        contexts += 1;
        let overrides = if contexts == 2 { vec![without_harmonics("optimizer/adam")] } else { Vec::new() };
        // Audited runs start with the third.
        let max_memory = (contexts > 2).then_some(1 << 20);
        Context::new(&ContextOptions { overrides, max_memory, ..options() })
    };
    match verify_determinism(context, graded_trainer, 4, |_, _, _| ()).expect("two runs") {
        Verdict::Differs { first: None, problem: Some(problem), .. } => {
            assert_says(&problem, &["--max-memory"]);
        }
        other => panic!("{other:?}"),
    }
}

/// A submission with large outputs is audited piece by piece.
#[test]
fn determinism_audit_holds_a_few_outputs_at_a_time() {
    const MIB: u64 = 1 << 20;
    let context = Context::new(&options()).expect("a device");
    let requests = [("one", 8 * MIB), ("other", 8 * MIB)];
    let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
    let write = || {
        context.run("writes", |r| {
            r.fill(&buffers[0], 7);
            for round in 0..12 {
                r.barrier();
                r.copy(&buffers[0], &buffers[1]);
                r.barrier();
                r.fill(&buffers[0], 100 + round % 5);
            }
        })
    };
    let read = || context.download(&buffers[1]).expect("read");
    write().expect("run");
    let wanted = read();
    let audit = context.audit();
    write().expect("run");
    let records = audit.take();
    assert_eq!(records.len(), 25);
    // A copy has the hash of the fill before it.
    for (at, pair) in records.windows(2).enumerate().step_by(2) {
        assert_eq!((pair[0].kernel, pair[1].kernel), ("fill", "copy"));
        assert_eq!((pair[1].hash, pair[0].command), (pair[0].hash, at as u32));
    }
    assert!(records[1].hash != records[2].hash && records[2].hash == records[12].hash, "{records:?}");
    let held = arena_peak(&context, "audit");
    assert!(held > 0 && held <= 80 * MIB, "{held} bytes at a time");
    drop(audit);
    // Without the audit, because some devices download by a command.
    assert!(read() == wanted, "an audit changes results");
    assert_silent(&context);
}

fn by_form(options: &ContextOptions) -> Vec<(Vec<[f32; 3]>, ashsplat::Gradients)> {
    let context = Context::new(options).expect("a device");
    let mut renderer = Renderer::new(&context).expect("kernels");
    let mut results = Vec::new();
    for (sh, extent) in [(1, Extent::Exact), (4, Extent::Reference), (9, Extent::Exact), (16, Extent::Exact)]
    {
        let mut scene = gaussians(&small_scene(&mut Random::new(14), 1501, sh));
        // Some cover the picture, so that a whole subgroup sums their instances.
        scene.log_scales[..5].fill([0.5; 3]);
        renderer.upload(&scene).expect("upload");
        let degree = sh.isqrt() as u32 - 1;
        let view = View { extent, antialias: sh == 9, sh_degree: degree, ..small_view([250, 170]) };
        let (camera, settings) = (camera(&view), settings(&view));
        let target = vec![[0.5, -1.0, 0.25]; 250 * 170];
        let depths = vec![0.5; 250 * 170];
        let gradients = renderer.gradients(&camera, &settings, &target, Some(&depths)).expect("gradients");
        results.push((renderer.render(&camera, &settings).expect("a picture").color, gradients));
    }
    results
}

/// Kernels exist with and without texels (glsl/include/buffers.glsl): a device uses one form, tests use both.
#[test]
fn determinism_between_the_forms_of_kernels() {
    let plain = ContextOptions { push_descriptors: false, ..options() };
    let (texels, plain) = (by_form(&options()), by_form(&plain));
    assert!(texels.iter().all(|(picture, _)| picture.iter().any(|pixel| *pixel != [0.0; 3])));
    assert!(texels == plain, "texels and storage buffers give other bits");
}
