//! Fewer triangles: edges are collapsed, least quadric error first (Garland and Heckbert 1997).

use super::mesh::Mesh;
use crate::error::Result;
use glam::{DMat3, DMat4, DVec3, Vec3};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Weight of the planes that hold borders in place, relative to those of triangles.
const BORDER_WEIGHT: f64 = 100.0;
/// Smallest cosine between a triangle's normals before and after a collapse.
const LEAST_TURN_COSINE: f64 = 0.2;
/// Share of a quadric's trace that draws the new vertex to the edge's middle, where planes leave it undetermined.
const MIDDLE_WEIGHT: f64 = 1e-4;
/// Number of candidates between two questions whether to stop.
const STOP_INTERVAL: usize = 4096;

/// Quadric of the plane through a point, weighted by the normal's length: h·Qh is the weighted squared distance of h = (x, 1).
fn quadric_of(normal: DVec3, point: DVec3) -> DMat4 {
    let unit = normal.normalize_or_zero();
    let plane = unit.extend(-unit.dot(point));
    let weighted = normal.length() * plane;
    DMat4::from_cols(weighted * plane.x, weighted * plane.y, weighted * plane.z, weighted * plane.w)
}

/// An edge to collapse, by its error's bits, which order as the error, then its vertices, then the sum of their changes.
type Candidate = Reverse<(u64, [u32; 2], u32)>;

struct Simplification<'a> {
    mesh: &'a mut Mesh,
    /// Per vertex: sum over its triangles.
    quadrics: Vec<DMat4>,
    /// Per vertex: its triangles.
    triangles_of: Vec<Vec<u32>>,
    /// Per vertex: number of changes, by which candidates know that they are outdated.
    changes: Vec<u32>,
    heap: BinaryHeap<Candidate>,
}

impl Mesh {
    /// Collapses edges until at most `triangles` are left, or no edge is left whose collapse keeps the surface's topology and parts
    /// and turns no triangle over. Borders keep their place. Removes vertices of no triangle. The same mesh gives the same bits.
    ///
    /// # Errors
    /// Those of `check`, which is called now and then, and ends the work with an error.
    pub fn simplify(&mut self, triangles: usize, check: &mut dyn FnMut() -> Result<()>) -> Result<()> {
        if self.triangles.len() <= triangles {
            return Ok(());
        }
        let done = Simplification::new(self).run(triangles, check);
        self.triangles.retain(|[a, b, _]| a != b);
        self.remove_unused();
        done
    }
}

impl<'a> Simplification<'a> {
    fn new(mesh: &'a mut Mesh) -> Self {
        let vertices = mesh.positions.len();
        let (quadrics, triangles_of) = (vec![DMat4::ZERO; vertices], vec![Vec::new(); vertices]);
        let (changes, heap) = (vec![0; vertices], BinaryHeap::new());
        let mut work = Self { mesh, quadrics, triangles_of, changes, heap };
        for (index, triangle) in work.mesh.triangles.iter().enumerate() {
            triangle.iter().for_each(|&vertex| work.triangles_of[vertex as usize].push(index as u32));
        }
        for index in 0..work.mesh.triangles.len() {
            let triangle = work.mesh.triangles[index];
            let corners = triangle.map(|vertex| work.at(vertex));
            let normal = cross(corners);
            let own = quadric_of(normal, corners[0]);
            triangle.iter().for_each(|&vertex| work.quadrics[vertex as usize] += own);
            for (from, to) in [(0, 1), (1, 2), (2, 0)] {
                let edge = [triangle[from], triangle[to]];
                if work.shared(edge).count() == 1 {
                    let along = corners[to] - corners[from];
                    let outward = BORDER_WEIGHT * along.length() * along.cross(normal.normalize_or_zero());
                    let own = quadric_of(outward, corners[from]);
                    edge.iter().for_each(|&vertex| work.quadrics[vertex as usize] += own);
                }
            }
        }
        work
    }

    /// Collapses edges until at most `triangles` are left. Tries all edges again, until none can be collapsed: a refused edge may
    /// be free once its neighbours have changed.
    fn run(mut self, triangles: usize, check: &mut dyn FnMut() -> Result<()>) -> Result<()> {
        let (mut left, mut before) = (self.mesh.triangles.len(), usize::MAX);
        while left > triangles && left < before {
            before = left;
            for vertex in 0..self.mesh.positions.len() as u32 {
                self.push_edges(vertex, |other| other > vertex);
            }
            let mut tried = 0;
            while left > triangles
                && let Some(Reverse((_, edge, changes))) = self.heap.pop()
            {
                if tried % STOP_INTERVAL == 0 {
                    check()?;
                }
                tried += 1;
                if self.changes_of(edge) == changes {
                    left -= self.collapse(edge);
                }
            }
        }
        Ok(())
    }

    fn at(&self, vertex: u32) -> DVec3 {
        Vec3::from_array(self.mesh.positions[vertex as usize]).as_dvec3()
    }

    fn changes_of(&self, [a, b]: [u32; 2]) -> u32 {
        self.changes[a as usize] + self.changes[b as usize]
    }

    /// Triangles of both ends of an edge.
    fn shared(&self, [a, b]: [u32; 2]) -> impl Iterator<Item = u32> {
        let own = self.triangles_of[a as usize].iter().copied();
        own.filter(move |&triangle| self.mesh.triangles[triangle as usize].contains(&b))
    }

    /// Vertices that share an edge with a vertex, each once, in order; and whether the vertex lies on a border.
    fn neighbours(&self, vertex: u32) -> (Vec<u32>, bool) {
        let triangles =
            self.triangles_of[vertex as usize].iter().map(|&triangle| self.mesh.triangles[triangle as usize]);
        let mut all: Vec<u32> = triangles.flatten().filter(|&other| other != vertex).collect();
        all.sort_unstable();
        let is_border = all.chunk_by(|a, b| a == b).any(|edge| edge.len() == 1);
        all.dedup();
        (all, is_border)
    }

    /// Place of the vertex that replaces an edge.
    fn target(&self, [a, b]: [u32; 2]) -> (DVec3, f64) {
        let quadric = self.quadrics[a as usize] + self.quadrics[b as usize];
        let (own, middle) = (DMat3::from_mat4(quadric), self.at(a).midpoint(self.at(b)));
        let weight = MIDDLE_WEIGHT * own.diagonal().element_sum();
        let pulled = own + DMat3::from_diagonal(DVec3::splat(weight));
        let solved = pulled.inverse() * (weight * middle - quadric.w_axis.truncate());
        let at = if solved.is_finite() { solved } else { middle };
        (at, at.extend(1.0).dot(quadric * at.extend(1.0)))
    }

    fn push_edges(&mut self, vertex: u32, chosen: impl Fn(u32) -> bool) {
        for other in self.neighbours(vertex).0 {
            if chosen(other) {
                let edge = [vertex.min(other), vertex.max(other)];
                let error = self.target(edge).1;
                if error.is_finite() {
                    self.heap.push(Reverse((error.max(0.0).to_bits(), edge, self.changes_of(edge))));
                }
            }
        }
    }

    /// Replaces an edge by a vertex, unless the surface would change its topology, lose a part or turn over. Returns the number of
    /// removed triangles.
    fn collapse(&mut self, edge @ [a, b]: [u32; 2]) -> usize {
        let removed: Vec<u32> = self.shared(edge).collect();
        let ((of_a, a_border), (of_b, b_border)) = (self.neighbours(a), self.neighbours(b));
        let common = of_a.iter().filter(|other| of_b.binary_search(other).is_ok()).count();
        let joins_borders = a_border && b_border && removed.len() != 1;
        let changes_topology = !(1..=2).contains(&removed.len()) || common != removed.len() || joins_borders;
        let to = self.target(edge).0;
        if changes_topology || self.isolates(edge, &removed) || self.flips(edge, to) {
            return 0;
        }
        let [from_a, from_b] = edge.map(|vertex| to.distance(self.at(vertex)));
        let share = if from_a > 0.0 { from_a / (from_a + from_b) } else { 0.0 };
        let [own, other] = edge.map(|vertex| self.mesh.colors[vertex as usize].map(f64::from));
        let blended = |k: usize| (own[k] + share * (other[k] - own[k])).round() as u8;
        self.mesh.colors[a as usize] = std::array::from_fn(blended);
        self.mesh.positions[a as usize] = to.as_vec3().to_array();
        let of_b = self.quadrics[b as usize];
        self.quadrics[a as usize] += of_b;
        for &triangle in &removed {
            for vertex in std::mem::take(&mut self.mesh.triangles[triangle as usize]) {
                self.triangles_of[vertex as usize].retain(|&other| other != triangle);
            }
        }
        for triangle in std::mem::take(&mut self.triangles_of[b as usize]) {
            let corners = &mut self.mesh.triangles[triangle as usize];
            *corners = corners.map(|corner| if corner == b { a } else { corner });
            self.triangles_of[a as usize].push(triangle);
        }
        edge.into_iter().for_each(|vertex| self.changes[vertex as usize] += 1);
        self.push_edges(a, |_| true);
        removed.len()
    }

    /// True if the new vertex, or a corner opposite the edge, would have no triangle without the removed ones.
    fn isolates(&self, [a, b]: [u32; 2], removed: &[u32]) -> bool {
        let left = |vertex: u32| self.triangles_of[vertex as usize].len() - removed.len();
        let corners = removed.iter().flat_map(|&triangle| self.mesh.triangles[triangle as usize]);
        let mut opposite = corners.filter(|corner| ![a, b].contains(corner));
        left(a) + left(b) == 0 || opposite.any(|corner| self.triangles_of[corner as usize].len() == 1)
    }

    /// True if a collapse to a place turns a triangle over, or lays two onto each other.
    fn flips(&self, [a, b]: [u32; 2], to: DVec3) -> bool {
        let mut others = Vec::new();
        for &triangle in self.triangles_of[a as usize].iter().chain(&self.triangles_of[b as usize]) {
            let triangle = self.mesh.triangles[triangle as usize];
            if triangle.contains(&a) && triangle.contains(&b) {
                continue;
            }
            let before = cross(triangle.map(|corner| self.at(corner)));
            let after =
                cross(triangle.map(|corner| if [a, b].contains(&corner) { to } else { self.at(corner) }));
            let cosine = before.dot(after) / (before.length() * after.length());
            // False for the NaN of a triangle without an area.
            let keeps_side = cosine >= LEAST_TURN_COSINE;
            if !keeps_side {
                return true;
            }
            let mut moved = triangle.map(|corner| if corner == b { a } else { corner });
            moved.sort_unstable();
            others.push(moved);
        }
        others.sort_unstable();
        others.windows(2).any(|pair| pair[0] == pair[1])
    }
}

/// Twice the area of a triangle, along its normal.
fn cross([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}
