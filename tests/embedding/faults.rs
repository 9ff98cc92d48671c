//! On a host's device every call of the guest that may fail is made to fail once. The result is a typed error, no
//! panic, and no leak.

use crate::stage::*;
use crate::training::trainer;
use ashsplat::Result;
use ashsplat::train::StepReservation;
use ashsplat::vk::{Fault, Faults};

fn guest(host: &Host, faults: &Faults) -> Result<Context> {
    let options =
        ContextOptions { hazard_check: true, faults: Some(faults.clone()), ..ContextOptions::default() };
    // SAFETY: the host outlives the context, uses the queue from this thread, and lists the enabled features.
    unsafe { Context::from_foreign(&host.foreign(), &options) }
}

fn frame(host: &Host, faults: &Faults) -> Result<u32> {
    let context = guest(host, faults)?;
    let scene = DeviceScene::upload(&context, &cloud(60, 1), 0)?;
    let mut renderer = Renderer::new(&context)?;
    renderer.reserve(&Reservation::new(60, 1, 40, 30))?;
    Image::new(&context, "own", vk::Format::R32_SFLOAT, [40, 30], ImageUse::Depth)?;
    let (scenes, camera) = ([(&scene).into()], camera(0.3, 40, 30));
    let in_flight = Commands::new(host);
    let recorded = renderer.record(in_flight.begun(&context), 0, &frame_of(&scenes, &camera));
    if recorded.is_ok() {
        in_flight.finish();
    }
    // An incomplete recording is thrown away.
    recorded?;
    Ok(renderer.slot_report(0)?.expect("finished").visible)
}

/// Without push descriptors there are more allocations.
#[test]
fn faults_of_a_guest() {
    with_host(&HostOptions { push_descriptors: false, ..options() }, |host| {
        let faults = Faults::new();
        let whole = frame(host, &faults).expect("no fault yet");
        let functions = faults.objects();
        for name in ["create_event", "reset_event", "get_event_status", "create_image_view", "create_image"] {
            assert!(functions.contains(&name), "{name} is not injected");
        }
        let (mut refused, mut survived) = (0, 0);
        for (index, name) in functions.iter().enumerate() {
            // Kernels behave alike: test only the first and the last of each function's calls.
            if functions[..index].contains(name) && functions[index + 1..].contains(name) {
                continue;
            }
            faults.arm(Fault::Object, index as u64);
            match frame(host, &faults) {
                Ok(visible) => assert_eq!(visible, whole, "{name}"),
                Err(error) => {
                    let text = error.to_string();
                    assert!(text.contains("OUT_OF_HOST_MEMORY") && !text.contains('\n'), "{name}: {text}");
                    refused += 1;
                    continue;
                }
            }
            survived += 1;
        }
        eprintln!("a guest: {refused} refused, {survived} survived");
        assert!(refused > 15, "{refused} refused, {survived} survived");
        faults.disarm();
        assert_eq!(frame(host, &faults).expect("works again"), whole);
    });
}

/// After the context has seen a device loss, nothing can be recorded: no frame, no training step.
#[test]
fn a_lost_device_records_nothing() {
    with_host(&options(), |host| {
        let faults = Faults::new();
        let context = guest(host, &faults).expect("a context");
        let scene = uploaded(&context, &cloud(60, 1));
        let mut renderer = reserved(&context, &Reservation::new(60, 1, 40, 30));
        let mut trainer = trainer(&context, TrainSettings { iterations: 10, ..TrainSettings::reference() });
        trainer.reserve_steps(&StepReservation::default()).expect("memory");
        let (scenes, camera) = ([(&scene).into()], camera(0.3, 40, 30));
        let frame = frame_of(&scenes, &camera);
        let in_flight = Commands::new(host);
        faults.arm(Fault::WaitLost, 0);
        assert!(matches!(context.run("nothing", |_| {}), Err(Error::DeviceLost { .. })));
        faults.disarm();
        assert!(context.is_lost());
        let recorded = renderer.record(in_flight.begun(&context), 0, &frame);
        assert!(matches!(recorded, Err(Error::DeviceLost { .. })), "{recorded:?}");
        let recorded = trainer.record_step(in_flight.adopt(&context), 0);
        assert!(matches!(recorded, Err(Error::DeviceLost { .. })), "{recorded:?}");
    });
}

/// A run ends after the iterations of its settings, recorded or not.
#[test]
fn a_run_that_is_over_records_no_step() {
    with_host(&options(), |host| {
        let context = guest(host, &Faults::new()).expect("a context");
        let mut trainer = trainer(&context, TrainSettings { iterations: 3, ..TrainSettings::reference() });
        trainer.reserve_steps(&StepReservation { slots: 4, instances: 0, visible: 0 }).expect("memory");
        let frames = [0; 4].map(|_| Commands::new(host));
        for (slot, in_flight) in frames.iter().enumerate() {
            let recorded = trainer.record_step(in_flight.begun(&context), slot as u32);
            // Steps in flight count.
            match slot {
                3 => {
                    let error = recorded.expect_err("a fourth of three").to_string();
                    assert!(error.contains("the run is over") && error.contains("3 iterations"), "{error}");
                }
                _ => assert_eq!(recorded.expect("a recording").iteration, slot as u32 + 1),
            }
            in_flight.submit();
        }
        frames.iter().for_each(|in_flight| in_flight.wait());
        assert_eq!(trainer.settle().expect("settled"), 0);
        assert_eq!(trainer.iteration(), 3);
    });
}

/// A bad reservation fails before its kernels are built, which may take seconds.
#[test]
fn refused_reservations_build_no_kernels() {
    with_host(&options(), |host| {
        let faults = Faults::new();
        let context = guest(host, &faults).expect("a context");
        let own = Reservation::new(60, 1, 40, 30);
        let mut renderer = reserved(&context, &own);
        let in_flight = Commands::new(host);
        let scene = uploaded(&context, &cloud(60, 1));
        let (scenes, camera) = ([(&scene).into()], camera(0.3, 40, 30));
        let frame = frame_of(&scenes, &camera);
        renderer.record(in_flight.begun(&context), 0, &frame).expect("a recording");
        // All of these need kernels of their own.
        let good = Reservation { pick: true, motion: true, tint: true, orthographic: true, ..own };
        let block = context.allocate("block", &[("small", 256)], MemoryKind::Device).expect("memory");
        faults.disarm();
        let refused = |what: &str, error: Result<()>| {
            let text = error.expect_err(what).to_string();
            let mut made = faults.objects();
            made.retain(|function| *function != "get_event_status");
            assert!(text.contains(what) && made.is_empty(), "{text}: {made:?}");
        };
        refused("width and height", renderer.reserve(&Reservation { width: 0, ..good }));
        refused("in flight", renderer.reserve(&good));
        refused("in flight", renderer.reserve_in(&good, &block[0]));
        refused("growth keeps", renderer.grow(&Reservation { slots: 2, ..good }));
        refused("width and height", renderer.grow(&Reservation { width: 0, ..good }));
        refused("bytes", renderer.grow_in(&good, &block[0]));
        in_flight.finish();
        refused("bytes", renderer.reserve_in(&good, &block[0]));
        refused("needs", renderer.reserve(&Reservation { gaussians: u32::MAX, ..good }));
        // The previous reservation is still valid.
        renderer.record(in_flight.begun(&context), 0, &frame).expect("a recording");
        in_flight.finish();
        renderer.reserve(&good).expect("memory");
        assert!(faults.objects().contains(&"create_compute_pipelines"), "{:?}", faults.objects());
    });
}
