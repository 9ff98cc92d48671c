//! Fewer triangles: edges are collapsed, least quadric error first (Garland and Heckbert 1997).

use super::mesh::Mesh;
use glam::{DMat3, DMat4, DVec3, Vec3};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Weight of the planes that hold borders in place, relative to those of triangles.
const BORDER_WEIGHT: f64 = 100.0;
/// Smallest cosine between a triangle's normals before and after a collapse.
const LEAST_TURN_COSINE: f64 = 0.2;
/// Share of a quadric's trace that draws the new vertex to the edge's middle, where planes leave it undetermined.
const MIDDLE_WEIGHT: f64 = 1e-4;

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
    around: Vec<Vec<u32>>,
    /// Per vertex: number of changes, by which candidates know that they are outdated.
    changes: Vec<u32>,
    heap: BinaryHeap<Candidate>,
}

impl Mesh {
    /// Collapses edges until at most `triangles` are left, or no edge is left that keeps the surface's topology and turns no triangle
    /// over. Borders keep their place. Removes vertices of no triangle. The same mesh gives the same bits.
    pub fn simplify(&mut self, triangles: usize) {
        let mut left = self.triangles.len();
        if left <= triangles {
            return;
        }
        let mut work = Simplification::new(self);
        while left > triangles
            && let Some(Reverse((_, edge, changes))) = work.heap.pop()
        {
            if work.changes_of(edge) == changes {
                left -= work.collapse(edge);
            }
        }
        self.triangles.retain(|[a, b, _]| a != b);
        self.remove_unused();
    }
}

impl<'a> Simplification<'a> {
    fn new(mesh: &'a mut Mesh) -> Self {
        let vertices = mesh.positions.len();
        let (quadrics, around) = (vec![DMat4::ZERO; vertices], vec![Vec::new(); vertices]);
        let mut work = Self { mesh, quadrics, around, changes: vec![0; vertices], heap: BinaryHeap::new() };
        for (index, triangle) in work.mesh.triangles.iter().enumerate() {
            triangle.iter().for_each(|&vertex| work.around[vertex as usize].push(index as u32));
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
        for vertex in 0..vertices as u32 {
            work.push_edges(vertex, |other| other > vertex);
        }
        work
    }

    fn at(&self, vertex: u32) -> DVec3 {
        Vec3::from_array(self.mesh.positions[vertex as usize]).as_dvec3()
    }

    fn changes_of(&self, [a, b]: [u32; 2]) -> u32 {
        self.changes[a as usize] + self.changes[b as usize]
    }

    /// Triangles of both ends of an edge.
    fn shared(&self, [a, b]: [u32; 2]) -> impl Iterator<Item = u32> {
        let own = self.around[a as usize].iter().copied();
        own.filter(move |&triangle| self.mesh.triangles[triangle as usize].contains(&b))
    }

    /// Vertices that share an edge with a vertex, each once, in order; and whether the vertex lies on a border.
    fn neighbours(&self, vertex: u32) -> (Vec<u32>, bool) {
        let triangles =
            self.around[vertex as usize].iter().map(|&triangle| self.mesh.triangles[triangle as usize]);
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
        (at, at.extend(1.0).dot(quadric * at.extend(1.0)).max(0.0))
    }

    fn push_edges(&mut self, vertex: u32, chosen: impl Fn(u32) -> bool) {
        for other in self.neighbours(vertex).0 {
            if chosen(other) {
                let edge = [vertex.min(other), vertex.max(other)];
                self.heap.push(Reverse((self.target(edge).1.to_bits(), edge, self.changes_of(edge))));
            }
        }
    }

    /// Replaces an edge by a vertex, unless the surface would change its topology or turn over. Returns the number of removed triangles.
    fn collapse(&mut self, edge @ [a, b]: [u32; 2]) -> usize {
        let removed: Vec<u32> = self.shared(edge).collect();
        let ((of_a, a_border), (of_b, b_border)) = (self.neighbours(a), self.neighbours(b));
        let common = of_a.iter().filter(|other| of_b.binary_search(other).is_ok()).count();
        let across = a_border && b_border && removed.len() != 1;
        let to = self.target(edge).0;
        if !(1..=2).contains(&removed.len()) || common != removed.len() || across || self.turns(edge, to) {
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
                self.around[vertex as usize].retain(|&other| other != triangle);
            }
        }
        for triangle in std::mem::take(&mut self.around[b as usize]) {
            let corners = &mut self.mesh.triangles[triangle as usize];
            *corners = corners.map(|corner| if corner == b { a } else { corner });
            self.around[a as usize].push(triangle);
        }
        edge.into_iter().for_each(|vertex| self.changes[vertex as usize] += 1);
        self.push_edges(a, |_| true);
        removed.len()
    }

    /// True if a collapse to a place turns a triangle over, or lays two onto each other.
    fn turns(&self, [a, b]: [u32; 2], to: DVec3) -> bool {
        let mut others = Vec::new();
        for &triangle in self.around[a as usize].iter().chain(&self.around[b as usize]) {
            let triangle = self.mesh.triangles[triangle as usize];
            if triangle.contains(&a) && triangle.contains(&b) {
                continue;
            }
            let before = cross(triangle.map(|corner| self.at(corner)));
            let after =
                cross(triangle.map(|corner| if [a, b].contains(&corner) { to } else { self.at(corner) }));
            let cosine = before.dot(after) / (before.length() * after.length());
            if cosine < LEAST_TURN_COSINE || after == DVec3::ZERO {
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
