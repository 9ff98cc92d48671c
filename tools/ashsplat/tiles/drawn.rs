//! Reads the tiles of a tree that a camera needs.

use ashsplat::Result;
use ashsplat::scene::{Camera, Gaussians};
use ashsplat_files::splats::ReadOptions;
use ashsplat_files::tiles::Tree;
use std::collections::BTreeMap;

/// A tree that is drawn within a budget of Gaussians. It holds the tiles of the last picture.
pub struct Drawn {
    tree: Tree,
    budget: usize,
    read: ReadOptions,
    held: BTreeMap<usize, Gaussians>,
}

impl Drawn {
    pub fn new(tree: Tree, budget: usize, read: ReadOptions) -> Drawn {
        Drawn { tree, budget, read, held: BTreeMap::new() }
    }

    /// The Gaussians for a camera; `None` if they are those of the last one.
    pub fn wanted(&mut self, camera: &Camera) -> Result<Option<Gaussians>> {
        let cut = self.tree.cut(camera, self.budget);
        if !self.held.is_empty() && self.held.keys().eq(&cut) {
            return Ok(None);
        }
        self.held.retain(|tile, _| cut.contains(tile));
        for tile in cut {
            if let std::collections::btree_map::Entry::Vacant(place) = self.held.entry(tile) {
                place.insert(self.tree.read(tile, &self.read)?.gaussians);
            }
        }
        let sh_degree = self.held.values().map(|tile| tile.sh_degree).max().unwrap_or(0);
        let count = self.held.values().map(Gaussians::len).sum();
        let mut all = Gaussians::with_capacity(sh_degree, count);
        self.held.values().for_each(|tile| all.append(tile));
        Ok(Some(all))
    }

    /// Number of tiles for the last camera.
    pub fn tiles(&self) -> usize {
        self.held.len()
    }
}
