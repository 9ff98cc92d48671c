//! Cells that divide all space, for scenes that are trained block by block.

use glam::Vec3;

use super::points::Bounds;
use crate::error::{Error, Result};

/// Share of the points at each end of an axis that are excluded from its length as strays.
const STRAYS: f64 = 0.05;

/// Boxes that together fill all space: a k-d tree (Bentley 1975). Every point lies in exactly one, because lower sides belong
/// to a box and upper sides do not ([`Bounds::contains`]). The outermost boxes have infinite sides.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Boxes in the order of the tree, lower sides first.
    bounds: Vec<Bounds>,
    /// Nodes of the tree; the first is the root.
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Node {
    /// Points below `at` on the axis are in the first child, the others in the second.
    Split { axis: usize, at: f32, sides: [usize; 2] },
    /// Index of a cell.
    Leaf(usize),
}

/// Common side of two neighbouring cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seam {
    /// Indices of the cell below and of the cell above.
    pub cells: [usize; 2],
    /// Axis perpendicular to the side: 0 for x.
    pub axis: usize,
    /// Common rectangle, world units: of size 0 on that axis. Sides may be infinite.
    pub bounds: Bounds,
}

impl Seam {
    /// Distance of a point from the rectangle, world units.
    pub fn distance(&self, point: Vec3) -> f32 {
        point.distance(point.clamp(self.bounds.min, self.bounds.max))
    }
}

impl Cells {
    /// The only cell of an undivided space.
    pub const EVERYTHING: Bounds = Bounds { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY };

    /// Divides space until no cell has more than `max_gaussians` of the points (x, y, z; world units). A cell is split at the median of
    /// its longest axis; lengths exclude the outermost twentieths of its points. The cells do not depend on the order of the
    /// points.
    ///
    /// # Errors
    /// [`Error::Argument`] without points, for points that are not finite, for `max_gaussians` of 0, and if more than `max_gaussians` points
    /// coincide.
    pub fn divide(points: &[[f32; 3]], max_gaussians: usize) -> Result<Self> {
        if max_gaussians == 0 || points.is_empty() {
            return Err(Error::argument("cells", "a cell needs one Gaussian at least"));
        }
        if let Some(index) = points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
            return Err(Error::argument("cells", format!("Gaussian {index} lies at no finite place")));
        }
        let mut points: Vec<Vec3> = points.iter().copied().map(Vec3::from_array).collect();
        let mut cells = Self { bounds: Vec::new(), nodes: Vec::new() };
        cells.halve(&mut points, Self::EVERYTHING, max_gaussians)?;
        Ok(cells)
    }

    /// Adds the cells of a box and the node above them. Returns the node.
    fn halve(&mut self, points: &mut [Vec3], within: Bounds, max_gaussians: usize) -> Result<usize> {
        let node = self.nodes.len();
        self.nodes.push(Node::Leaf(self.bounds.len()));
        if points.len() <= max_gaussians {
            self.bounds.push(within);
            return Ok(node);
        }
        let Some((axis, at)) = median(points) else {
            let (count, place) = (points.len(), points[0]);
            let problem =
                format!("{count} Gaussians are at {place}: no cell can have {max_gaussians} of them");
            return Err(Error::argument("cells", problem));
        };
        // The order within a side does not matter, because only medians are used.
        points.sort_unstable_by(|a, b| a[axis].total_cmp(&b[axis]));
        let (below, above) = points.split_at_mut(points.partition_point(|point| point[axis] < at));
        let [lower, upper] = split(within, axis, at);
        let sides = [self.halve(below, lower, max_gaussians)?, self.halve(above, upper, max_gaussians)?];
        self.nodes[node] = Node::Split { axis, at, sides };
        Ok(node)
    }

    /// Rebuilds the tree of cells with these boxes, in their order.
    ///
    /// # Errors
    /// [`Error::Argument`] if the boxes overlap, leave a gap, or cannot be cut from all space by planes, one at a time.
    pub fn of(bounds: &[Bounds]) -> Result<Self> {
        let mut cells = Self { bounds: bounds.to_vec(), nodes: Vec::new() };
        cells.join((0..bounds.len()).collect(), Self::EVERYTHING)?;
        Ok(cells)
    }

    fn join(&mut self, cells: Vec<usize>, within: Bounds) -> Result<usize> {
        let node = self.nodes.len();
        if let [cell] = cells[..]
            && self.bounds[cell] == within
        {
            self.nodes.push(Node::Leaf(cell));
            return Ok(node);
        }
        let apart = |axis: usize, at: f32| {
            let inside = within.min[axis] < at && at < within.max[axis];
            inside && cells.iter().all(|&c| self.bounds[c].max[axis] <= at || self.bounds[c].min[axis] >= at)
        };
        let sides = (0..3).flat_map(|axis| cells.iter().map(move |&cell| (axis, cell)));
        let planes = sides.map(|(axis, cell)| (axis, self.bounds[cell].min[axis]));
        let Some((axis, at)) = planes.into_iter().find(|&(axis, at)| apart(axis, at)) else {
            let problem = format!(
                "{} boxes do not divide the space from {} to {}",
                cells.len(),
                within.min,
                within.max
            );
            return Err(Error::argument("cells", problem));
        };
        self.nodes.push(Node::Leaf(0));
        let below = |&cell: &usize| self.bounds[cell].max[axis] <= at;
        let (below, above): (Vec<usize>, Vec<usize>) = cells.into_iter().partition(below);
        let [lower, upper] = split(within, axis, at);
        let sides = [self.join(below, lower)?, self.join(above, upper)?];
        self.nodes[node] = Node::Split { axis, at, sides };
        Ok(node)
    }

    /// Boxes of the cells, world units.
    pub fn bounds(&self) -> &[Bounds] {
        &self.bounds
    }

    /// Index of the cell that contains a point; None if the point is not finite.
    pub fn at(&self, point: Vec3) -> Option<usize> {
        let mut node = Some(0).filter(|_| point.is_finite())?;
        loop {
            match self.nodes[node] {
                Node::Leaf(cell) => return Some(cell),
                Node::Split { axis, at, sides } => node = sides[usize::from(point[axis] >= at)],
            }
        }
    }

    /// Seams between neighbours, in the order of their cells.
    pub fn seams(&self) -> Vec<Seam> {
        let mut seams = Vec::new();
        for (first, one) in self.bounds.iter().enumerate() {
            for (second, other) in self.bounds.iter().enumerate() {
                let bounds = Bounds { min: one.min.max(other.min), max: one.max.min(other.max) };
                let touching = (0..3).find(|&axis| one.max[axis] == other.min[axis]);
                // Cells with only a common edge or corner have no seam.
                let flat = |axis: usize| (0..3).all(|a| a == axis || bounds.min[a] < bounds.max[a]);
                if let Some(axis) = touching.filter(|&axis| flat(axis)) {
                    seams.push(Seam { cells: [first, second], axis, bounds });
                }
            }
        }
        seams
    }
}

/// Divides a box into the parts below and above a plane.
fn split(bounds: Bounds, axis: usize, at: f32) -> [Bounds; 2] {
    let mut parts = [bounds; 2];
    parts[0].max[axis] = at;
    parts[1].min[axis] = at;
    parts
}

/// Longest axis and the median on it, with points on both sides; None if all points coincide.
fn median(points: &[Vec3]) -> Option<(usize, f32)> {
    let mut best: Option<(f32, usize, f32)> = None;
    for whole in [false, true] {
        for axis in 0..3 {
            let mut values: Vec<f32> = points.iter().map(|point| point[axis]).collect();
            values.sort_unstable_by(f32::total_cmp);
            let strays = if whole { 0 } else { (STRAYS * values.len() as f64) as usize };
            let length = values[values.len() - 1 - strays] - values[strays];
            let middle = values[values.len() / 2];
            // If the lower half coincides, the first value beyond it.
            let at =
                if middle > values[0] { Some(middle) } else { values.iter().copied().find(|&v| v > middle) };
            // Replaces -0 by 0, so that a plane has one representation.
            let at = at.map(|at| at + 0.0);
            if let Some(at) = at.filter(|_| length > best.map_or(0.0, |(longest, ..)| longest)) {
                best = Some((length, axis, at));
            }
        }
        if best.is_some() {
            break;
        }
    }
    best.map(|(_, axis, at)| (axis, at))
}
