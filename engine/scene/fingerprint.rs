//! A 64-bit hash that distinguishes data. It gives no protection against forgery.

use super::camera::{Camera, PicturePart};
use super::lens::Projection;
use super::shutter::Shutter;

/// Odd, so that the multiplication is invertible and a change of a single word always changes the hash.
const FACTOR: u64 = 0x9E37_79B9_7F4A_7C15;

/// Hash of bytes in the order in which they are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fingerprint(u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Self::new()
    }
}

impl Fingerprint {
    /// Hash of no bytes.
    pub fn new() -> Self {
        Self(FACTOR)
    }

    fn word(&mut self, word: u64) {
        self.0 = (self.0.rotate_left(23) ^ word).wrapping_mul(FACTOR);
    }

    /// Adds the bytes, then their number.
    pub fn add(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        for word in words {
            self.word(u64::from_le_bytes(*word));
        }
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        self.word(u64::from_le_bytes(last));
        self.word(bytes.len() as u64);
    }

    /// Adds all fields of a camera that its projection uses.
    pub fn add_camera(&mut self, camera: &Camera) {
        let Camera { camera_from_world, translation, fx, fy, cx, cy, width, height, .. } = *camera;
        self.add(bytemuck::cast_slice(&camera_from_world.to_cols_array()));
        self.add(bytemuck::cast_slice(&translation.to_array()));
        self.add(bytemuck::cast_slice(&[fx, fy, cx, cy]));
        self.add(bytemuck::cast_slice(&[width, height]));
        if let Some(PicturePart { left, top, whole_width, whole_height }) = camera.part {
            self.add(bytemuck::cast_slice(&[left, top, whole_width, whole_height]));
        }
        if camera.projection != Projection::Perspective {
            self.add(camera.projection.name().as_bytes());
        }
        if camera.projection.is_lens() {
            self.add(bytemuck::cast_slice(&camera.coefficients));
        }
        if let Some(Shutter { readout, turn, shift }) = camera.shutter {
            self.add(readout.name().as_bytes());
            self.add(bytemuck::cast_slice(&[turn.to_array(), shift.to_array()]));
        }
    }

    /// Returns the hash of all bytes added.
    pub fn finish(self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}
