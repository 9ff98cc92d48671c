//! For tests of barriers: omits some, and collects hazards.

use super::declared::Hazards;
use super::recorder::Recorder;

impl Recorder {
    /// True if the test omits the next barrier; counts it. While collecting hazards, still records it on the device.
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

    /// Omits the `index`-th call of [`Recorder::barrier`], counted from 0. A recording that collects hazards keeps the
    /// barrier on the device and hides it from the checker only.
    pub fn omit_barrier(&mut self, index: u32) {
        self.omitted.push(index);
    }

    /// Collects hazards from the next command on, without panics; see [`Recorder::hazards`]. Works even if the context does
    /// not check.
    pub fn collect_hazards(&mut self) {
        self.hazards = Some(Hazards { collected: Some(Vec::new()), ..Hazards::default() });
    }

    /// Returns the hazards found since [`Recorder::collect_hazards`].
    pub fn hazards(&self) -> &[String] {
        self.hazards.as_ref().and_then(|h| h.collected.as_deref()).unwrap_or_default()
    }
}
