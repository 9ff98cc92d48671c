//! Which tiles of a tree are loaded, which are wanted, and which are removed.

use crate::draw::Viewer;
use ashsplat::Error;
use ashsplat_files::tiles::{Demand, Tree};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The loaded tiles. All wanted tiles stay. Of the others the most recent stay, with at most one picture's Gaussians.
pub struct Residency<T> {
    tree: Arc<Tree>,
    loaded: BTreeMap<usize, ResidentTile<T>>,
    wanted: BTreeMap<Viewer, Vec<usize>>,
    /// Errors of tiles that cannot be read.
    failed: BTreeMap<usize, String>,
    /// Tiles for which the device had no memory. They are requested again once some viewer wants other tiles.
    refused: BTreeSet<usize>,
    /// True once the lack of memory was reported.
    reported: bool,
    frames: u64,
}

struct ResidentTile<T> {
    scene: T,
    /// Last frame that wanted it.
    frame: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cut {
    pub drawn: Vec<usize>,
    /// Tiles that must be read for it, most urgent first.
    pub missing: Vec<usize>,
    pub wanted: usize,
}

impl<T> Residency<T> {
    /// Starts with the coarsest tile, which always stays.
    pub fn new(tree: Arc<Tree>, coarsest: T) -> Self {
        let loaded = BTreeMap::from([(0, ResidentTile { scene: coarsest, frame: 0 })]);
        let (wanted, failed, refused) = (BTreeMap::new(), BTreeMap::new(), BTreeSet::new());
        Self { tree, loaded, wanted, failed, refused, reported: false, frames: 0 }
    }

    /// Returns the tiles of a viewer's next picture. Removes unwanted tiles beyond the budget.
    pub fn cut(&mut self, viewer: Viewer, demand: &Demand<'_>) -> Cut {
        self.frames += 1;
        let possible = |tile: usize| !self.failed.contains_key(&tile);
        let wanted = self.tree.wanted_among(demand, possible);
        if self.wanted.get(&viewer) != Some(&wanted) {
            let others = self.wanted.iter().filter(|(other, _)| **other != viewer);
            let others: BTreeSet<usize> = others.flat_map(|(_, wanted)| wanted).copied().collect();
            self.refused.retain(|tile| others.contains(tile));
        }
        for tile in &wanted {
            if let Some(resident) = self.loaded.get_mut(tile) {
                resident.frame = self.frames;
            }
        }
        let missing = wanted.iter().copied().filter(|tile| !self.has(*tile) && !self.refused.contains(tile));
        let (missing, count) = (missing.collect(), wanted.len());
        self.wanted.insert(viewer, wanted);
        self.evict(demand.budget);
        let drawn = self.tree.cut_among(demand, |tile| self.has(tile));
        Cut { drawn, missing, wanted: count }
    }

    pub fn keep_viewers(&mut self, is_connected: impl Fn(&Viewer) -> bool) {
        self.wanted.retain(|viewer, _| is_connected(viewer));
    }

    pub fn has(&self, tile: usize) -> bool {
        self.loaded.contains_key(&tile)
    }

    pub fn get(&self, tile: usize) -> Option<&T> {
        self.loaded.get(&tile).map(|resident| &resident.scene)
    }

    pub fn add(&mut self, tile: usize, scene: T) {
        self.loaded.insert(tile, ResidentTile { scene, frame: self.frames });
    }

    /// Records a tile that failed. Returns the message to show, if any.
    pub fn fail(&mut self, tile: usize, error: &Error) -> Option<String> {
        if !is_memory(error) {
            let problem = error.to_string();
            return self.failed.insert(tile, problem.clone()).is_none().then_some(problem);
        }
        // The tile is then tried again.
        if self.evict_unwanted() {
            return None;
        }
        self.refused.insert(tile);
        let reported = std::mem::replace(&mut self.reported, true);
        (!reported).then(|| format!("no memory for finer tiles, a smaller budget needs less: {error}"))
    }

    /// Removes all tiles that nobody wants. True if there were any.
    pub fn evict_unwanted(&mut self) -> bool {
        let gone = self.evict(0) > 0;
        if gone {
            self.refused.clear();
        }
        gone
    }

    /// Number of loaded tiles, and of their Gaussians.
    pub fn resident(&self) -> (usize, usize) {
        (self.loaded.len(), self.loaded.keys().map(|&tile| self.gaussians(tile)).sum())
    }

    /// Errors of tiles that cannot be read.
    pub fn problems(&self) -> impl Iterator<Item = &str> {
        self.failed.values().map(String::as_str)
    }

    fn gaussians(&self, tile: usize) -> usize {
        self.tree.tiles().get(tile).map_or(0, |tile| tile.gaussians)
    }

    /// Removes unwanted tiles, longest unwanted first, until the others have at most `max_gaussians` Gaussians. Returns the number
    /// removed.
    fn evict(&mut self, max_gaussians: usize) -> usize {
        let wanted: BTreeSet<usize> = self.wanted.values().flatten().copied().chain([0]).collect();
        let unwanted = self.loaded.iter().filter(|(tile, _)| !wanted.contains(tile));
        let mut unwanted: Vec<(u64, usize)> =
            unwanted.map(|(&tile, resident)| (resident.frame, tile)).collect();
        // Latest first; among these the coarser ones, which cover more.
        unwanted.sort_unstable_by_key(|&(frame, tile)| (std::cmp::Reverse(frame), tile));
        let (mut kept, before) = (0, self.loaded.len());
        for (_, tile) in unwanted {
            kept += self.gaussians(tile);
            if kept > max_gaussians {
                self.loaded.remove(&tile);
            }
        }
        before - self.loaded.len()
    }
}

/// True if the device's memory does not suffice.
pub fn is_memory(error: &Error) -> bool {
    matches!(error, Error::TooLarge { .. } | Error::Vulkan { .. })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::scene::{Camera, Gaussians, Intrinsics};
    use ashsplat_files::Progress;
    use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
    use ashsplat_files::tiles::{self, TileOptions};
    use glam::Vec3;

    const BUDGET: usize = 120;
    const PAGES: [Viewer; 2] = [Viewer { page: 1, films: false }, Viewer { page: 2, films: false }];

    /// A ring of 640 Gaussians, 20 in a tile.
    fn ring() -> Arc<Tree> {
        let folder = tempfile::tempdir().expect("a folder");
        let (scene, tree) = (folder.path().join("scene.ply"), folder.path().join("tree"));
        let mut all = Gaussians::with_capacity(0, 640);
        for index in 0..640 {
            let (sin, cos) = (index as f32 * 0.01).sin_cos();
            all.means.push([sin, 0.01 * (index % 7) as f32, cos]);
            all.quats.push([1.0, 0.0, 0.0, 0.0]);
            all.log_scales.push([-4.5; 3]);
            all.opacity_logits.push(1.0);
            all.sh.push([0.1; 3]);
        }
        splats::write(&scene, &all, &WriteOptions::default()).expect("a scene");
        let options = TileOptions { max_gaussians: 20, packed: false };
        let mut measure = |_: &Gaussians, _: &Gaussians| Ok(0.1);
        tiles::write(&scene, &tree, &options, &ReadOptions::default(), &mut measure, &Progress::NONE)
            .expect("tiles");
        Arc::new(Tree::open(&tree).expect("a tree"))
    }

    fn looking(turn: f32) -> Camera {
        let lens = Intrinsics::from_fov_x(0.9, 64, 48);
        Camera::look_at(Vec3::ZERO, Vec3::new(turn.sin(), 0.0, turn.cos()), Vec3::NEG_Y, lens)
    }

    /// The cut after all missing tiles were loaded at once.
    fn loaded(residency: &mut Residency<()>, viewer: Viewer, turn: f32) -> Cut {
        let camera = looking(turn);
        let demand = Demand::of(&camera, BUDGET);
        let cut = residency.cut(viewer, &demand);
        cut.missing.iter().for_each(|&tile| residency.add(tile, ()));
        residency.cut(viewer, &demand)
    }

    #[test]
    fn memory_is_bounded_and_what_is_wanted_stays() {
        let tree = ring();
        let mut residency = Residency::new(tree.clone(), ());
        let first = residency.cut(PAGES[0], &Demand::of(&looking(0.0), BUDGET));
        assert_eq!((first.drawn.as_slice(), first.missing.len() + 1), (&[0][..], first.wanted));
        let mut max_tiles = 0;
        for step in 0..100 {
            let cut = loaded(&mut residency, PAGES[0], 0.3 * step as f32);
            assert_eq!(cut.drawn, tree.cut(&looking(0.3 * step as f32), BUDGET));
            assert!(cut.missing.is_empty() && cut.drawn.len() > 2, "{cut:?}");
            let wanted: usize =
                residency.wanted[&PAGES[0]].iter().map(|&tile| residency.gaussians(tile)).sum();
            assert!(residency.resident().1 <= wanted + BUDGET, "{:?}", residency.resident());
            max_tiles = max_tiles.max(residency.resident().0);
        }
        assert!(2 * max_tiles < tree.tiles().len(), "{max_tiles} of {}", tree.tiles().len());
        // Another page looks the other way; neither removes the other's tiles.
        let both = [0.0, 3.1].map(looking);
        for (page, turn) in [(0, 0.0), (1, 3.1), (1, 3.1), (0, 0.0), (1, 3.1)] {
            loaded(&mut residency, PAGES[page], turn);
        }
        for (page, camera) in PAGES.into_iter().zip(&both) {
            assert!(residency.cut(page, &Demand::of(camera, BUDGET)).missing.is_empty());
        }
        // The page leaves, and its tiles go when others come.
        residency.keep_viewers(|viewer| *viewer == PAGES[0]);
        residency.evict(0);
        assert!(!residency.cut(PAGES[1], &Demand::of(&both[1], BUDGET)).missing.is_empty());
    }
}
