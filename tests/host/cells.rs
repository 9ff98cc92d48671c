//! Cells of a scene that is trained in blocks: every position lies in exactly one.

use super::files::assert_says;
use ashsplat::scene::{Bounds, Cells};
use glam::Vec3;
use proptest::prelude::*;

fn holders(cells: &Cells, place: Vec3) -> Vec<usize> {
    (0..cells.bounds().len()).filter(|&cell| cells.bounds()[cell].contains(place)).collect()
}

fn around_borders(cells: &Cells) -> Vec<Vec3> {
    let sides = |axis: usize| {
        let all = cells.bounds().iter().flat_map(move |b| [b.min[axis], b.max[axis]]);
        let finite = all.filter(|side| side.is_finite());
        let mut sides: Vec<f32> = finite.flat_map(|side| [side.next_down(), side, side.next_up()]).collect();
        sides.extend([0.0, -0.0, f32::MAX, f32::MIN, f32::MIN_POSITIVE]);
        sides.sort_unstable_by(f32::total_cmp);
        sides.dedup_by(|a, b| a.to_bits() == b.to_bits());
        sides
    };
    let [xs, ys, zs] = [sides(0), sides(1), sides(2)];
    let pairs = xs.iter().flat_map(|&x| ys.iter().map(move |&y| (x, y)));
    pairs.flat_map(|(x, y)| zs.iter().map(move |&z| Vec3::new(x, y, z))).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(24) })]
    /// On a coarse grid many points share coordinates, so borders run through points.
    #[test]
    fn every_place_is_in_exactly_one_cell(
        grid in prop::collection::vec([-4..4i32, -3..3, -2..2], 1..90),
        scale in 0.01..50f32,
        spare in 0..6usize,
        others in prop::collection::vec([-300f32..300.0, -300f32..300.0, -300f32..300.0], 20),
    ) {
        let points: Vec<[f32; 3]> = grid.iter().map(|p| p.map(|v| v as f32 * scale)).collect();
        let together = points.iter().map(|p| points.iter().filter(|q| *q == p).count()).max().unwrap();
        let max_gaussians = together + spare;
        let cells = Cells::divide(&points, max_gaussians).unwrap();
        let mut counts = vec![0; cells.bounds().len()];
        points.iter().for_each(|&p| counts[cells.at(Vec3::from_array(p)).unwrap()] += 1);
        prop_assert!(counts.iter().all(|&count| (1..=max_gaussians).contains(&count)), "{counts:?} of {max_gaussians}");
        let own = points.iter().chain(&others).map(|&p| Vec3::from_array(p));
        for place in own.chain(around_borders(&cells)) {
            prop_assert_eq!(holders(&cells, place), [cells.at(place).unwrap()], "{}", place);
        }
        // The order of the points does not matter, and the boxes determine the cells.
        let reversed: Vec<[f32; 3]> = points.iter().rev().copied().collect();
        prop_assert_eq!(&Cells::divide(&reversed, max_gaussians).unwrap(), &cells);
        let again = Cells::of(cells.bounds()).unwrap();
        for place in around_borders(&cells) {
            prop_assert_eq!(again.at(place), cells.at(place));
        }
        // A tree with n planes has n + 1 cells.
        prop_assert!(cells.bounds().len() < 2 || cells.seams().len() + 1 >= cells.bounds().len());
    }
}

#[test]
fn what_is_nowhere_is_in_no_cell() {
    let cells = Cells::divide(&[[0.0; 3], [1.0, 0.0, 0.0], [2.0, 5.0, 0.0]], 1).unwrap();
    assert_eq!(cells.bounds().len(), 3);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for axis in 0..3 {
            let mut place = Vec3::ONE;
            place[axis] = bad;
            assert_eq!(cells.at(place), None, "{place}");
            assert!(Cells::divide(&[[0.0; 3], place.to_array()], 1).is_err());
        }
    }
    assert!(holders(&cells, Vec3::new(0.0, f32::NAN, 0.0)).is_empty());
    assert!(Cells::divide(&[], 1).is_err() && Cells::divide(&[[0.0; 3]], 0).is_err());
    let crowd = Cells::divide(&[[1.0, 2.0, 3.0]; 5], 4).unwrap_err().to_string();
    assert_says(&crowd, &["5 Gaussians are at [1, 2, 3]"]);
}

#[test]
fn boxes_that_do_not_divide_space_are_refused() {
    let cells = Cells::divide(&[[0.0; 3], [4.0, 0.0, 0.0], [4.0, 3.0, 0.0], [0.0, 3.0, 1.0]], 1).unwrap();
    let good = cells.bounds().to_vec();
    assert_eq!(good.len(), 4);
    assert!(Cells::of(&[]).is_err() && Cells::of(&good[1..]).is_err());
    assert!(Cells::of(&[&good[..], &good[..1]].concat()).is_err());
    for cell in 0..4 {
        for axis in 0..3 {
            for side in 0..2 {
                let mut bad = good.clone();
                let Bounds { min, max } = &mut bad[cell];
                let value = if side == 0 { &mut min[axis] } else { &mut max[axis] };
                *value = if value.is_finite() { value.next_up() } else { 77.0 };
                assert!(Cells::of(&bad).is_err(), "{bad:?}");
            }
        }
    }
    assert_eq!(Cells::of(&[Cells::EVERYTHING]).unwrap().at(Vec3::MAX), Some(0));
}
