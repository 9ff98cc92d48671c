//! Bytes to and from device memory.

use super::buffer::Buffer;
use super::context::Context;
use super::memory::MemoryKind;
use super::recorder::MAX_UPDATE_BYTES;
use crate::Result;

/// Staging memory of one transfer, at most.
const CHUNK_BYTES: u64 = 16 << 20;

impl Context {
    /// Copies bytes into the start of a buffer and waits: straight into memory that is mapped, else through staging
    /// memory in bounded chunks.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] when the bytes do not fit, or while a submission that uses the buffer's arena is
    /// under way.
    pub fn upload(&self, buffer: &Buffer, bytes: &[u8]) -> Result<()> {
        buffer.check_range(0, bytes.len())?;
        if bytes.is_empty() {
            return Ok(());
        }
        if buffer.block().is_mapped() {
            buffer.check_idle()?;
            buffer.block().write_mapped(buffer.offset(), bytes);
            return Ok(());
        }
        let whole_words = bytes.len().is_multiple_of(4) && buffer.offset().is_multiple_of(4);
        if bytes.len() <= MAX_UPDATE_BYTES && whole_words {
            return self
                .run("upload", |recorder| {
                    recorder.update(buffer, bytes);
                    Ok(())
                })
                .map(drop);
        }
        let staging = self.staging(bytes.len() as u64)?;
        let mut offset = 0;
        for chunk in bytes.chunks(CHUNK_BYTES as usize) {
            staging.write(0, chunk)?;
            // The last chunk may end within a word: its rest goes into the buffer's padding.
            let length = (chunk.len() as u64).next_multiple_of(4).min(buffer.bytes() - offset);
            self.run("upload", |recorder| {
                recorder.copy(&staging.range(0, length), &buffer.range(offset, length));
                Ok(())
            })?;
            offset += length;
        }
        Ok(())
    }

    /// The bytes of a buffer, after everything that was submitted before.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] while a submission that uses the buffer's arena is under way.
    pub fn download(&self, buffer: &Buffer) -> Result<Vec<u8>> {
        let mut bytes = vec![0; buffer.bytes() as usize];
        if buffer.block().is_mapped() {
            buffer.check_idle()?;
            buffer.block().read_mapped(buffer.offset(), &mut bytes);
            return Ok(bytes);
        }
        if bytes.is_empty() {
            return Ok(bytes);
        }
        let staging = self.staging(buffer.bytes())?;
        let mut offset = 0;
        for chunk in bytes.chunks_mut(CHUNK_BYTES as usize) {
            let length = chunk.len() as u64;
            self.run("download", |recorder| {
                recorder.copy(&buffer.range(offset, length), &staging.range(0, length));
                Ok(())
            })?;
            staging.read(0, chunk)?;
            offset += length;
        }
        Ok(bytes)
    }

    fn staging(&self, bytes: u64) -> Result<Buffer> {
        let request = [("staging", bytes.min(CHUNK_BYTES))];
        let mut buffers = self.allocate("staging", &request, MemoryKind::HostVisible)?;
        Ok(buffers.swap_remove(0))
    }
}
