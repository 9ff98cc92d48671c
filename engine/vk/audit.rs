//! The opt-in audit of a context: a hash of the output of every command. Two audited runs of the same work
//! show which command was the first with different bits.
//!
//! Each command is surrounded by barriers and followed by a copy of its output. So an audited recording is
//! slow and hides races between commands. It is submitted in pieces, so that only a few copies exist at a
//! time. New device memory is cleared, so that bytes that no command writes are equal too.

use super::binding::Access;
use super::buffer::Buffer;
use super::context::{Context, Inner};
use super::memory::MemoryKind;
use super::recorder::{Recorder, Target};
use super::submit;
use crate::fingerprint::Fingerprint;
use crate::{Error, Result};
use ash::vk;
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes of snapshots after which a recording is submitted. A single snapshot may be larger.
const MOST_BYTES: u64 = 64 << 20;

/// While it exists, the output of every command of its context is hashed.
pub struct Audit {
    log: Arc<Log>,
}

/// A buffer that a command wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct AuditRecord {
    /// The label of the submission.
    pub submission: String,
    /// Index of the command in the submission.
    pub command: u32,
    /// The kernel's name, or "fill", "copy" or "update".
    pub kernel: &'static str,
    /// The buffer's name.
    pub buffer: &'static str,
    /// Hash of the whole buffer after the command.
    pub hash: u64,
}

#[derive(Default)]
pub(super) struct Log(Mutex<Vec<AuditRecord>>);

/// The outputs of a recording's commands.
pub(super) struct Commands {
    log: Arc<Log>,
    submission: String,
    commands: u32,
    snapshots: Vec<(AuditRecord, Buffer)>,
    /// Bytes of the snapshots.
    bytes: u64,
    failure: Option<Error>,
}

impl Commands {
    /// None without an audit.
    pub(super) fn begin(inner: &Arc<Inner>, submission: &str) -> Option<Self> {
        let log = inner.audit.lock().unwrap_or_else(PoisonError::into_inner).upgrade()?;
        let submission = submission.to_owned();
        Some(Self { log, submission, commands: 0, snapshots: Vec::new(), bytes: 0, failure: None })
    }

    /// The copies of a command's outputs: (from, to), of equal sizes.
    pub(super) fn snapshot<'a>(
        &mut self,
        inner: &Arc<Inner>,
        kernel: &'static str,
        written: impl Iterator<Item = &'a Buffer>,
    ) -> Vec<(&'a Buffer, Buffer)> {
        let command = self.commands;
        self.commands += 1;
        let context = Context(inner.clone());
        let mut copies = Vec::new();
        for from in written {
            let request = [("snapshot", from.bytes())];
            match context.allocate("audit", &request, MemoryKind::HostVisible) {
                Err(error) => self.failure = self.failure.take().or(Some(error)),
                Ok(mut allocated) => {
                    let to = allocated.swap_remove(0).range(0, from.bytes());
                    let (submission, buffer) = (self.submission.clone(), from.static_name());
                    let record = AuditRecord { submission, command, kernel, buffer, hash: 0 };
                    self.snapshots.push((record, to.clone()));
                    self.bytes += to.bytes();
                    copies.push((from, to));
                }
            }
        }
        copies
    }

    /// After the submission: hashes the copies.
    pub(super) fn log(&mut self) -> Result<()> {
        if let Some(error) = self.failure.take() {
            return Err(error);
        }
        self.bytes = 0;
        let hashed = self.snapshots.drain(..).map(|(record, buffer)| {
            let mut bytes = vec![0; buffer.bytes() as usize];
            buffer.block().read_mapped(buffer.offset(), &mut bytes);
            let mut print = Fingerprint::new();
            print.add(&bytes);
            AuditRecord { hash: print.finish(), ..record }
        });
        let hashed: Vec<AuditRecord> = hashed.collect();
        self.log.0.lock().unwrap_or_else(PoisonError::into_inner).extend(hashed);
        Ok(())
    }
}

impl Recorder {
    /// With an audit, copies the outputs of a command.
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
        if self.audit.as_ref().is_some_and(|audit| audit.bytes > MOST_BYTES)
            && let Err(error) = self.submit_snapshots()
        {
            self.failed.get_or_insert(error);
        }
    }

    fn submit_snapshots(&mut self) -> Result<()> {
        let (Target::Owned(commands), Some(audit)) = (&mut self.commands, &mut self.audit) else {
            return Ok(());
        };
        commands.submit()?;
        commands.wait(self.inner.timeout)?;
        audit.log()?;
        self.commands = Target::Owned(submit::Commands::begin(&self.inner, &audit.submission, false)?);
        self.bound = vk::Pipeline::null();
        Ok(())
    }
}

impl Context {
    /// Hashes the outputs of all following commands, until the audit is dropped.
    pub fn audit(&self) -> Audit {
        let log = Arc::<Log>::default();
        *self.0.audit.lock().unwrap_or_else(PoisonError::into_inner) = Arc::downgrade(&log);
        Audit { log }
    }

    /// With an audit, clears new memory.
    pub(super) fn clear_if_audited(&self, buffers: &[Buffer], kind: MemoryKind) -> Result<()> {
        let audited = self.0.audit.lock().unwrap_or_else(PoisonError::into_inner).strong_count() > 0;
        if !audited || kind != MemoryKind::Device {
            return Ok(());
        }
        self.run("clear", |recorder| {
            buffers.iter().for_each(|buffer| recorder.fill(buffer, 0));
            Ok(())
        })?;
        Ok(())
    }
}

impl Audit {
    /// The records since the last call, oldest first.
    pub fn take(&self) -> Vec<AuditRecord> {
        std::mem::take(&mut *self.log.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
