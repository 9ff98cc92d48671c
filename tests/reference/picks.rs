//! What is picked at a pixel, the twin of `compose/picks`.

/// Scene and index in it of a Gaussian of the frame, from how many Gaussians each scene has in the frame's indices. Scenes that
/// are not drawn have none.
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
