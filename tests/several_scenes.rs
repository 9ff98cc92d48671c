//! Several scenes on the device, drawn as one by `Renderer::set_scenes`.

use crate::common::prelude::*;
use crate::common::splats::{ball, camera};
use ashsplat::DeviceScene;

/// Ends of the parts: one is empty, and none is a multiple of a block.
const ENDS: [usize; 5] = [0, 130, 130, 400, 700];

fn parts(all: &Gaussians) -> Vec<Gaussians> {
    let part = |ends: &[usize]| all.select(&(ends[0]..ends[1]).collect::<Vec<_>>());
    ENDS.windows(2).map(part).collect()
}

fn uploaded(context: &Context, parts: &[Gaussians]) -> Vec<DeviceScene> {
    parts.iter().map(|part| DeviceScene::upload(context, part, 300).expect("uploaded")).collect()
}

#[test]
fn several_scenes_are_drawn_as_one_to_the_bit() {
    let all = ball(700);
    let mut renderer = renderer();
    let scenes = uploaded(renderer.context(), &parts(&all));
    let (camera, settings): (Camera, _) =
        (camera(0.3), RenderSettings { inverse_depth: true, ..Default::default() });
    renderer.upload(&all).expect("uploaded");
    let expected = renderer.render_with_tiles(&camera, &settings).expect("a frame");
    let pixel = [48, 32];
    let picked = renderer.inspect(&camera, &settings, pixel).expect("a report");
    assert!(picked.samples.iter().any(|sample| sample.gaussian > 400), "{picked:?}");
    renderer.set_scenes(&scenes).expect("scenes");
    let (frame, tiles) = renderer.render_with_tiles(&camera, &settings).expect("a frame");
    assert!(frame.color == expected.0.color && frame.transmittance == expected.0.transmittance);
    assert!(frame.inverse_depth == expected.0.inverse_depth && tiles == expected.1);
    assert_eq!(frame.stats.gaussians, 700);
    // Gaussians have the same indices as in one scene.
    assert_eq!(renderer.inspect(&camera, &settings, pixel).expect("a report"), picked);
    assert!(renderer.gaussians().expect("downloaded") == all && renderer.scene().is_none());
    // Draws a single scene while all are loaded.
    let alone = renderer.render_scene(&scenes[0], &camera, &settings).expect("a frame");
    let all_again = renderer.render(&camera, &settings).expect("a frame");
    assert_eq!((alone.stats.gaussians, all_again.stats.gaussians), (130, 700));
    // An empty list, and then a single uploaded scene.
    renderer.set_scenes(&scenes[1..2]).expect("none");
    assert!(renderer.render(&camera, &settings).expect("a frame").transmittance.iter().all(|&t| t == 1.0));
    renderer.set_scenes(&scenes).expect("scenes");
    renderer.upload(&parts(&all)[0]).expect("uploaded");
    assert!(renderer.render(&camera, &settings).expect("a frame").color == alone.color);
}

/// The loaded scenes are drawn again afterwards, also after an error.
#[test]
fn with_a_scene_several_others_stay_loaded() {
    let all = ball(700);
    // Created before the shared renderer is locked: a test that waits for its own device may hold that lock.
    let other = Context::new(&options()).expect("a device");
    let mut renderer = renderer();
    let scenes = uploaded(renderer.context(), &parts(&all));
    let (camera, settings) = (camera(0.3), RenderSettings::default());
    let ones = vec![[1.0; 3]; (camera.width * camera.height) as usize];
    renderer.upload(&parts(&all)[2]).expect("uploaded");
    let alone = renderer.gradients_with_pose(&camera, &settings, &ones, None).expect("gradients");
    renderer.set_scenes(&scenes).expect("scenes");
    let expected = renderer.render(&camera, &settings).expect("a frame");
    let [gradients, none] = [&scenes[2], &scenes[1]].map(|scene| {
        let act = |renderer: &mut Renderer| renderer.gradients_with_pose(&camera, &settings, &ones, None);
        renderer.with_scene(scene, act).expect("gradients")
    });
    assert!(gradients == alone && gradients.parameters.len() == 270);
    assert_eq!((none.parameters.len(), none.pose), (0, Some([0.0; 6])));
    let error = renderer.with_scene(&scenes[0], |renderer| renderer.gradients(&camera, &settings, &[], None));
    assert!(refusal(error).starts_with("image gradient: "));
    let elsewhere = DeviceScene::upload(&other, &all, 0).expect("uploaded");
    assert!(refusal(renderer.with_scene(&elsewhere, |_| Ok(()))).starts_with("scene: "));
    let unwind = |_: &mut Renderer| -> Result<()> { std::panic::resume_unwind(Box::new(())) };
    let panics = || renderer.with_scene(&scenes[0], unwind);
    assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(panics)).is_err());
    assert!(renderer.render(&camera, &settings).expect("a frame").color == expected.color);
}

#[test]
fn several_scenes_have_one_degree_and_no_gradients() {
    let mut renderer = renderer();
    let mut parts = parts(&ball(700));
    let scenes = uploaded(renderer.context(), &parts);
    renderer.set_scenes(&scenes).expect("scenes");
    let camera = camera(0.0);
    let gradient = vec![[0.0; 3]; (camera.width * camera.height) as usize];
    let refused = renderer.gradients(&camera, &RenderSettings::default(), &gradient, None);
    assert_says(refusal(refused), &["gradients are of one alone"]);
    parts[0] = parts[0].with_sh_degree(0);
    let others = uploaded(renderer.context(), &parts);
    assert_says(refusal(renderer.set_scenes(&others)), &["SH degree 0"]);
    // The previous scenes stay.
    assert_eq!(renderer.render(&camera, &RenderSettings::default()).expect("a frame").stats.gaussians, 700);
}
