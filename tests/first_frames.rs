//! First frames start from an estimate of their instances, and are complete.

use crate::common::prelude::*;
use ashsplat::frame::{MIN_INSTANCES, MIN_VISIBLE, PictureCapacity, initial_instances, initial_visible};

const SIZE: [u32; 2] = [200, 120];

/// Gaussians whose log-scales differ from the usual by `by`.
fn scene(count: usize, by: f32) -> Gaussians {
    let mut scene = gaussians(&small_scene(&mut Random::new(77), count, 16));
    scene.log_scales.iter_mut().flatten().for_each(|s| *s += by);
    scene
}

fn render(context: &Context, scene: &Gaussians, instances: Option<u32>) -> Result<Frame> {
    let mut renderer = Renderer::new(context)?;
    renderer.upload(scene)?;
    if let Some(instances) = instances {
        renderer.set_instance_capacity(instances);
    }
    renderer.render(&camera(&small_view(SIZE)), &RenderSettings::default())
}

fn peaks(context: &Context) -> u64 {
    context.memory().iter().map(|arena| arena.peak_bytes).sum()
}

#[test]
fn a_first_frame_that_needs_more_than_estimated_is_whole() {
    let (context, scene) = (bounded(None), scene(1500, 2.5));
    let roomy = render(&context, &scene, Some(1 << 20)).expect("a frame");
    let first = render(&context, &scene, None).expect("a frame");
    let estimate = initial_instances(context.limits(), 1500, &PictureCapacity::of(SIZE[0], SIZE[1]));
    assert!(first.stats.instances > 2 * estimate, "{} of {estimate}", first.stats.instances);
    assert_eq!((first.stats.retries, roomy.stats.retries), (1, 0));
    assert!(first.color == roomy.color && first.transmittance == roomy.transmittance);
}

/// The memory is too small for the estimate, but large enough for the frame.
#[test]
fn a_first_frame_that_needs_less_than_estimated_is_not_refused() {
    let scene = scene(4000, -3.0);
    let roomy = bounded(None);
    let expected = render(&roomy, &scene, None).expect("a frame");
    let estimate = initial_instances(roomy.limits(), 4000, &PictureCapacity::of(SIZE[0], SIZE[1]));
    assert!(4 * expected.stats.instances < estimate, "{} of {estimate}", expected.stats.instances);
    let with_estimate = peaks(&roomy);
    drop(roomy);
    let tight = bounded(Some(with_estimate - u64::from(estimate - expected.stats.instances) * 4));
    let frame = render(&tight, &scene, None).expect("a frame");
    assert!(frame.color == expected.color);
    // If even the least is too much, the error says so.
    drop(tight);
    let smallest = bounded(Some(1 << 20));
    let error = render(&smallest, &scene, None).expect_err("refused");
    assert!(matches!(error, Error::TooLarge { .. }), "{error}");
    assert!(MIN_INSTANCES < estimate);
}

/// Same for visible Gaussians: the camera sees a tenth of a scene, and the estimate is a quarter.
#[test]
fn a_first_frame_that_shows_less_than_estimated_is_not_refused() {
    const COUNT: usize = 100_000;
    let scene = scene(COUNT, -3.0);
    let all = camera(&small_view(SIZE));
    let few = Camera { translation: all.translation + Vec3::X * 3.5, ..all };
    let render = |context: &Context| {
        loaded(context, &scene).render(&few, &RenderSettings::default()).expect("a frame")
    };
    let roomy = bounded(None);
    let expected = render(&roomy);
    let (estimate, visible) = (initial_visible(COUNT as u32), expected.stats.visible);
    assert_eq!(expected.stats.retries, 0);
    assert!(2 * visible < estimate && visible > 100, "{visible} of {estimate}");
    let with_estimate = peaks(&roomy);
    drop(roomy);
    // Less than half of the bytes of a visible Gaussian in a frame without gradients.
    let tight = bounded(Some(with_estimate - u64::from(estimate - 2 * visible) * 32));
    let frame = render(&tight);
    assert!(frame.color == expected.color && frame.stats.visible == visible);
}

/// A camera that sees little of a scene, followed by one that sees all.
#[test]
fn frames_have_room_for_what_is_visible_and_grow_when_more_is() {
    let (context, scene) = (bounded(None), scene(20_000, -1.0));
    let estimate = initial_visible(20_000);
    assert_eq!((estimate, initial_visible(MIN_VISIBLE), initial_visible(7)), (5000, MIN_VISIBLE, 7));
    let frame_bytes = || context.memory().iter().find(|arena| arena.name == "frame").map(|arena| arena.bytes);
    let mut renderer = loaded(&context, &scene);
    let all = camera(&small_view(SIZE));
    // Away from most of the scene.
    let few = Camera { translation: all.translation + Vec3::X * 4.0, ..all };
    let settings = RenderSettings::default();
    let little = renderer.render(&few, &settings).expect("a frame");
    assert!(little.stats.visible < estimate && little.stats.retries == 0, "{:?}", little.stats);
    let before = frame_bytes();
    let grown = renderer.render(&all, &settings).expect("a frame");
    assert!(grown.stats.visible > 2 * estimate && grown.stats.retries > 0, "{:?}", grown.stats);
    assert!(frame_bytes() > before);
    // Both are complete: later frames that need not grow are equal.
    for (camera, first) in [(&few, &little), (&all, &grown)] {
        let again = renderer.render(camera, &settings).expect("a frame");
        assert_eq!((again.stats.retries, again.stats.visible), (0, first.stats.visible));
        assert!(again.color == first.color && again.transmittance == first.transmittance);
    }
    renderer.upload(&Gaussians::default()).expect("upload");
    assert_eq!(renderer.render(&all, &settings).expect("a frame").stats.visible, 0);
}

/// There is memory for the first frame, but not beside the planned reserve of Gaussians.
#[test]
fn a_first_frame_takes_the_place_of_the_reserve_of_a_training() {
    let scene = scene(3000, 2.5);
    let train = |context: &Context| -> Result<(Gaussians, u32)> {
        let run = Run::new(context, vec![view_of(SIZE)], TrainSettings::reference());
        let mut trainer = run.starting_at(&scene).try_begin()?;
        trainer.step()?;
        trainer.step()?;
        Ok((trainer.gaussians()?, trainer.checkpoint()?.capacities.gaussians))
    };
    let (expected, room) = train(&bounded(None)).expect("trained");
    assert!(room > 3000);
    // Finds the least sufficient memory to a 64th.
    let (mut refused, mut enough) = (0u64, 256 << 20);
    let mut rooms = Vec::new();
    while enough - refused > enough / 64 {
        let middle = refused + (enough - refused) / 2;
        let context = bounded(Some(middle));
        match train(&context) {
            Ok((trained, room)) => {
                assert!(trained == expected, "other bits with {middle} bytes");
                rooms.push((middle, room));
                enough = middle;
            }
            Err(Error::TooLarge { .. }) => refused = middle,
            Err(error) => panic!("{middle}: {error}"),
        }
    }
    assert_eq!(rooms.last().map(|&(_, room)| room), Some(3000), "the reserve was kept: {rooms:?}");
}
