//! Axes of charts.

/// Approximate number of marks on an axis.
const MARKS: f64 = 5.0;

/// An axis with marks at 1, 2 or 5 times a power of ten.
pub struct Axis {
    pub low: f64,
    pub high: f64,
    pub step: f64,
}

impl Axis {
    /// An axis that covers `low` to `high`.
    pub fn new(low: f64, high: f64) -> Self {
        let span = (high - low).max(high.abs() * 0.05).max(1e-6);
        let rough = span / MARKS;
        let power = 10f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 5.0, 10.0].map(|n| n * power).into_iter().find(|step| *step >= rough).unwrap_or(rough);
        let ends = ((low / step + 1e-9).floor() * step, (high / step - 1e-9).ceil() * step);
        Self { low: ends.0, high: ends.1.max(ends.0 + step), step }
    }

    /// Position of a value: 0 at the beginning, 1 at the end.
    pub fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// The values at the marks.
    pub fn marks(&self) -> impl Iterator<Item = f64> {
        let (first, last) =
            ((self.low / self.step).ceil() as i64, (self.high / self.step + 1e-6).floor() as i64);
        (first..=last).map(|n| n as f64 * self.step)
    }

    /// A value with as many digits as the axis's marks need.
    pub fn mark(&self, value: f64) -> String {
        let (unit, divisor) = match self.high.abs() {
            high if high >= 2e6 => ("M", 1e6),
            high if high >= 2e3 => ("k", 1e3),
            _ => ("", 1.0),
        };
        let digits = (-(self.step / divisor).log10().floor()).max(0.0) as usize;
        if value == 0.0 { "0".into() } else { format!("{:.*}{unit}", digits, value / divisor) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round() {
        let axis = Axis::new(0.0, 0.23);
        assert_eq!(
            axis.marks().map(|v| axis.mark(v)).collect::<Vec<_>>(),
            ["0", "0.05", "0.10", "0.15", "0.20", "0.25"]
        );
        let axis = Axis::new(17.3, 31.1);
        assert_eq!(axis.marks().map(|v| axis.mark(v)).collect::<Vec<_>>(), ["15", "20", "25", "30", "35"]);
        let axis = Axis::new(0.0, 30_000.0);
        assert_eq!(axis.mark(20_000.0), "20k");
        // A single value, or only zeros.
        assert!(Axis::new(5.0, 5.0).marks().count() >= 2 && Axis::new(0.0, 0.0).marks().count() >= 2);
    }
}
