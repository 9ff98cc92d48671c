//! Counts Gaussians that are usable but have implausible values.

use ashsplat::kernels::constants::QUAT_NORM_MIN;
use ashsplat::scene::Gaussians;

/// Share of a typical Gaussian's size at which steps of positions are coarse: pictures lose about 6 dB.
pub(super) const COARSE: f64 = 0.2;

/// Number of Gaussians with implausible values in a file.
#[derive(Default)]
pub(super) struct Doubtful {
    count: u64,
    without_rotation: u64,
    coarse: u64,
    /// Logarithmic sums over the Gaussians with coarse positions.
    log_steps: f64,
    log_sizes: f64,
}

impl Doubtful {
    /// Counts the next block's implausible values. A quaternion of zeros becomes the identity, so that a similarity
    /// rotates it too.
    pub(super) fn look_through(&mut self, block: &mut Gaussians) {
        for quat in &mut block.quats {
            if quat.iter().map(|q| q * q).sum::<f32>().sqrt() <= QUAT_NORM_MIN {
                *quat = [1.0, 0.0, 0.0, 0.0];
                self.without_rotation += 1;
            }
        }
        for (mean, [x, y, z]) in block.means.iter().zip(&block.log_scales) {
            let farthest = mean.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
            // The next lower power of two has the same steps.
            let power = f32::from_bits(farthest.to_bits() & f32::INFINITY.to_bits());
            let step = f64::from(power) * f64::from(f32::EPSILON);
            let log_size = x.max(*y).max(*z);
            // A size of 0 cannot be compared with.
            if log_size > f32::MIN_POSITIVE.ln() && step > COARSE * f64::from(log_size).exp() {
                self.coarse += 1;
                self.log_steps += step.ln();
                self.log_sizes += f64::from(log_size);
            }
        }
        self.count += block.len() as u64;
    }

    /// One warning per kind.
    pub(super) fn lines(&self) -> Vec<String> {
        let (count, mut lines) = (self.count, Vec::new());
        if self.without_rotation > 0 {
            lines.push(format!(
                "{} of {count} Gaussians have a quaternion of zeros and are used without rotation",
                self.without_rotation
            ));
        }
        if 2 * self.coarse > count {
            let [step, size] =
                [self.log_steps, self.log_sizes].map(|sum| short((sum / self.coarse as f64).exp()));
            lines.push(format!(
                "positions are rounded to steps of about {step} (a typical size is {size}), because the scene lies far from its origin: \
                 export doubles, or move it there before it is saved"
            ));
        }
        lines
    }
}

/// A positive number with two significant digits, or with all digits before the decimal point.
pub(super) fn short(value: f64) -> String {
    let digits = (1.0 - value.log10().floor()).clamp(0.0, 40.0) as usize;
    format!("{value:.digits$}")
}
