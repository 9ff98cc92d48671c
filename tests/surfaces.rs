//! Normals, median depths and meshes.

use crate::common::engine::settings;
use crate::common::prelude::*;
use crate::common::splats::{directions, disks};
use crate::kernels::surface::open_edges;
use crate::lenses::photographed;
use crate::reference::blend::{beside, is_surface_depth};
use crate::reference::pipeline::{self, pixels_of, tile_of};
use crate::reference::splat_surface::{depth_slope, splat_normal};
use ashsplat::scene::{Intrinsics, PhotoLens, Projection};
use ashsplat::surface::{DistanceField, FieldBlocks, FieldSettings, Mesh, PinholeView, Pinholes};
use ashsplat::train::MomentsType;
use ashsplat::{Surface, SurfaceDepth};
use glam::{DVec3, Mat3};

#[test]
fn surfaces_of_frames_equal_the_twins() {
    let _gpu = Gpu::new();
    for (seed, orthographic) in [(1, false), (2, true)] {
        let mut scene = small_scene(&mut Random::new(seed), 120, 16);
        // A disk of 2DGS, and a quaternion of zeros.
        scene[0].log_scale = [-1.0, -1.5, f64::from(f32::MIN)];
        scene[1].quat = [0.0; 4];
        let drawn = Style { orthographic, ..Style::AS_THEY_ARE };
        let focal_px = if orthographic { [14.0, 15.5] } else { [53.0, 56.0] };
        let view = View { drawn, focal_px, ..small_view([53, 37]) };
        let expected = pipeline::render(&scene, &view);
        let (normals, slopes): (Vec<[f64; 3]>, Vec<[f64; 2]>) = scene
            .iter()
            .map(|gaussian| {
                (splat_normal(gaussian, &view).0, depth_slope(gaussian, &view).unwrap_or_default())
            })
            .unzip();
        let mut renderer = renderer();
        renderer.upload(&gaussians(&scene)).expect("a scene");
        let wanted = |surface| RenderSettings { surface, inverse_depth: false, ..settings(&view) };
        let plain = renderer.render(&camera(&view), &settings(&view)).expect("a frame");
        for (kind, limit) in [(SurfaceDepth::Median, 0.5), (SurfaceDepth::Front, 0.7)] {
            let frame = renderer.render(&camera(&view), &wanted(Some(kind))).expect("a frame");
            let Surface { depth: depths, normals: shown } = frame.surface.expect("asked for");
            assert!(plain.color == frame.color && plain.surface.is_none(), "the same picture");
            let (mut off, mut covered) = (0, 0);
            for (index, pixel) in pixels_of(&view).enumerate() {
                let list = &expected.lists[tile_of(&view, pixel)];
                let splats: Vec<_> =
                    list.iter().map(|&g| expected.splats[g as usize].as_ref().expect("shown")).collect();
                let of_list = |g: &u32| (normals[*g as usize], slopes[*g as usize]);
                let (normals, slopes): (Vec<_>, Vec<_>) = list.iter().map(of_list).unzip();
                let (sums, _) = beside(&splats, (&vec![[0.0; 2]; list.len()], &normals), pixel);
                let world =
                    camera(&view).camera_from_world.as_dmat3().transpose() * DVec3::from_array(sums.normal);
                let shown = DVec3::from_array(shown[index].map(f64::from));
                let depth = f64::from(depths[index]);
                let right = is_surface_depth(depth, limit, (&splats, &slopes), pixel, 1e-4)
                    && shown.distance(world.normalize_or_zero()) < 1e-2;
                off += usize::from(!right);
                covered += usize::from(depth > 0.0);
            }
            // Decisions that depend on rounding.
            assert!(
                off <= expected.pixels.len() / 50 && covered > 500,
                "{kind:?}: {off} of {covered} pixels"
            );
        }
    }
}

fn cameras() -> Vec<Camera> {
    let intrinsics = Intrinsics::from_fov_x(0.7, 96, 96);
    let aside = |eye: Vec3| if eye.x.abs() < 2.0 { Vec3::X } else { Vec3::Y };
    let eyes = directions(20).into_iter().map(|direction| 4.0 * direction);
    eyes.map(|eye| Camera::look_at(eye, Vec3::ZERO, aside(eye), intrinsics)).collect()
}

fn mesh_of(renderer: &mut Renderer, field: FieldSettings, cameras: &[Camera]) -> Mesh {
    let views: Vec<PinholeView> = cameras
        .iter()
        .flat_map(|camera| Pinholes::new(&camera.photo_lens(), None).views(camera, None))
        .collect();
    let settings = RenderSettings { surface: Some(SurfaceDepth::Median), ..RenderSettings::default() };
    let mut blocks = FieldBlocks::new(renderer.context(), field).expect("settings");
    for view in &views {
        let frame = renderer.render(&view.camera, &settings).expect("a frame");
        blocks.add(view, &frame.surface.expect("asked for")).expect("blocks");
    }
    let field = DistanceField::new(renderer.context(), &blocks).expect("a field");
    for view in &views {
        field.integrate(renderer, view, &settings).expect("a view");
    }
    field.mesh().expect("a mesh")
}

#[test]
fn a_ball_becomes_a_closed_mesh() {
    let _gpu = Gpu::new();
    let mut renderer = renderer();
    renderer.upload(&disks(Vec3::ZERO)).expect("a scene");
    let field = FieldSettings { truncation: 0.125, ..FieldSettings::new(0.05, 10.0) };
    let mut mesh = mesh_of(&mut renderer, field, &cameras());
    assert_eq!(mesh, mesh_of(&mut renderer, field, &cameras()), "the same bits");
    mesh.keep_parts(mesh.triangles.len() / 2);
    check_ball(&mesh);
    let mut coarse = mesh.clone();
    coarse.simplify(500, &mut || Ok(())).expect("no stop");
    assert!(mesh.triangles.len() > 5000 && coarse.triangles.len() == 500, "{}", coarse.triangles.len());
    check_ball(&coarse);
    mesh.simplify(500, &mut || Ok(())).expect("no stop");
    assert_eq!(mesh, coarse, "the same bits");
    mesh.simplify(1, &mut || Ok(())).expect("no stop");
    assert_eq!((mesh.triangles.len(), mesh.positions.len()), (4, 4), "a tetrahedron has the ball's topology");
}

/// Blocks that lie across the border are in both halves, each of their voxels in one.
#[test]
fn halves_of_a_view_are_fused_like_the_whole() {
    let _gpu = Gpu::new();
    let mut renderer = renderer();
    renderer.upload(&disks(Vec3::ZERO)).expect("a scene");
    let whole = cameras()[0];
    let halves = [0.0, 48.0].map(|left| Camera { cx: whole.cx - left, width: 48, ..whole });
    let [expected, actual] = [&[whole][..], &halves].map(|cameras| {
        let mesh = mesh_of(&mut renderer, FieldSettings::new(0.05, 10.0), cameras);
        mesh.triangles.len()
    });
    // Pixels are rounded at the border.
    assert!(expected > 1000 && expected.abs_diff(actual) < 10, "{actual} triangles, expected {expected}");
}

/// Cameras beside whose axes the ball lies, so that two faces of a cube show it.
#[test]
fn a_ball_through_lenses_becomes_a_closed_mesh() {
    let _gpu = Gpu::new();
    let mut renderer = renderer();
    renderer.upload(&disks(Vec3::ZERO)).expect("a scene");
    let wide = Intrinsics { cx: 144.0, cy: 140.0, width: 288, height: 288, ..cameras()[0].intrinsics() };
    for projection in [Projection::Brown, Projection::Fisheye, Projection::Equirectangular] {
        let through = |camera: Camera| match projection {
            Projection::Brown => camera.with_lens(projection, &[-0.2, 0.03, 0.004, -0.003]),
            Projection::Fisheye => {
                let turn = Mat3::from_rotation_y(0.8);
                let (rotation, translation) = (turn * camera.camera_from_world, turn * camera.translation);
                Camera::with_pose(rotation, translation, wide).with_lens(projection, &[-0.02, 0.004])
            }
            _ => {
                let turn = Mat3::from_rotation_x(0.8);
                let (rotation, translation) = (turn * camera.camera_from_world, turn * camera.translation);
                PhotoLens::panorama(824, 412).camera(rotation, translation)
            }
        };
        let cameras: Vec<Camera> = cameras().into_iter().map(through).collect();
        let field = FieldSettings { truncation: 0.125, ..FieldSettings::new(0.05, 10.0) };
        let mut mesh = mesh_of(&mut renderer, field, &cameras);
        mesh.keep_parts(mesh.triangles.len() / 2);
        check_ball(&mesh);
    }
}

/// A closed ball of radius 1 with the colours of [`disks`].
fn check_ball(mesh: &Mesh) {
    assert_eq!(open_edges(&mesh.triangles), 0, "the mesh has a border");
    let at = |vertex: u32| Vec3::from_array(mesh.positions[vertex as usize]);
    let volume: f32 = mesh
        .triangles
        .iter()
        .map(|&[a, b, c]| Mat3::from_cols(at(a), at(b), at(c)).determinant() / 6.0)
        .sum();
    // Outside is in front of the triangles.
    assert!((3.9..4.6).contains(&volume), "{volume}");
    for (position, color) in mesh.positions.iter().zip(&mesh.colors) {
        let position = Vec3::from_array(*position);
        assert!((position.length() - 1.0).abs() < 0.08, "{position}");
        let [red, _, blue] = *color;
        assert!(position.z.abs() < 0.15 || (red > blue) == (position.z > 0.0), "{color:?} at {position}");
    }
}

/// A bent sheet of squares: one half lies flat, the other stands upright. It needs no vertices but its six corners.
#[test]
fn simplified_borders_and_edges_stay() {
    let side = 8u32;
    let vertex = |x: u32, y: u32| x + (2 * side + 1) * y;
    let all = (0..=side).flat_map(|y| (0..=2 * side).map(move |x| [x, y]));
    let corners = |x, y| [vertex(x, y), vertex(x + 1, y), vertex(x, y + 1), vertex(x + 1, y + 1)];
    let square = |[a, b, c, d]: [u32; 4]| [[a, b, d], [a, d, c]];
    let squares = (0..side).flat_map(|y| (0..2 * side).map(move |x| corners(x, y)));
    let mut mesh = Mesh {
        positions: all.map(|[x, y]| [x.min(side), y, x.max(side) - side].map(|at| at as f32)).collect(),
        colors: vec![[9, 8, 7]; vertex(2 * side, side) as usize + 1],
        triangles: squares.flat_map(square).collect(),
    };
    mesh.simplify(4, &mut || Ok(())).expect("no stop");
    let mut found: Vec<[i32; 3]> =
        mesh.positions.iter().map(|at| at.map(|at| (10.0 * at).round() as i32)).collect();
    found.sort_unstable();
    let expected = [[0, 0, 0], [0, 80, 0], [80, 0, 0], [80, 0, 80], [80, 80, 0], [80, 80, 80]];
    assert_eq!((mesh.triangles.len(), &found[..], &mesh.colors[..]), (4, &expected[..], &[[9, 8, 7]; 6][..]));
}

/// Training with `surface` turns a ball's randomly oriented Gaussians to its surface and shrinks their shortest axes.
#[test]
fn surfaces_are_trained() {
    let truth = disks(Vec3::ZERO);
    let views = photographed(&truth, cameras().into_iter().take(8));
    let mut start = truth;
    let mut random = Random::new(3);
    start.quats.iter_mut().for_each(|quat| *quat = [0; 4].map(|_| random.normal() as f32));
    start.log_scales.fill([-3.1, -2.9, -3.3]);
    let trained = |surface: bool| {
        let settings = TrainSettings {
            surface,
            iterations: 120,
            moments: MomentsType::Packed,
            sh_storage: ShStorage::Half,
            densify_until_iter: 1,
            rotation_lr: 0.01,
            scaling_lr: 0.01,
            ..TrainSettings::reference()
        };
        let mut trainer = Run::shared(views.clone(), settings).starting_at(&start).begin();
        trainer.finish();
        let found = trainer.gaussians().expect("Gaussians");
        let of_gaussian = |i: usize| {
            let [w, x, y, z] = found.quats[i];
            let turn = Mat3::from_quat(glam::Quat::from_xyzw(x, y, z, w).normalize());
            let outwards = Vec3::from_array(found.means[i]).normalize();
            let thickness = found.log_scales[i].into_iter().fold(f32::INFINITY, f32::min);
            [turn.z_axis.dot(outwards).abs(), thickness]
        };
        let sum = (0..found.len()).map(of_gaussian).fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        sum.map(|sum| sum / found.len() as f32)
    };
    let ([turned, thin], [plain_turned, plain_thin]) = (trained(true), trained(false));
    assert!(
        turned > plain_turned + 0.05 && thin < plain_thin - 0.05,
        "{turned} for {plain_turned}, {thin} for {plain_thin}"
    );
}

#[test]
fn small_parts_of_meshes_are_removed() {
    let ribbon = |first: u32, triangles: u32| (first..first + triangles).map(|i| [i, i + 1, i + 2]);
    let mut mesh = Mesh {
        positions: (0..20).map(|i| [i as f32, 0.0, 0.0]).collect(),
        colors: (0..20).map(|i| [i, 0, 0]).collect(),
        // Vertices 0, 6 to 9 and 19 belong to no triangle.
        triangles: ribbon(10, 7).chain(ribbon(1, 3)).collect(),
    };
    assert_eq!(mesh.keep_parts(3), 0);
    assert_eq!((mesh.positions.len(), mesh.colors[0], mesh.triangles[0]), (14, [1, 0, 0], [5, 6, 7]));
    assert_eq!(mesh.keep_parts(4), 1);
    assert_eq!((mesh.positions.len(), mesh.triangles.len(), mesh.triangles[6]), (9, 7, [6, 7, 8]));
    assert_eq!(mesh.positions[0], [10.0, 0.0, 0.0]);
    assert_eq!((mesh.keep_parts(8), mesh), (1, Mesh::default()));
}

#[test]
fn fields_refuse_what_they_cannot_fuse() {
    let gpu = Gpu::new();
    let assert_says = |error: Option<Error>, words: &[&str]| {
        assert_says(error.expect("an error").to_string(), words);
    };
    assert_says(
        FieldBlocks::new(gpu.context, FieldSettings::new(0.0, 1.0)).err(),
        &["voxel", "must be positive"],
    );
    let mut blocks = FieldBlocks::new(gpu.context, FieldSettings::new(0.1, 10.0)).expect("settings");
    assert_says(DistanceField::new(gpu.context, &blocks).err(), &["no view shows a surface"]);
    let pinhole = PinholeView { camera: cameras()[0], counts: None };
    let parallel = PinholeView { camera: pinhole.camera.orthographic(), counts: None };
    assert_says(blocks.add(&parallel, &Surface::default()).err(), &["is no pinhole"]);
    let few = PinholeView { counts: Some(vec![true; 96]), ..pinhole.clone() };
    assert_says(blocks.add(&few, &Surface::default()).err(), &["counts", "96x96 pixels"]);
    assert_says(blocks.add(&pinhole, &Surface::default()).err(), &["96x96 pixels"]);
    let surface = Surface { depth: vec![2.0; 96 * 96], normals: Vec::new() };
    blocks.add(&pinhole, &surface).expect("blocks");
    assert!(blocks.len() > 4);
    let mut tiny = FieldBlocks::new(gpu.context, FieldSettings::new(1e-8, 10.0)).expect("settings");
    assert_says(tiny.add(&pinhole, &surface).err(), &["too small for surfaces so far from the origin"]);
}
