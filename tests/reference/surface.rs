//! A field of distances and the vertices of its mesh, the twins of `surface/*`.

/// Sums of the views' observations of a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Voxel {
    pub distance: f64,
    pub weight: f64,
    pub views: u32,
    pub color: [f64; 3],
    pub color_weight: f64,
}

/// Adds a view: `ahead` is how far the surface lies behind the voxel, `pixels` the voxel's size there.
pub fn integrate(voxel: &mut Voxel, ahead: f64, truncation: f64, pixels: f64, color: [f64; 3]) {
    if ahead < -truncation {
        return;
    }
    let weight = pixels * pixels;
    voxel.distance =
        (voxel.distance * voxel.weight + ahead.min(truncation) * weight) / (voxel.weight + weight);
    voxel.weight += weight;
    voxel.views += 1;
    if ahead <= truncation {
        let sum = voxel.color_weight + weight;
        let mean = |k: usize| (voxel.color[k] * voxel.color_weight + color[k].clamp(0.0, 1.0) * weight) / sum;
        voxel.color = [0, 1, 2].map(mean);
        voxel.color_weight = sum;
    }
}

/// Where the surface crosses the edge between two voxels, as a share of it; `None` if it does not.
pub fn crossing(own: f64, other: f64) -> Option<f64> {
    ((own < 0.0) != (other < 0.0)).then(|| own / (own - other))
}
