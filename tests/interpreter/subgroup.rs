//! Subgroup operations over the active lanes, in the order of the lanes.

use std::cell::Cell;

use crate::arithmetic::binary;

/// One word of each lane.
pub(crate) type Row<'a> = &'a [Cell<u32>];

/// A problem, and its lane.
pub(crate) type Problem = (String, Option<u32>);

pub(crate) fn lanes_of(mut active: u128) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = active.trailing_zeros();
        active &= active.wrapping_sub(1);
        (lane < 128).then_some(lane as usize)
    })
}

/// All lanes of a subgroup.
pub(crate) fn all(lanes: usize) -> u128 {
    u128::MAX >> (128 - lanes)
}

/// Elect, All, Any, BroadcastFirst.
pub(crate) fn vote(code: u16, target: Row, value: Row, active: u128) {
    let is_set = |lane: usize| value[lane].get() != 0;
    let first = active.trailing_zeros() as usize;
    for (lane, word) in target.iter().enumerate() {
        word.set(match code {
            333 => u32::from(lane == first),
            334 => u32::from(lanes_of(active).all(is_set)),
            335 => u32::from(lanes_of(active).any(is_set)),
            _ => value[first].get(),
        });
    }
}

/// Ballot: writes four rows of words.
pub(crate) fn ballot(target: Row, value: Row, active: u128) {
    let ballot =
        lanes_of(active).filter(|lane| value[*lane].get() != 0).fold(0, |all, lane| all | 1_u128 << lane);
    for (word, row) in target.chunks(value.len()).enumerate() {
        row.iter().for_each(|lane| lane.set((ballot >> (32 * word)) as u32));
    }
}

/// BallotBitCount (kind: all lanes, lanes up to this one, lanes below), BallotFindLSB, BallotFindMSB.
pub(crate) fn count(code: u16, kind: u8, target: Row, value: Row) {
    let lanes = target.len();
    for (lane, word) in target.iter().enumerate() {
        let words = (0..4).rev().map(|k| u128::from(value[k * lanes + lane].get()));
        let ballot = words.fold(0, |ballot, word| ballot << 32 | word) & all(lanes);
        let below = (1_u128 << lane) - 1;
        word.set(match (code, kind) {
            (343, _) => ballot.trailing_zeros(),
            (344, _) => 127_u32.wrapping_sub(ballot.leading_zeros()),
            (_, 0) => ballot.count_ones(),
            (_, 1) => (ballot & (below | 1 << lane)).count_ones(),
            _ => (ballot & below).count_ones(),
        });
    }
}

/// Broadcast, Shuffle, ShuffleXor, ShuffleUp, ShuffleDown.
pub(crate) fn shuffle(
    code: u16,
    target: Row,
    (value, other): (Row, Row),
    active: u128,
) -> Result<(), Problem> {
    let uniform = lanes_of(active).next().map_or(0, |first| other[first].get());
    for lane in lanes_of(active) {
        let (own, given) = (lane as u32, other[lane].get());
        let from = match code {
            346 => own ^ given,
            347 => own.wrapping_sub(given),
            348 => own.wrapping_add(given),
            _ => given,
        };
        let problem = |text: String| Err((text, Some(own)));
        if code == 337 && given != uniform {
            return problem(format!("broadcasts from lane {given}, and in another lane from {uniform}"));
        }
        if from as usize >= target.len() || active >> from & 1 == 0 {
            return problem(format!("takes a value of lane {from}, which is not active"));
        }
        target[lane].set(value[from as usize].get());
    }
    Ok(())
}

/// Code of the operation on words, and its neutral element.
fn arithmetic(code: u16) -> (u16, u32) {
    match code {
        349 => (128, 0),
        350 => (129, 0),
        351 => (132, 1),
        352 => (133, 1.0_f32.to_bits()),
        353 => (2039, i32::MAX as u32),
        354 => (2038, u32::MAX),
        355 => (2037, f32::INFINITY.to_bits()),
        356 => (2042, i32::MIN as u32),
        357 => (2041, 0),
        358 => (2040, f32::NEG_INFINITY.to_bits()),
        359 => (199, u32::MAX),
        361 => (198, 0),
        362 => (167, 1),
        // BitwiseOr, LogicalOr; LogicalXor was refused before.
        _ => (197, 0),
    }
}

/// Sums, products, minima and maxima. kind: over all active lanes, over those up to this one, over those below.
pub(crate) fn reduce(code: u16, kind: u8, target: Row, value: Row, active: u128) {
    let (code, neutral) = arithmetic(code);
    let mut sum = neutral;
    for lane in lanes_of(active) {
        let before = sum;
        sum = binary(code, [sum, value[lane].get()]).unwrap_or(sum);
        target[lane].set(if kind == 1 { sum } else { before });
    }
    if kind == 0 {
        lanes_of(active).for_each(|lane| target[lane].set(sum));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(words: impl IntoIterator<Item = u32>) -> Vec<Cell<u32>> {
        words.into_iter().map(Cell::new).collect()
    }

    fn words(row: Row) -> Vec<u32> {
        row.iter().map(Cell::get).collect()
    }

    #[test]
    fn ballots_have_all_lanes() {
        for lanes in [4, 32, 64, 128] {
            let target = row(vec![7; 4 * lanes]);
            let value = row((0..lanes as u32).map(|lane| u32::from(lane % 3 == 0)));
            let but_first = all(lanes) & !1;
            ballot(&target, &value, but_first);
            let counts = row(vec![0; lanes]);
            count(342, 0, &counts, &target);
            let set = (1..lanes).filter(|lane| lane % 3 == 0).count() as u32;
            assert_eq!(counts[0].get(), set, "{lanes}");
            count(342, 2, &counts, &target);
            assert_eq!(counts[lanes - 1].get(), (1..lanes - 1).filter(|lane| lane % 3 == 0).count() as u32);
            count(343, 0, &counts, &target);
            assert_eq!(counts[0].get(), 3);
            count(344, 0, &counts, &target);
            assert_eq!(counts[0].get(), (lanes as u32 - 1) / 3 * 3);
        }
    }

    #[test]
    fn sums_are_over_active_lanes() {
        let value = row([1, 2, 3, 4]);
        let sums = |kind| {
            let target = row([0; 4]);
            reduce(349, kind, &target, &value, 0b1101);
            words(&target)
        };
        assert_eq!([sums(0), sums(1), sums(2)], [[8, 0, 8, 8], [1, 0, 4, 8], [0, 0, 1, 4]]);
    }

    #[test]
    fn inactive_lanes_give_nothing() {
        let (value, target) = (row([10, 11, 12, 13]), row([0; 4]));
        let from = |code, lanes: [u32; 4], active| shuffle(code, &target, (&value, &row(lanes)), active);
        assert!(from(346, [1; 4], 0b1111).is_ok());
        assert_eq!(words(&target), [11, 10, 13, 12]);
        assert_eq!(from(346, [1; 4], 0b0111).expect_err("lane 3 sleeps").1, Some(2));
        assert_eq!(from(345, [0, 1, 2, 4], 0b1111).expect_err("no lane 4").1, Some(3));
        assert_eq!(from(337, [0, 1, 0, 0], 0b1111).expect_err("not uniform").1, Some(1));
    }
}
