//! A tree of tiles in a host's frames: each tile is a scene that a thread reads and a recorded update writes.

use crate::stage::*;
use ashsplat_files::Progress;
use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
use ashsplat_files::tiles::{self, Demand, TileOptions, Tree};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::mpsc;

/// Gaussians of a tile.
const MAX_GAUSSIANS: usize = 20;
/// Budget of the picture, in Gaussians.
const BUDGET: usize = 200;
/// Number of scenes on the device: those of a picture, and those that replace them.
const ROOM: usize = 32;
const SLOTS: usize = 2;
const SIZE: [u32; 2] = [110, 70];

fn written(folder: &std::path::Path) -> Tree {
    let (scene, tree) = (folder.join("scene.ply"), folder.join("tiles"));
    splats::write(&scene, &cloud(700, 4), &WriteOptions::default()).expect("a scene");
    let options = TileOptions { max_gaussians: MAX_GAUSSIANS, packed: false };
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(0.1);
    tiles::write(&scene, &tree, &options, &ReadOptions::default(), &mut measure, &Progress::NONE)
        .expect("tiles");
    Tree::open(&tree).expect("a tree")
}

/// A camera in the middle of the cloud that looks outwards, at a quarter of it.
fn inside(turn: f32) -> Camera {
    let away = Vec3::new(turn.sin(), 0.0, -turn.cos());
    Camera::look_at(-0.2 * away, away, Vec3::NEG_Y, Intrinsics::from_fov_x(1.2, SIZE[0], SIZE[1]))
}

struct Flying {
    camera: Camera,
    tiles: Vec<usize>,
    /// The Gaussians drawn.
    gaussians: Gaussians,
}

/// A camera turns around. Wanted tiles arrive some frames later; until then coarser tiles cover the picture. Neither
/// of two frames in flight waits for the other, and no update writes what a frame reads. Each picture equals that of
/// one scene with the same Gaussians, to the bit.
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
        with_guest(|host, context| {
            let mut renderer = Renderer::new(&context).expect("kernels");
            let staging_bytes = Reservation::update_bytes(MAX_GAUSSIANS as u32, 1);
            let wanted = Reservation::new((ROOM * MAX_GAUSSIANS) as u32, 1, SIZE[0], SIZE[1]);
            let (slots, scenes) = (SLOTS as u32, ROOM as u32);
            renderer.reserve(&Reservation { slots, scenes, staging_bytes, ..wanted }).expect("memory");
            let pixels = (SIZE[0] * SIZE[1]) as usize;
            let commands = [0; SLOTS].map(|_| Commands::new(host));
            let pictures = [0; SLOTS].map(|_| Staging::new(host, 16 * pixels as u64));
            let mut flying: [Option<Flying>; SLOTS] = [const { None }; SLOTS];
            let empty = || DeviceScene::empty(&context, MAX_GAUSSIANS as u32, 1).expect("a scene");
            let mut free: Vec<DeviceScene> = (0..ROOM).map(|_| empty()).collect();
            // Removed scenes, with their tiles and the frame from which on no frame in flight reads them.
            let mut leaving: VecDeque<(usize, DeviceScene, usize)> = VecDeque::new();
            let mut there: BTreeMap<usize, (DeviceScene, Gaussians)> = BTreeMap::new();
            let mut wished = BTreeSet::from([0]);
            ask.send(0).expect("a loader");
            let (mut covered, mut settled, mut replaced, mut overlapped) = (0, 0, 0, 0);
            for frame in 0..200 {
                let slot = frame % SLOTS;
                if let Some(done) = flying[slot].take() {
                    commands[slot].wait();
                    // Frames of both slots in turn.
                    if frame % 5 == 0 || frame > 190 {
                        assert_same(&pictures[slot].read(), &owned(&done.gaussians, &done.camera, &SETTINGS));
                    }
                }
                while leaving.front().is_some_and(|(from, ..)| *from <= frame) {
                    let (_, scene, tile) = leaving.pop_front().expect("the first");
                    let flies = |other: &Flying| other.tiles.contains(&tile);
                    assert!(!flying.iter().flatten().any(flies), "frame {frame} writes what another draws");
                    overlapped += usize::from(flying.iter().flatten().count() > 0);
                    free.push(scene);
                }
                // The camera stops at the end, so that all tiles arrive.
                let camera = inside(0.06 * frame.min(100) as f32);
                let ideal = tree.cut(&camera, BUDGET);
                let wanted = tree.wanted(&Demand::of(&camera, BUDGET));
                let old = there.keys().copied().find(|other| !wanted.contains(other));
                if let Some(old) = old.filter(|_| free.is_empty() && leaving.is_empty()) {
                    // The previous frame may draw the tile. It ends before the next frame's slot is used again.
                    leaving.extend(there.remove(&old).map(|(scene, _)| (frame + SLOTS - 1, scene, old)));
                    replaced += 1;
                }
                // At most one tile per frame, if one has arrived and a scene is free. Waits for the first tile, and
                // at the end for all that are requested.
                let arrival = if free.is_empty() {
                    None
                } else if there.is_empty() || frame > 100 && !wished.is_empty() {
                    Some(arrived.recv().expect("a tile"))
                } else {
                    arrived.try_recv().ok()
                };
                let arrival = arrival.filter(|(tile, _)| wished.remove(tile) && wanted.contains(tile));
                let mut new = None;
                if let Some((tile, own)) = arrival {
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
                assert!(!drawn.is_empty());
                covered += usize::from(drawn != ideal);
                settled += usize::from(drawn == ideal);
                let update = |tile: usize| {
                    let (scene, gaussians) = &there[&tile];
                    Update { scene, first: 0, gaussians }
                };
                let updates: Vec<Update> = new.into_iter().map(update).collect();
                let placed: Vec<Placed> = drawn.iter().map(|tile| Placed::from(&there[tile].0)).collect();
                let recorded = RecordedFrame { updates: &updates, ..frame_of(&placed, &camera) };
                let in_flight = &commands[slot];
                renderer.record(in_flight.begun(&context), slot as u32, &recorded).expect("a recording");
                copy_pixels(&mut renderer, slot as u32, in_flight, &pictures[slot]);
                in_flight.submit();
                let mut gaussians = Gaussians { sh_degree: 1, ..Default::default() };
                drawn.iter().for_each(|tile| gaussians.append(&there[tile].1));
                flying[slot] = Some(Flying { camera, tiles: drawn, gaussians });
            }
            commands.iter().for_each(Commands::wait);
            assert!(
                covered > 5 && settled > 50 && replaced > 5 && overlapped > 5,
                "{covered} covered, {settled} settled, {replaced} replaced, {overlapped} while a frame flew"
            );
        });
        drop(ask);
    });
}
