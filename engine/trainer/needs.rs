//! Peak counts of the frames of a training.

/// Peak counts of the frames so far: see [`super::Room`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Needs {
    pub visible: u32,
    /// (tile, Gaussian) pairs.
    pub instances: u32,
}

impl Needs {
    pub fn max(self, other: Self) -> Self {
        Self { visible: self.visible.max(other.visible), instances: self.instances.max(other.instances) }
    }

    /// Peak counts to keep after a densification from `before` to `rows` Gaussians: the same per Gaussian, less a twentieth.
    /// Frames after an opacity reset have few instances for a while, then as many as before.
    pub fn remembered(self, before: u32, rows: u32) -> Self {
        let scaled = |most: u32| {
            let per_gaussian = u64::from(most) * u64::from(rows) / u64::from(before.max(1));
            (per_gaussian * 19 / 20).min(u32::MAX.into()) as u32
        };
        Self { visible: scaled(self.visible), instances: scaled(self.instances) }
    }
}

#[cfg(test)]
mod tests {
    use super::Needs;

    #[test]
    fn what_frames_needed_before_a_reset_is_remembered_for_a_while() {
        // Five densifications while opacities recover lose a twentieth each: three quarters remain.
        let (mut most, mut rows) = (Needs { visible: 50_000, instances: 1_000_000 }, 100_000);
        for _ in 0..5 {
            most = most.remembered(rows, rows / 20 * 21);
            rows = rows / 20 * 21;
        }
        for (most, range) in [(most.instances, 7.5..8.0), (most.visible, 0.375..0.4)] {
            let per_gaussian = f64::from(most) / f64::from(rows);
            assert!(range.contains(&per_gaussian), "{per_gaussian}");
        }
        let [least, largest] = [7, u32::MAX].map(|n| Needs { visible: n, instances: n });
        assert_eq!(largest.remembered(1, 2), largest);
        assert_eq!(least.remembered(0, 0), Needs::default());
    }
}
