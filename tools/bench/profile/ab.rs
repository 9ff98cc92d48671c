//! `--ab A B`: alternates two settings of specialization constants, on the same machine at the same time.

use super::{Arguments, largest_difference, open, silent_profile, spec};
use crate::compare::{self, Row};
use crate::frames::{Plan, PlannedWork};
use crate::measure::Measured;
use crate::traffic::Traffic;
use ashsplat::Result;

/// Measures both and prints B's times over A's.
pub fn run(arguments: &Arguments, settings: &[String], plan: &Plan) -> Result<()> {
    let [a, b] = settings else { return Ok(()) };
    let with = |more: &str| -> Result<_> {
        let mut overrides = arguments.overrides()?;
        overrides.extend(spec::parse_list(more)?);
        Ok(overrides)
    };
    let (with_a, with_b) = (with(a)?, with(b)?);
    let contexts = [open(arguments, &with_a)?, open(arguments, &with_b)?];
    let mut planned = [PlannedWork::new(&contexts[0], plan)?, PlannedWork::new(&contexts[1], plan)?];
    let profiles = contexts.each_ref().map(silent_profile);
    for planned in &mut planned {
        planned.warm_up(arguments.warmup())?;
    }
    let mut iterations = [Vec::new(), Vec::new()];
    for _ in 0..arguments.frames() {
        for index in [0, 1] {
            iterations[index].push(planned[index].timed(&profiles[index])?);
        }
    }
    let [first, second] = &mut planned;
    let difference = largest_difference(&first.picture()?, &second.picture()?);
    let measured = iterations.map(|iterations| Measured { iterations, ..Measured::default() });
    let mut kernels = [0, 1].map(|i: usize| measured[i].kernels(&Traffic::bound(), None));
    kernels.iter_mut().try_for_each(|kernels| super::only(arguments.kernel.as_deref(), kernels))?;
    let name = arguments.what().name();
    let [wall_a, wall_b] = [0, 1].map(|i: usize| measured[i].wall_ms().times(1e3));
    let mut lines = vec![Row::whole(name, "wall", wall_a, wall_b)];
    if let [Some(a), Some(b)] = [0, 1].map(|i: usize| measured[i].device_ms()) {
        lines.push(Row::whole(name, "device", a.times(1e3), b.times(1e3)));
    }
    lines.extend(compare::kernels(name, &kernels[0], &kernels[1]));
    let both = if arguments.spec.is_empty() {
        String::new()
    } else {
        format!("   both: {}", arguments.spec.join(", "))
    };
    outln!("A: {a}   B: {b}{both}   {} iterations each, in turn", arguments.frames());
    outln!("{}", compare::table(&lines).trim_end());
    for (name, one, other) in [("A", 0, 1), ("B", 1, 0)] {
        for (kernel, time) in compare::alone(&kernels[one], &kernels[other]) {
            outln!("only in {name}: {:.1} µs, {} in '{}'", time.median, kernel.kernel, kernel.scope);
        }
    }
    outln!("largest difference of the pictures: {difference}");
    for context in &contexts {
        super::print_messages(context);
        arguments.device.report_validation(context);
    }
    Ok(())
}
