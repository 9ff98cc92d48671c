mod recorded;

use super::growth::Growth;
use super::{Left, TimeLeft};

#[test]
fn what_does_not_grow_is_exact() {
    let mut left = TimeLeft::new(100, 1100, Growth::new(100, 1100, |_| false));
    assert_eq!(left.after(100), None);
    for iteration in 101..=600 {
        // A test now and then, and kernels that are built at first.
        let seconds = if iteration % 100 == 0 || iteration == 101 { 5.0 } else { 0.1 };
        left.step(iteration, 5000, seconds);
    }
    let Left { seconds, at_least } = left.after(600).expect("known");
    assert!((seconds - 50.0).abs() < 1e-6 && !at_least, "{seconds}");
    assert!(left.after(1100).expect("known").seconds.abs() < 1e-6);
}

/// Iterations take 2 ms and 3 µs for each Gaussian; each densification adds 7000, in the iteration after it.
#[test]
fn steady_growth_is_foretold_after_two_densifications() {
    let gaussians = |iteration: u32| 12_000 + 7000 * ((iteration.max(501) - 1) / 100 - 5).min(9);
    let seconds = |iteration| 0.002 + 3e-6 * f64::from(gaussians(iteration));
    let densifies = |iteration: u32| iteration > 500 && iteration.is_multiple_of(100);
    let mut left = TimeLeft::new(0, 1500, Growth::new(0, 1500, densifies));
    let mut known = Vec::new();
    for iteration in 1..=1450 {
        left.step(iteration, gaussians(iteration), seconds(iteration));
        let really: f64 = (iteration + 1..=1500).map(seconds).sum();
        let Some(foretold) = left.after(iteration) else { continue };
        let ratio = foretold.seconds / really;
        // As long as the growth is not known it is said, and is true.
        assert!(if foretold.at_least { ratio <= 1.0 } else { ratio > 0.75 }, "{iteration}: {ratio:.2}");
        assert!(ratio < 1.25, "{iteration}: {ratio:.2}");
        known.extend((!foretold.at_least).then_some(iteration));
    }
    assert_eq!(known.first(), Some(&701));
    assert_eq!(known.len(), 750);
}

#[test]
fn growth_that_is_not_known_is_said() {
    let densifies = |iteration: u32| iteration > 500 && iteration.is_multiple_of(100);
    let mut left = TimeLeft::new(0, 3000, Growth::new(0, 3000, densifies));
    for iteration in 1..=500 {
        left.step(iteration, 1000, 0.01);
    }
    assert!(left.after(500).expect("known").at_least);
    // An eighth of 25 densifications.
    for iteration in 501..=801 {
        assert!(left.after(iteration - 1).expect("known").at_least, "{iteration}");
        left.step(iteration, 1000 + 10 * (iteration - 500), 0.01);
    }
    assert!(!left.after(801).expect("known").at_least);
}

/// What small pictures cost says nothing of whole ones.
#[test]
fn small_pictures_foretell_no_more_than_a_lower_bound() {
    let growth = Growth::new(0, 1000, |_| false);
    let mut left = TimeLeft { small_until: 400, ..TimeLeft::new(0, 1000, growth) };
    let mut foretold = Vec::new();
    for iteration in 1..=500 {
        let seconds = if iteration <= 200 {
            0.01
        } else if iteration <= 400 {
            0.02
        } else {
            0.05
        };
        left.step(iteration, 1000, seconds);
        if [150, 200, 350, 400].contains(&iteration) {
            foretold.push(left.after(iteration).map(|left| left.at_least));
        }
    }
    assert_eq!(foretold, [Some(true), None, Some(true), None]);
    let Left { seconds, at_least } = left.after(500).expect("known");
    assert!((seconds - 25.0).abs() < 1e-9 && !at_least, "{seconds}");
}
