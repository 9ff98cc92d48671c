//! Triangles of each case of marching cubes.
//!
//! The surface cuts the contour of a cube's faces into loops. On each face every run of corners behind the surface is cut off on its own,
//! so that both cubes of a face agree, and meshes have no holes.

use crate::kernels::constants::CUBE_WORDS;

/// Corners of a face in order around its axis, as offsets along the next axis and the one after it.
const AROUND: [[u32; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];

/// The edge between two corners that differ along one axis: the smaller corner, and 8 times the axis.
fn edge(a: u32, b: u32) -> usize {
    (a.min(b) + 8 * (a ^ b).trailing_zeros()) as usize
}

/// Returns the words of each case, a bit for each corner behind the surface: number of triangles, then each triangle's edges,
/// five bits each.
pub fn cube_cases() -> Vec<[u32; CUBE_WORDS as usize]> {
    (0..256).map(case).collect()
}

fn case(inside: u32) -> [u32; CUBE_WORDS as usize] {
    // For each edge, the next edge of its contour.
    let mut next = [None; 24];
    for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
        let mut corners = AROUND.map(|[u, v]| side << axis | u << ((axis + 1) % 3) | v << ((axis + 2) % 3));
        // Counterclockwise, seen from outside the cube.
        if side == 0 {
            corners.reverse();
        }
        let is_inside = |k: usize| inside >> corners[k % 4] & 1 != 0;
        for begin in (0..4).filter(|&k| !is_inside(k) && is_inside(k + 1)) {
            let Some(end) = (begin + 1..begin + 4).find(|&k| !is_inside(k + 1)) else { continue };
            let crossing = |k: usize| edge(corners[k % 4], corners[(k + 1) % 4]);
            next[crossing(begin)] = Some(crossing(end));
        }
    }
    let (mut words, mut count) = ([0; CUBE_WORDS as usize], 0);
    while let Some(first) = next.iter().position(Option::is_some) {
        let mut corners = vec![first];
        while let Some(edge) = next[corners[corners.len() - 1]].take().filter(|edge| *edge != first) {
            corners.push(edge);
        }
        for pair in corners[1..].windows(2) {
            count += 1;
            words[count] = (first | pair[0] << 5 | pair[1] << 10) as u32;
        }
    }
    words[0] = count as u32;
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each edge that the surface crosses is a corner of some triangle, and no other edge is.
    #[test]
    fn triangles_have_their_corners_on_the_crossed_edges() {
        for (inside, words) in cube_cases().into_iter().enumerate() {
            let triangles = &words[1..=words[0] as usize];
            let used = triangles.iter().flat_map(|word| [0, 5, 10].map(|shift| word >> shift & 31));
            let used: std::collections::BTreeSet<u32> = used.collect();
            let pairs = (0..8u32).flat_map(|a| (0..3).map(move |axis| (a, a | 1 << axis)));
            let is_crossed = |&(a, b): &(u32, u32)| a != b && (inside >> a ^ inside >> b) & 1 != 0;
            let crossed = pairs.filter(is_crossed).map(|(a, b)| edge(a, b) as u32);
            assert_eq!(used, crossed.collect(), "case {inside:08b}");
        }
    }
}
