//! A tree of tiles in a host's frames: each tile is a scene, read by a thread of the host and written by a recorded update.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc;

use crate::stage::{assert_same, cloud, guest, options, owned, rendered, with_host};
use ashsplat::scene::Intrinsics;
use ashsplat::{
    Camera, DeviceScene, Gaussians, Placed, RecordedFrame, RenderSettings, Renderer, Reservation, Update,
};
use ashsplat_files::Progress;
use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
use ashsplat_files::tiles::{self, Demand, TileOptions, Tree};
use glam::Vec3;

/// Gaussians of a tile.
const MOST: usize = 20;
/// Of the picture.
const BUDGET: usize = 200;
/// Scenes on the device: those of a picture, and those that take their place.
const ROOM: usize = 32;

fn written(folder: &std::path::Path) -> Tree {
    let (scene, tree) = (folder.join("scene.ply"), folder.join("tiles"));
    splats::write(&scene, &cloud(700, 4), &WriteOptions::default()).expect("a scene");
    let options = TileOptions { most: MOST, packed: false };
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(0.1);
    tiles::write(&scene, &tree, &options, &ReadOptions::default(), &mut measure, &Progress::NONE)
        .expect("tiles");
    Tree::open(&tree).expect("a tree")
}

/// Looks out of the cloud from its middle, at a quarter of it.
fn inside(turn: f32) -> Camera {
    let away = Vec3::new(turn.sin(), 0.0, -turn.cos());
    Camera::look_at(-0.2 * away, away, Vec3::NEG_Y, Intrinsics::from_fov_x(1.2, 110, 70))
}

/// A camera turns round. What it wants is asked for and drawn some frames later; until then what is there covers the picture. No frame waits,
/// and each is that of one scene with the same Gaussians, to the bit.
#[test]
fn tiles_stream_into_recorded_frames() {
    let folder = tempfile::tempdir().expect("a folder");
    let tree = written(folder.path());
    let (ask, asked) = mpsc::channel::<usize>();
    let (send, arrived) = mpsc::channel::<(usize, Gaussians)>();
    std::thread::scope(|threads| {
        let tree = &tree;
        threads.spawn(move || {
            for tile in asked {
                let own = tree.read(tile, &ReadOptions::default()).expect("a tile").gaussians;
                send.send((tile, own)).expect("a host that listens");
            }
        });
        with_host(&options(), |host| {
            let context = guest(host);
            let mut renderer = Renderer::new(&context).expect("kernels");
            let staging_bytes = Reservation::update_bytes(MOST as u32, 1);
            let most = (ROOM * MOST) as u32;
            let scenes = ROOM as u32;
            let reservation = Reservation { scenes, staging_bytes, ..Reservation::new(most, 1, 110, 70) };
            renderer.reserve(&reservation).expect("memory");
            let empty = || DeviceScene::empty(&context, MOST as u32, 1).expect("a scene");
            let mut free: Vec<DeviceScene> = (0..ROOM).map(|_| empty()).collect();
            let mut there: BTreeMap<usize, (DeviceScene, Gaussians)> = BTreeMap::new();
            let mut wished = BTreeSet::from([0]);
            ask.send(0).expect("a loader");
            let settings = RenderSettings::default();
            let (mut covered, mut settled, mut replaced) = (0, 0, 0);
            for frame in 0..200 {
                // It stands still at the end, so that all arrives.
                let camera = inside(0.06 * frame.min(100) as f32);
                let ideal = tree.cut(&camera, BUDGET);
                let wanted = tree.wanted(&Demand::of(&camera, BUDGET));
                // One tile per frame, if one has arrived. The first is waited for, and those that are wished at the end.
                let arrival = if there.is_empty() || frame > 100 && !wished.is_empty() {
                    Some(arrived.recv().expect("a tile"))
                } else {
                    arrived.try_recv().ok()
                };
                let arrival = arrival.filter(|(tile, _)| wished.remove(tile) && wanted.contains(tile));
                let mut new = None;
                if let Some((tile, own)) = arrival {
                    // The place of one that is not wanted. No frame flies here; one that does may still read it.
                    let unused = |other: &usize| !wanted.contains(other);
                    if free.is_empty() {
                        let old = there.keys().copied().find(unused).expect("room for more than a picture");
                        free.extend(there.remove(&old).map(|(scene, _)| scene));
                        replaced += 1;
                    }
                    let mut scene = free.pop().expect("room");
                    scene.set_count(own.len() as u32).expect("room");
                    there.insert(tile, (scene, own));
                    new = Some(tile);
                }
                for &tile in &wanted {
                    if !there.contains_key(&tile) && wished.insert(tile) {
                        ask.send(tile).expect("a loader");
                    }
                }
                let drawn = tree.cut_among(&Demand::of(&camera, BUDGET), |tile| there.contains_key(&tile));
                let update = |tile: usize| {
                    let (scene, gaussians) = &there[&tile];
                    Update { scene, first: 0, gaussians }
                };
                let updates: Vec<Update> = new.into_iter().map(update).collect();
                let placed: Vec<Placed> = drawn.iter().map(|tile| Placed::from(&there[tile].0)).collect();
                let recorded =
                    RecordedFrame { updates: &updates, ..RecordedFrame::new(&placed, &camera, &settings) };
                let pixels = rendered(host, &mut renderer, &recorded);
                if frame % 20 == 0 || frame > 190 {
                    let mut all = Gaussians { sh_degree: 1, ..Default::default() };
                    drawn.iter().for_each(|tile| all.append(&there[tile].1));
                    assert_same(&pixels, &owned(&all, &camera, &settings), [0.0; 3]);
                }
                assert!(!drawn.is_empty());
                covered += usize::from(drawn != ideal);
                settled += usize::from(drawn == ideal);
            }
            assert!(
                covered > 5 && settled > 50 && replaced > 5,
                "{covered} covered, {settled} settled, {replaced} replaced"
            );
        });
        drop(ask);
    });
}
