//! Recorded trainings, and what is foretold of them.

use super::super::TimeLeft;
use ashsplat::trainer::{Preset, StrategyType, TrainSettings};

/// Iteration, Gaussians in it, and processor seconds so far, every hundred iterations of a training and before each change of the
/// Gaussians. Processor time, because the machine did other work too; alone on it wall-clock time is in proportion.
struct Recorded {
    name: &'static str,
    text: &'static str,
    settings: TrainSettings,
}

macro_rules! recorded {
    ($name:literal, $settings:expr) => {
        Recorded {
            name: $name,
            text: include_str!(concat!("../../recorded/", $name, ".csv")),
            settings: $settings,
        }
    };
}

fn recorded() -> Vec<Recorded> {
    let usual = |iterations| TrainSettings { iterations, ..TrainSettings::default() };
    let of_preset = |iterations, preset| TrainSettings { iterations, ..TrainSettings::of_preset(preset) };
    let budget =
        |iterations| TrainSettings { iterations, ..TrainSettings::of_strategy(StrategyType::Budget) };
    let demo = TrainSettings { densify_from_iter: 120, densify_until_iter: 720, ..usual(1200) };
    vec![
        recorded!("photographs_2000", usual(2000)),
        recorded!("photographs_7000", usual(7000)),
        recorded!("small_photographs_11400", usual(11_400)),
        recorded!("demo_1200", demo),
        recorded!("fox_half_reference_1500", usual(1500)),
        recorded!("fox_half_reference_1000", usual(1000)),
        recorded!("fox_quarter_reference_1200", usual(1200)),
        recorded!("fox_half_default_1000", of_preset(1000, Preset::Default)),
        recorded!("fox_quarter_budget_1200", budget(1200)),
    ]
}

fn rows(text: &str) -> Vec<(u32, u32, f64)> {
    let row = |line: &str| {
        let mut fields = line.split(',');
        let mut next = || fields.next().expect("a field");
        let (iteration, gaussians) = (next().parse().expect("a number"), next().parse().expect("a number"));
        (iteration, gaussians, next().parse().expect("seconds"))
    };
    text.lines().map(row).collect()
}

/// From a third of the run on, within a quarter, as soon as the growth is known; before that a lower bound, which holds. The last
/// fiftieth is seconds.
#[test]
fn recorded_trainings_are_foretold() {
    let mut failures = Vec::new();
    for Recorded { name, text, settings } in recorded() {
        let rows = rows(text);
        let total = rows.last().expect("rows").2;
        let mut left = TimeLeft::of(0, &settings);
        let (mut before, mut seen, mut checked, mut known) = (0, 0.0, 0, 0);
        for &(iteration, gaussians, seconds) in &rows {
            let each = (seconds - seen) / f64::from(iteration - before);
            // Kernels are built in the first iteration; the others of the first row cost as those of the second.
            let usual = match before {
                0 => (rows[1].2 - rows[0].2) / f64::from(rows[1].0 - rows[0].0),
                _ => each,
            };
            for step in before + 1..=iteration {
                let cost = if step == 1 { seconds - usual * f64::from(iteration - 1) } else { usual };
                left.step(step, gaussians, cost);
            }
            (before, seen) = (iteration, seconds);
            let really = total - seconds;
            let Some(foretold) = left.after(iteration).filter(|_| really > total / 50.0) else { continue };
            let ratio = foretold.seconds / really;
            let holds = match foretold.at_least {
                true => ratio <= 1.0,
                false => iteration < settings.iterations / 3 || (0.75..=1.25).contains(&ratio),
            };
            if !holds {
                failures.push(format!("{name}, {iteration}: {ratio:.2} of {really:.0} s"));
            }
            known += u32::from(!foretold.at_least);
            checked += 1;
        }
        // The reference grows from iteration 600 on, however short the run is.
        assert!(known >= 2 && known * 5 >= checked, "{name}: {known} of {checked}");
    }
    assert!(failures.is_empty(), "{failures:#?}");
}
