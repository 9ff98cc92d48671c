//! Counts the steps of readers, for tests of how their cost grows. Does nothing in other builds.

use std::io::{self, Read, Seek, SeekFrom};

/// Counts one step: a node, a name, a row, a folder that is searched.
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

/// A reader that counts a step for each byte.
pub(crate) struct Counted<R>(pub(crate) R);

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.0.read(bytes)?;
        steps(read);
        Ok(read)
    }
}

impl<R: Seek> Seek for Counted<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

#[cfg(test)]
pub(crate) mod counter {
    pub(crate) static STEPS: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
}
