//! `--ab A B`: alternates two settings of specialization constants, on the same machine at the same time.

use super::Arguments;
use super::subject::{Subject, largest_difference, measured};
use super::{open, spec};
use crate::compare::{self, Line};
use crate::traffic::Traffic;
use crate::workload::Scene;
use ashsplat::Result;

/// Measures both and prints B's times over A's.
pub fn run(arguments: &Arguments, settings: &[String], scene: &Scene) -> Result<()> {
    let [a, b] = settings else { return Ok(()) };
    let with = |more: &str| -> Result<_> {
        let mut overrides = arguments.overrides()?;
        overrides.extend(spec::parse_list(more)?);
        Ok(overrides)
    };
    let (with_a, with_b) = (with(a)?, with(b)?);
    let contexts = [open(arguments, &with_a)?, open(arguments, &with_b)?];
    let subject = |index: usize| Subject::new(&contexts[index], scene, arguments);
    let mut subjects = [subject(0)?, subject(1)?];
    for subject in &mut subjects {
        subject.warm_up(arguments.warmup())?;
    }
    let mut iterations = [Vec::new(), Vec::new()];
    for _ in 0..arguments.frames() {
        for (subject, iterations) in subjects.iter_mut().zip(&mut iterations) {
            iterations.push(subject.timed()?);
        }
    }
    let [first, second] = &mut subjects;
    let difference = largest_difference(&first.picture()?, &second.picture()?);
    let measured = iterations.map(measured);
    let mut kernels = [0, 1].map(|i: usize| measured[i].kernels(&Traffic::bound(), None));
    kernels.iter_mut().try_for_each(|kernels| super::only(arguments.kernel.as_deref(), kernels))?;
    let name = arguments.what().name();
    let [wall_a, wall_b] = [0, 1].map(|i: usize| measured[i].wall_ms().times(1e3));
    let mut lines = vec![Line::whole(name, "wall", wall_a, wall_b)];
    if let [Some(a), Some(b)] = [0, 1].map(|i: usize| measured[i].device_ms()) {
        lines.push(Line::whole(name, "device", a.times(1e3), b.times(1e3)));
    }
    lines.extend(compare::kernels(name, &kernels[0], &kernels[1]));
    let both = if arguments.spec.is_empty() {
        String::new()
    } else {
        format!("   both: {}", arguments.spec.join(", "))
    };
    say!("A: {a}   B: {b}{both}   {} iterations each, in turn", arguments.frames());
    say!("{}", compare::table(&lines).trim_end());
    for (name, one, other) in [("A", 0, 1), ("B", 1, 0)] {
        for (kernel, time) in compare::alone(&kernels[one], &kernels[other]) {
            say!("only in {name}: {:.1} µs, {} in '{}'", time.median, kernel.kernel, kernel.scope);
        }
    }
    say!("largest difference of the pictures: {difference}");
    for context in &contexts {
        super::print_messages(context);
        arguments.device.report_validation(context);
    }
    Ok(())
}
