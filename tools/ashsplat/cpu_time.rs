//! Processor time of this process.

use std::fs;

/// User and system time of all living threads so far, seconds: to the nanosecond if the kernel keeps scheduling
/// statistics, else in hundredths of a second. `None` if the system reports neither.
pub fn process_seconds() -> Option<f64> {
    scheduled_seconds().or_else(ticked_seconds)
}

/// First field of /proc/self/task/*/schedstat: nanoseconds on a processor.
fn scheduled_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for task in fs::read_dir("/proc/self/task").ok()? {
        let text = fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<f64>().ok()?;
    }
    (nanoseconds > 0.0).then_some(nanoseconds * 1e-9)
}

fn ticked_seconds() -> Option<f64> {
    /// Linux fixes the unit for user space.
    const TICKS_PER_SECOND: f64 = 100.0;
    let stat = fs::read_to_string("/proc/self/stat").ok()?;
    // The second field is the program's name in parentheses, which may contain anything. Fields are counted after it.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |index: usize| fields.get(index)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / TICKS_PER_SECOND)
}

#[cfg(test)]
mod tests {
    #[test]
    fn work_costs_processor_time() {
        let Some(before) = super::process_seconds() else { return };
        let mut sum = 0.0f64;
        for i in 0..20_000_000 {
            sum += f64::from(i).sqrt();
        }
        assert!(sum > 0.0);
        let spent = super::process_seconds().expect("as before") - before;
        assert!(spent > 0.001, "{spent}");
    }
}
