//! For tests of the barriers: leaving some out, and collecting the hazards.

use super::declared::Hazards;
use super::recorder::Recorder;

impl Recorder {
    /// Whether the barrier that comes now is to be left out; it is counted then, and recorded if only the checker is not
    /// to know of it.
    pub(super) fn omits_barrier(&mut self) -> bool {
        if !self.omitted.contains(&self.barriers) {
            return false;
        }
        self.barriers += 1;
        if self.hazards.as_ref().is_some_and(|hazards| hazards.collected.is_some()) {
            self.record_barrier();
        }
        true
    }

    /// Makes the `index`-th call of [`Recorder::barrier`] (from 0) do nothing. A recording that
    /// collects hazards keeps the barrier on the device and hides it from the checker only.
    pub fn omit_barrier(&mut self, index: u32) {
        self.omitted.push(index);
    }

    /// Collects hazards from the next command on instead of panicking; see [`Recorder::hazards`].
    /// Works even if the context does not check.
    pub fn collect_hazards(&mut self) {
        self.hazards = Some(Hazards { collected: Some(Vec::new()), ..Hazards::default() });
    }

    /// The hazards found since [`Recorder::collect_hazards`].
    pub fn hazards(&self) -> &[String] {
        self.hazards.as_ref().and_then(|h| h.collected.as_deref()).unwrap_or_default()
    }
}
