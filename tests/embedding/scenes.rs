//! Scenes that change, have poses, lie in the host's memory, or share a frame.

use crate::stage::*;
use ashsplat::frame::ScenePlan;
use ashsplat::scene::Similarity;

pub fn appended(a: &Gaussians, b: &Gaussians) -> Gaussians {
    let mut both = a.clone();
    both.append(b);
    both
}

pub fn similarity(turn: Quat, scale: f32, shift: Vec3) -> Similarity {
    Similarity { rotation: turn.as_dquat(), scale: scale.into(), translation: shift.as_dvec3() }
}

/// An object with a similarity applied, and another one.
pub fn joined(object: &Gaussians, by: &Similarity, other: &Gaussians) -> Gaussians {
    let mut both = object.clone();
    both.transform(by);
    both.append(other);
    both
}

pub fn renderer(context: &Context, gaussians: u32, staging_bytes: u64) -> Renderer {
    let reservation = Reservation { scenes: 3, staging_bytes, ..Reservation::new(gaussians, 1, 110, 70) };
    reserved(context, &reservation)
}

pub fn assert_nearly_equal(pixels: &[[f32; 4]], expected: &Frame) {
    let differences = pixels
        .iter()
        .zip(&expected.color)
        .map(|(p, c)| (0..3).map(|k| (p[k] - c[k]).abs()).fold(0.0, f32::max));
    let far = differences.filter(|d| *d > 2e-3).count();
    assert!(far <= pixels.len() / 500, "{far} pixels differ");
}

/// A uniform scale equals larger Gaussians farther apart, also for Gaussians before and behind them.
#[test]
fn a_pose_scales_a_scene() {
    with_guest(|host, context| {
        let turn = Quat::from_euler(glam::EulerRot::XYZ, -0.3, 0.5, 0.2);
        let (object, other) = (cloud(400, 8), cloud(300, 9));
        let scenes = [&object, &other].map(|g| uploaded(&context, g));
        let mut renderer = renderer(&context, 2000, 0);
        renderer
            .reserve(&Reservation { scenes: 2, inverse_depth: true, ..Reservation::new(2000, 1, 110, 70) })
            .expect("memory");
        let settings = RenderSettings { inverse_depth: true, ..RenderSettings::default() };
        let camera = camera(0.7, 110, 70);
        for scale in [0.25f32, 0.7, 1.0, 1.9] {
            let shift = Vec3::new(0.3, -0.2, 0.5);
            let both = joined(&object, &similarity(turn, scale, shift), &other);
            let expected = owned(&both, &camera, &settings);
            let matrix = glam::Mat4::from_scale_rotation_translation(Vec3::splat(scale), turn, shift);
            let pose = Pose::from_matrix(matrix).expect("a uniform scale");
            assert!((pose.scale - scale).abs() < 1e-6 * scale);
            // The scaled scene first, and second: both are sorted together.
            let scaled = Placed::at(&scenes[0], pose);
            for placed in [[scaled, (&scenes[1]).into()], [(&scenes[1]).into(), scaled]] {
                let frame = RecordedFrame::new(&placed, &camera, &settings);
                assert_nearly_equal(&rendered(host, &mut renderer, &frame), &expected);
            }
        }
    });
}

#[test]
fn a_scene_may_lie_in_the_hosts_buffers() {
    with_guest(|host, context| {
        let gaussians = cloud(300, 8);
        let plan = DeviceScene::plan_for(&context, 300, 1, ShStorage::F32).expect("a plan");
        assert_eq!(plan.chunks, 1);
        let bytes = plan.chunk_bytes() + 4096;
        let own = Staging::new(host, bytes);
        own.write(&planes(&gaussians, plan.chunk_gaussians as usize));
        // SAFETY: the buffer is the host's, of this size, and outlives the scene.
        let adopted = unsafe { Buffer::adopt(&context, "host's scene", own.raw, 0, bytes) };
        let adopted = adopted.expect("adopted");
        let scene = DeviceScene::from_buffers(&context, plan, vec![adopted.clone()], 300).expect("a scene");
        let mut renderer = renderer(&context, 300, 0);
        let camera = camera(0.1, 110, 70);
        let placed = [Placed::from(&scene)];
        assert_drawn(host, &mut renderer, &frame_of(&placed, &camera), &gaussians);
        let other = guest(host);
        // SAFETY: as above.
        let elsewhere = unsafe { Buffer::adopt(&other, "other's", own.raw, 0, bytes) }.expect("adopted");
        for (chunks, count, expected) in [
            (vec![], 300, "chunks: 0 of them, the plan has 1"),
            (vec![adopted.range(0, 64)], 300, "chunks[0] (buffer 'host's scene'): has 64 bytes, not "),
            (vec![elsewhere], 300, "chunks[0] (buffer 'other's'): it belongs to another context"),
            (vec![adopted.clone()], plan.capacity + 1, "count: "),
        ] {
            let error = DeviceScene::from_buffers(&context, plan, chunks, count).err().expect(expected);
            assert!(error.to_string().starts_with(expected), "{error} (expected {expected})");
        }
        for wrong in [
            ScenePlan { chunk_gaussians: 0, ..plan },
            ScenePlan { chunk_gaussians: plan.chunk_gaussians - 1, ..plan },
            ScenePlan { planes: 3, ..plan },
            ScenePlan { capacity: 100_000, ..plan },
            ScenePlan { sh_degree: 2, ..plan },
            ScenePlan { sh_degree: 7, ..plan },
            ScenePlan { chunks: 0, ..plan },
        ] {
            let chunks = vec![adopted.clone(); wrong.chunks as usize];
            let error = DeviceScene::from_buffers(&context, wrong, chunks, 10).err().expect("refused");
            assert!(matches!(&error, Error::Argument { what, .. } if what.starts_with("plan")), "{error:?}");
        }
        let mut scene = scene;
        let error = scene.set_count(plan.capacity + 1).expect_err("too many").to_string();
        assert!(error.starts_with("count: "), "{error}");
        let error = DeviceScene::empty(&context, 1, 4).err().expect("too high").to_string();
        assert_eq!(error, "sh_degree: 4 is above 3");
        let shapeless = Gaussians { quats: Vec::new(), ..gaussians.clone() };
        let error = DeviceScene::upload(&context, &shapeless, 0).err().expect("no rotations").to_string();
        assert!(error.starts_with("gaussians.quats: 0 entries"), "{error}");
        let error = DeviceScene::upload_all(&context, &[&gaussians, &shapeless]).err().expect("as above");
        assert!(error.to_string().starts_with("scenes[1].quats: 0 entries"), "{error}");
        drop((scene, adopted, renderer, other));
    });
}

/// A buffer larger than a binding may be is bound in part. One buffer cannot be two chunks.
#[test]
fn a_hosts_buffers_may_exceed_what_can_be_bound() {
    with_host(&options(), |host| {
        let context = guest_of_small_bindings(host);
        let gaussians = cloud(600, 8);
        let plan = DeviceScene::plan_for(&context, 1200, 1, ShStorage::F32).expect("a plan");
        assert_eq!(plan.chunks, 2, "{plan:?}");
        let own = [0; 2].map(|_| Staging::new(host, 1 << 20));
        own[0].write(&planes(&gaussians, plan.chunk_gaussians as usize));
        // SAFETY: the buffers are the host's, of this size, and outlive the scene.
        let adopt = |b: &HostBuffer| unsafe { Buffer::adopt(&context, "planes", b.raw, 0, 1 << 20) };
        let adopted: Vec<_> = own.iter().map(|b| adopt(b).expect("adopted")).collect();
        let twice = vec![adopted[0].clone(); 2];
        assert!(DeviceScene::from_buffers(&context, plan, twice, 600).is_err());
        let parts = |offsets: [u64; 2]| offsets.map(|at| adopted[0].range(at, plan.chunk_bytes())).to_vec();
        for (offsets, problem) in [
            ([0, (1 << 19) + 2], "chunks[1] (buffer 'planes'): begins at byte 524290"),
            ([0, 4096], "chunks: they overlap"),
        ] {
            let error =
                DeviceScene::from_buffers(&context, plan, parts(offsets), 600).err().expect("refused");
            assert!(error.to_string().starts_with(problem), "{error}");
        }
        let scene = DeviceScene::from_buffers(&context, plan, adopted, 600).expect("a scene");
        let mut renderer = reserved(&context, &Reservation::new(600, 1, 64, 48));
        let (camera, placed) = (camera(0.1, 64, 48), [(&scene).into()]);
        assert_drawn(host, &mut renderer, &frame_of(&placed, &camera), &gaussians);
        drop((scene, renderer));
    });
}

/// The layout that [`DeviceScene`] documents, at SH degree 1.
pub fn planes(g: &Gaussians, room: usize) -> Vec<u8> {
    let mut planes = vec![[0.0f32; 4]; 6 * room];
    for i in 0..g.len() {
        let ([x, y, z], [a, b, c]) = (g.means[i], g.log_scales[i]);
        let row = i / 8 * 24 + i % 8;
        planes[row] = [x, y, z, g.opacity_logits[i]];
        planes[row + 8] = g.quats[i];
        planes[row + 16] = [a, b, c, 0.0];
        let sh = g.sh[4 * i..4 * i + 4].as_flattened();
        for (plane, values) in sh.chunks(4).enumerate() {
            let at = if plane == 0 { 3 * room + i } else { 4 * room + i / 8 * 16 + 8 * (plane - 1) + i % 8 };
            planes[at].copy_from_slice(values);
        }
    }
    bytemuck::cast_slice(&planes).to_vec()
}

/// Opaque Gaussians in `side` rows and columns; `place` gets the column and the row, counted from the middle.
pub fn sheet(side: usize, log_scale: f32, place: impl Fn([f32; 2]) -> Vec3) -> Gaussians {
    let from_middle = |at: usize| at as f32 - (side - 1) as f32 / 2.0;
    let count = side * side;
    Gaussians {
        sh_degree: 0,
        means: (0..count).map(|i| place([i % side, i / side].map(from_middle)).to_array()).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: vec![[log_scale; 3]; count],
        opacity_logits: vec![4.0; count],
        sh: vec![[0.5; 3]; count],
    }
}

#[test]
fn expected_depth_is_the_depth_of_a_wall() {
    with_guest(|host, context| {
        let camera = camera(0.0, 64, 48);
        let wall = sheet(20, -2.5, |[x, y]| {
            let at = Vec3::new(0.1 * x, 0.1 * y, 3.5);
            camera.camera_from_world.transpose() * (at - camera.translation)
        });
        let scene = uploaded(&context, &wall);
        let reservation = Reservation { expected_depth: true, ..Reservation::new(400, 0, 64, 48) };
        let mut renderer = reserved(&context, &reservation);
        let picture =
            Picture::new(host, &context, ("depth", ImageUse::Depth), vk::Format::R32_SFLOAT, [64, 48]);
        let placed = [Placed::from(&scene)];
        let frame = RecordedFrame {
            depth: Some(DepthTarget { to: picture.unused(), min_weight: 0.5, empty: -1.0 }),
            ..frame_of(&placed, &camera)
        };
        let pixels = rendered(host, &mut renderer, &frame);
        let depths: Vec<f32> = picture.texture.read(WRITTEN);
        let mut covered = 0;
        for (depth, [_, _, _, transmittance]) in depths.into_iter().zip(pixels) {
            if transmittance > 0.5 {
                assert_eq!(depth, -1.0);
            } else {
                covered += 1;
                assert!((depth - 3.5).abs() < 1e-4, "{depth}");
            }
        }
        assert!(covered > 64 * 48 / 4, "{covered}");
    });
}

#[test]
fn a_hosts_depth_hides_what_lies_behind_it() {
    with_guest(|host, context| {
        let (gaussians, camera) = (cloud(600, 11), camera(0.0, 110, 70));
        let scene = uploaded(&context, &gaussians);
        let mut renderer =
            reserved(&context, &Reservation { occlusion: true, ..Reservation::new(600, 1, 110, 70) });
        let depth = |g: usize| camera.project(Vec3::from(gaussians.means[g])).2;
        // A wall between the Gaussians, in reversed depth with an infinite far plane: d = near / z.
        let (near, wall) = (0.1, 4.2);
        let mut kept = gaussians.clone();
        kept.retain(|_, g| depth(g) < wall);
        assert!((100..500).contains(&kept.len()));
        let placed = [Placed::from(&scene)];
        let plain = frame_of(&placed, &camera);
        let mapping = DepthMapping { scale: 1.0 / near, offset: 0.0, clear_value: 0.0, linear: false };
        for (value, expected) in [(near / wall, &kept), (0.0, &gaussians)] {
            let depth = Picture::of_depth(host, &context, [110, 70], value);
            let occluder = Some(Occluder { depth: host_image(&depth.image, COPIED), mapping });
            let pixels = rendered(host, &mut renderer, &RecordedFrame { occluder, ..plain });
            assert_same(&pixels, &owned(expected, &camera, &SETTINGS));
            // The slot's next recording releases the image.
            rendered(host, &mut renderer, &plain);
        }
    });
}
