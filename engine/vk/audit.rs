//! Opt-in audit of a context: hashes the output of every command except staged uploads. Comparing two audited runs of the same
//! work shows the first command whose bits differ.
//!
//! Each command is surrounded by barriers and followed by a copy of its output. So an audited recording is slow and hides
//! races between commands. It is submitted in pieces, so that only a few copies exist at a time. New device memory is
//! cleared, so that unwritten bytes are equal too.

use super::lock::lock;
use super::memory::Buffer;
use super::memory_types::MemoryKind;
use super::open_device::Device;
use crate::error::{Error, Result};
use crate::scene::Fingerprint;
use std::sync::{Arc, Mutex};

/// Bytes of snapshots that trigger a submission. A single snapshot may be larger.
const MAX_BYTES: u64 = 64 << 20;

/// Hashes the output of every command of its context, until it is dropped.
pub struct Audit {
    pub(super) log: Arc<Log>,
}

/// A buffer that a command wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct AuditRecord {
    /// The label of the submission.
    pub submission: &'static str,
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

pub(super) struct Commands {
    log: Arc<Log>,
    pub(super) submission: &'static str,
    commands: u32,
    snapshots: Vec<(AuditRecord, Buffer)>,
    bytes: u64,
    failure: Option<Error>,
}

impl Commands {
    pub(super) fn begin(log: Arc<Log>, submission: &'static str) -> Self {
        Self { log, submission, commands: 0, snapshots: Vec::new(), bytes: 0, failure: None }
    }

    /// True if the snapshots take so much memory that they must be hashed.
    pub(super) fn is_full(&self) -> bool {
        self.bytes > MAX_BYTES
    }

    /// Returns the copies of a command's outputs: (from, to), of equal sizes.
    pub(super) fn snapshot<'a>(
        &mut self,
        inner: &Arc<Device>,
        kernel: &'static str,
        written: impl Iterator<Item = &'a Buffer>,
    ) -> Vec<(&'a Buffer, Buffer)> {
        let command = self.commands;
        self.commands += 1;
        let mut copies = Vec::new();
        for from in written {
            let request = [("snapshot", from.bytes())];
            match inner.allocate("audit", &request, &[], MemoryKind::HostVisible, 0) {
                Err(error) => self.failure = self.failure.take().or(Some(error)),
                Ok(mut allocated) => {
                    let to = allocated.swap_remove(0).range(0, from.bytes());
                    let (submission, buffer) = (self.submission, from.name());
                    let record = AuditRecord { submission, command, kernel, buffer, hash: 0 };
                    self.snapshots.push((record, to.clone()));
                    self.bytes += to.bytes();
                    copies.push((from, to));
                }
            }
        }
        copies
    }

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
        lock(&self.log.0).extend(hashed);
        Ok(())
    }
}

impl Audit {
    /// Returns the records since the last call, oldest first.
    pub fn take(&self) -> Vec<AuditRecord> {
        std::mem::take(&mut *lock(&self.log.0))
    }
}
