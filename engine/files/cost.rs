//! Counts the steps of readers, for the tests of how their cost grows. Does nothing in other builds.

/// One step: a node, a name, a look at a folder.
pub(crate) fn step() {
    #[cfg(test)]
    counter::STEPS.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
}

#[cfg(test)]
pub(crate) mod counter {
    /// All steps of the process so far.
    pub(crate) static STEPS: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
}
