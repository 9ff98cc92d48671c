//! When to free memory: after pictures that are much larger than the next ones.

/// A picture is much smaller than another with less than 1/MUCH of its pixels.
const MUCH: u64 = 4;
/// After this many much smaller pictures in a row, the large one counts as an exception.
const IN_A_ROW: u32 = 16;

#[derive(Debug, Default)]
pub struct Sizes {
    /// Pixels of the largest picture since memory was freed.
    largest: u64,
    /// Number of much smaller pictures in a row.
    small: u32,
    /// Pixels of the largest of these.
    largest_small: u64,
}

impl Sizes {
    /// Records a picture. True if memory should be freed.
    pub fn note(&mut self, pixels: u64) -> bool {
        if pixels.saturating_mul(MUCH) >= self.largest {
            *self = Self { largest: self.largest.max(pixels), ..Self::default() };
            return false;
        }
        self.small += 1;
        self.largest_small = self.largest_small.max(pixels);
        let exceptional = self.small >= IN_A_ROW;
        if exceptional {
            *self = Self { largest: self.largest_small, ..Self::default() };
        }
        exceptional
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_given_back_after_an_exception_and_not_where_sizes_alternate() {
        let (hd, phone) = (1920 * 1080, 360 * 640);
        let mut sizes = Sizes::default();
        assert!((0..100).all(|_| !sizes.note(hd)), "always the same");
        // Two pages of different sizes take turns.
        assert!((0..100).all(|i| !sizes.note(if i % 2 == 0 { hd } else { phone })));
        assert!(!sizes.note(8192 * 8192));
        let after = (1..=50).filter(|_| sizes.note(hd)).count();
        assert_eq!((after, sizes.largest), (1, hd));
        let when = (1..=50).find(|_| sizes.note(phone));
        assert_eq!((when, sizes.largest), (Some(IN_A_ROW), phone));
    }
}
