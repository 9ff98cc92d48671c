//! Trees of tiles that a host streams, in C: wanted tiles, drawn tiles, a file's contents.

use super::*;
use ashsplat::scene::{Camera, Gaussians};
use ashsplat_files::tiles::{Demand, Tree};

/// A tree of tiles in a folder, as `ashsplat tiles` writes it. It does not change: all threads may use it at once.
pub struct AshsplatTree(Tree);

/// The Gaussians of a tile, in the host's memory.
pub struct AshsplatTileGaussians(Gaussians, FileNotes);

/// A tree's description of a tile.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatTile {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Its Gaussians.
    pub gaussians: u32,
    /// Error of the tile against the finest tiles, units of the scene. (error / size of a pixel)² is the sum of squared colour
    /// differences over the picture.
    pub error: f64,
    /// Least corner of the bounds of the tile and its descendants, units of the scene.
    pub min: [f32; 3],
    /// The greatest corner.
    pub max: [f32; 3],
}

/// Views and budget that tiles are chosen for.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatDemand {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Number of cameras, for example 2 for two eyes.
    pub camera_count: u32,
    /// The cameras. A tile is chosen if some camera sees it; its largest error in any picture decides.
    pub cameras: *const AshsplatCamera,
    /// Most Gaussians of all drawn tiles.
    pub budget: u64,
    /// Border around each picture, in picture sizes, whose Gaussians are drawn too, so that a turning camera finds them. They are
    /// refined after those in the picture. 0: none.
    pub border: f64,
}

/// Reads the description of a tree, but no tiles: `folder` has its tileset.json.
///
/// # Safety
/// `folder` is a C string, `tree` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tree_open(
    folder: *const c_char,
    tree: *mut *mut AshsplatTree,
) -> AshsplatStatus {
    guarded!({
        let folder = text(folder, "folder")?;
        give(tree, "tree", || Tree::open(folder).map(AshsplatTree))
    })
}

/// Frees a tree. Tiles that were read stay.
///
/// # Safety
/// `tree` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tree_free(tree: *mut AshsplatTree) {
    // SAFETY: as promised.
    unsafe { take(tree) }
}

/// The number of its tiles. They are numbered from 0, and tile 0 is the coarsest.
///
/// # Safety
/// `tree` is alive, `tiles` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tree_size(tree: *const AshsplatTree, tiles: *mut u32) -> AshsplatStatus {
    guarded!({ put(tiles, "tiles", borrowed(tree, "tree")?.0.tiles().len() as u32) })
}

/// Writes the description of a tile.
///
/// # Safety
/// `tree` is alive, `properties` begins with its size.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tree_tile(
    tree: *const AshsplatTree,
    tile: u32,
    properties: *mut AshsplatTile,
) -> AshsplatStatus {
    guarded!({
        let tiles = borrowed(tree, "tree")?.0.tiles();
        let of_none = || Error::argument("tile", format!("{tile} is none of {}", tiles.len()));
        let found = tiles.get(tile as usize).ok_or_else(of_none)?;
        let known = AshsplatTile {
            gaussians: found.gaussians as u32,
            error: found.error,
            min: found.bounds.min.to_array(),
            max: found.bounds.max.to_array(),
            ..AshsplatTile::default()
        };
        write(properties, "properties", known)
    })
}

/// Converts the cameras of a host's demand.
///
/// # Safety
/// There are as many cameras as the demand says.
unsafe fn cameras(demand: &AshsplatDemand) -> Result<Vec<Camera>> {
    // SAFETY: as promised.
    let all = unsafe { read_all(demand.cameras, demand.camera_count, "demand.cameras") }?;
    let all = all.collect::<Result<Vec<_>>>()?;
    if all.is_empty() {
        return Err(Error::argument("demand.cameras", "there are none"));
    }
    let known =
        |(index, camera): (usize, &AshsplatCamera)| camera.checked(&format!("demand.cameras[{index}]"));
    all.iter().enumerate().map(known).collect()
}

/// Chooses tiles for a demand, and writes their indices.
///
/// # Safety
/// Same as for [`ashsplat_tree_wanted`].
unsafe fn chosen(
    (tree, demand, there): (*const AshsplatTree, *const AshsplatDemand, *const bool),
    (tiles, count): (*mut u32, *mut u32),
    choose: impl FnOnce(&Tree, &Demand<'_>, &dyn Fn(usize) -> bool) -> Vec<usize>,
) -> AshsplatStatus {
    guarded!({
        let (tree, demand) = (&borrowed(tree, "tree")?.0, read(demand, "demand")?);
        check_pointer(tiles, "tiles")?;
        let count = borrowed_mut(count, "count")?;
        if !(demand.border.is_finite() && demand.border >= 0.0) {
            return Err(Error::argument("demand.border", format!("is {}, must be 0 or more", demand.border)));
        }
        let cameras = cameras(&demand)?;
        // Any value other than 0 is true, because hosts fill memory freely.
        let there = slice_if(there.cast::<u8>(), tree.tiles().len(), "there")?;
        let is_there = |tile: usize| there.is_none_or(|there| there[tile] != 0);
        let budget = usize::try_from(demand.budget).unwrap_or(usize::MAX);
        let found = choose(tree, &Demand { cameras: &cameras, budget, border: demand.border }, &is_there);
        for (place, tile) in found.iter().enumerate() {
            tiles.add(place).write(*tile as u32);
        }
        *count = found.len() as u32;
        Ok(())
    })
}

/// The tiles to load for a demand, most urgent first: those that ashsplat_tree_cut would draw, and their ancestors. A tile
/// follows its parent, and comes sooner if its parent's error is larger in pixels. `possible` has a value per tile, false if
/// it cannot be loaded, for example because its file is damaged; NULL: all can. Tiles that could only be drawn beside or
/// below such a tile are left out. `tiles` has room for as many numbers as the tree has tiles.
///
/// # Safety
/// `tree` is alive, `demand` begins with its size and has as many cameras as it says, `possible` is NULL or has one value per tile,
/// `tiles` is valid for as many writes, `count` for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tree_wanted(
    tree: *const AshsplatTree,
    demand: *const AshsplatDemand,
    possible: *const bool,
    tiles: *mut u32,
    count: *mut u32,
) -> AshsplatStatus {
    let wanted = |tree: &Tree, demand: &Demand<'_>, possible: &dyn Fn(usize) -> bool| {
        tree.wanted_among(demand, possible)
    };
    // SAFETY: as promised.
    unsafe { chosen((tree, demand, possible), (tiles, count), wanted) }
}

/// Tiles to draw, ascending: among those in `there`, the finest that the budget allows, refined first where the error in pixels is
/// largest. While one of the tiles that would replace a tile is not there, the tile itself is drawn. `there` has a value for each
/// tile of the tree; NULL: all are there. The coarsest tile is drawn however many Gaussians it has; nothing is drawn if it
/// is out of view or not there. `tiles` has room for as many numbers as the tree has tiles.
///
/// # Safety
/// Same as for ashsplat_tree_wanted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tree_cut(
    tree: *const AshsplatTree,
    demand: *const AshsplatDemand,
    there: *const bool,
    tiles: *mut u32,
    count: *mut u32,
) -> AshsplatStatus {
    let cut = |tree: &Tree, demand: &Demand<'_>, there: &dyn Fn(usize) -> bool| tree.cut_among(demand, there);
    // SAFETY: as promised.
    unsafe { chosen((tree, demand, there), (tiles, count), cut) }
}

/// Reads a tile's file: call it on a thread that may wait for a disk. AshsplatUpdate copies the Gaussians to the device in a
/// frame.
///
/// # Safety
/// `tree` is alive, `gaussians` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tree_read(
    tree: *const AshsplatTree,
    tile: u32,
    gaussians: *mut *mut AshsplatTileGaussians,
) -> AshsplatStatus {
    guarded!({
        let tree = borrowed(tree, "tree")?;
        give(gaussians, "gaussians", || {
            let read = tree.0.read(tile as usize, &splats::ReadOptions::default())?;
            let notes = FileNotes::of(&read);
            Ok(AshsplatTileGaussians(read.gaussians, notes))
        })
    })
}

/// The arrays of a tile's Gaussians, which live as long as `of` does.
///
/// # Safety
/// `of` is alive, `gaussians` begins with its size.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tile_gaussians(
    of: *const AshsplatTileGaussians,
    gaussians: *mut AshsplatGaussians,
) -> AshsplatStatus {
    guarded!({
        let own = &borrowed(of, "of")?.0;
        let arrays = AshsplatGaussians {
            count: own.len() as u32,
            sh_degree: own.sh_degree,
            means: own.means.as_flattened().as_ptr(),
            quats: own.quats.as_flattened().as_ptr(),
            log_scales: own.log_scales.as_flattened().as_ptr(),
            opacity_logits: own.opacity_logits.as_ptr(),
            sh: own.sh.as_flattened().as_ptr(),
            ..AshsplatGaussians::default()
        };
        write(gaussians, "gaussians", arrays)
    })
}

/// Notes of a tile's file, as ashsplat_scene_notes; all tiles of a tree say the same of antialiasing. `warnings` lives as long as `of`
/// does. Either pointer may be NULL.
///
/// # Safety
/// `of` is alive; the pointers are NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tile_notes(
    of: *const AshsplatTileGaussians,
    antialiased: *mut bool,
    warnings: *mut *const c_char,
) -> AshsplatStatus {
    guarded!({
        borrowed(of, "of")?.1.write_to(antialiased, warnings);
        Ok(())
    })
}

/// Frees a tile's Gaussians, once the call that has recorded their update has returned.
///
/// # Safety
/// `gaussians` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_tile_gaussians_free(gaussians: *mut AshsplatTileGaussians) {
    // SAFETY: as promised.
    unsafe { take(gaussians) }
}
