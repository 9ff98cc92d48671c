//! Triangles in host memory.

/// A mesh with colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Per vertex: position, world units.
    pub positions: Vec<[f32; 3]>,
    /// Per vertex: colour, display-encoded like the training photographs.
    pub colors: Vec<[u8; 3]>,
    /// Vertices of each triangle, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Removes connected parts of fewer triangles than `min_triangles`, and vertices of no triangle. Returns the number of removed parts.
    pub fn keep_parts(&mut self, min_triangles: usize) -> usize {
        let mut above: Vec<u32> = (0..self.positions.len() as u32).collect();
        for &[a, b, c] in &self.triangles {
            let a = root(&mut above, a);
            for other in [b, c] {
                let other = root(&mut above, other);
                above[other as usize] = a;
            }
        }
        let mut sizes = vec![0; self.positions.len()];
        for triangle in &self.triangles {
            sizes[root(&mut above, triangle[0]) as usize] += 1;
        }
        self.triangles.retain(|triangle| sizes[root(&mut above, triangle[0]) as usize] >= min_triangles);
        self.remove_unused();
        sizes.iter().filter(|&&size| (1..min_triangles).contains(&size)).count()
    }

    /// Removes vertices of no triangle.
    pub(super) fn remove_unused(&mut self) {
        let mut used = vec![false; self.positions.len()];
        self.triangles.as_flattened().iter().for_each(|&vertex| used[vertex as usize] = true);
        let mut kept = 0;
        let places: Vec<u32> = used.iter().map(|&is_used| (kept, kept += u32::from(is_used)).0).collect();
        self.triangles.as_flattened_mut().iter_mut().for_each(|vertex| *vertex = places[*vertex as usize]);
        let mut is_used = used.iter();
        self.positions.retain(|_| *is_used.next().unwrap_or(&false));
        let mut is_used = used.iter();
        self.colors.retain(|_| *is_used.next().unwrap_or(&false));
    }
}

/// Returns the vertex that represents a vertex's part, and shortens the way to it.
fn root(above: &mut [u32], mut vertex: u32) -> u32 {
    while above[vertex as usize] != vertex {
        above[vertex as usize] = above[above[vertex as usize] as usize];
        vertex = above[vertex as usize];
    }
    vertex
}
