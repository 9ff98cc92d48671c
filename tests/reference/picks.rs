//! The Gaussian picked at a pixel, the twin of `compose/picks`.

/// Scene of a frame's Gaussian and its index in the scene. `counts`: number of Gaussians of each scene in the
/// frame's indices; 0 if the scene is not drawn.
pub fn scene_of(gaussian: u32, counts: &[u32]) -> [u32; 2] {
    let mut left = gaussian;
    for (scene, &count) in counts.iter().enumerate() {
        if left < count {
            return [left, scene as u32];
        }
        left -= count;
    }
    panic!("no scene has Gaussian {gaussian}");
}
