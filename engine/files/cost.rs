//! Counts the steps of readers, for tests of how their cost grows. Does nothing in other builds.

/// Counts one step: a file that is opened, a node, a name, a row, a folder that is searched.
pub(crate) fn step() {
    steps(1);
}

/// Counts `count` steps, such as the bytes or values that were read.
pub(crate) fn steps(count: usize) {
    #[cfg(test)]
    counter::STEPS.fetch_add(count as u64, std::sync::atomic::Ordering::Relaxed);
    #[cfg(not(test))]
    let _ = count;
}

#[cfg(test)]
pub(crate) mod counter {
    pub(crate) static STEPS: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
}
