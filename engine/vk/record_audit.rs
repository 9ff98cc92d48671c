//! Audit of a recording: copies the output of every command.

use super::buffer::Buffer;
use super::commands::Commands;
use super::hazard::Access;
use super::recorder::{Recorder, Target};
use crate::Result;
use ash::vk;

impl Recorder {
    /// Copies the outputs of a command, if there is an audit.
    pub(super) fn audit<'a>(
        &mut self,
        command: &'static str,
        uses: impl Iterator<Item = (&'a Buffer, Access)>,
    ) {
        let Some(mut audit) = self.audit.take() else { return };
        let written = uses.filter(|(_, access)| access.writes()).map(|(buffer, _)| buffer);
        let copies = audit.snapshot(&self.inner, command, written);
        self.record_barrier();
        for (from, to) in copies {
            let region = vk::BufferCopy::default()
                .src_offset(from.offset())
                .dst_offset(to.offset())
                .size(from.bytes());
            // SAFETY: recording state; ranges of equal size with transfer usage, in buffers that are kept, here or by
            // the audit until they are hashed.
            unsafe { self.inner.device.cmd_copy_buffer(self.raw(), from.raw(), to.raw(), &[region]) }
        }
        self.record_barrier();
        self.audit = Some(audit);
        self.submit_audited();
    }

    /// Submits the recording if it holds many snapshots, hashes them, and continues the recording.
    fn submit_audited(&mut self) {
        if self.audit.as_ref().is_some_and(|audit| audit.is_full())
            && let Err(error) = self.submit_snapshots()
        {
            self.failed.get_or_insert(error);
        }
    }

    fn submit_snapshots(&mut self) -> Result<()> {
        let (Target::Owned(commands), Some(audit)) = (&mut self.commands, &mut self.audit) else {
            return Ok(());
        };
        let pools = commands.pools.clone();
        commands.submit()?;
        commands.wait(self.inner.timeout)?;
        audit.log()?;
        self.commands = Target::Owned(Commands::begin(&pools, audit.submission(), false)?);
        self.bound = vk::Pipeline::null();
        Ok(())
    }
}
