//! Meshes of scenes: depths of many views, fused into a field of signed distances (Curless and Levoy 1996), whose zero level
//! marching cubes (Lorensen and Cline 1987) makes a mesh of. Everything per voxel happens on the device.
//!
//! 1. [`Pinholes`] replace lenses, and tell which pixels a mask hides.
//! 2. [`FieldBlocks::add`] for each view collects the blocks of voxels near a surface.
//! 3. [`DistanceField::new`] allocates them; [`DistanceField::integrate`] adds each view, one after the other.
//! 4. [`DistanceField::mesh`] returns the [`Mesh`], of which [`Mesh::keep_parts`] removes what floats;
//!    [`Mesh::simplify`] makes it coarser.
//!
//! The same views in the same order give the same bits. Lengths are world units, in the axes of the scene.

mod blocks;
mod cubes;
mod field;
mod mesh;
mod pinholes;
mod simplify;

pub use blocks::{FieldBlocks, FieldSettings};
pub use cubes::cube_cases;
pub use field::DistanceField;
pub use mesh::Mesh;
pub use pinholes::{PinholeView, Pinholes};
