//! Pipelines that cannot be built.

use ashsplat::vk::Fault;

use super::{close, device, is_of, render};

/// A device builds each pipeline once. After a failed build, the next run on the device builds it.
#[test]
fn faults_of_pipelines() {
    const OF_PIPELINES: [&str; 4] = [
        "create_shader_module",
        "create_compute_pipelines",
        "create_pipeline_layout",
        "create_descriptor_set_layout",
    ];
    let is_of_pipelines = |function: &&str| OF_PIPELINES.contains(function);
    let (context, faults) = device();
    let whole = render(&context).expect("no fault yet");
    let calls = faults.objects();
    faults.disarm();
    assert!(render(&context).expect("no fault") == whole);
    assert!(!faults.objects().iter().any(is_of_pipelines), "built twice");
    close(context);
    for function in OF_PIPELINES {
        let places: Vec<usize> = (0..calls.len()).filter(|&place| calls[place] == function).collect();
        for place in [places[0], places[places.len() / 2]] {
            let (context, faults) = device();
            faults.arm(Fault::Object, place as u64);
            let error = render(&context).map(|_| ()).expect_err("a fault");
            assert!(is_of(Fault::Object, &error), "{function} {place}: {error}");
            assert_eq!(faults.objects().last(), Some(&function));
            faults.disarm();
            assert!(render(&context).expect("works again") == whole, "{function} {place}");
            close(context);
        }
    }
}
