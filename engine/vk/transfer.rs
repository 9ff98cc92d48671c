//! Transfers to and from device memory.

use super::allocator::MemoryKind;
use super::buffer::Buffer;
use super::context::Context;
use super::recorder::MAX_UPDATE_BYTES;
use crate::Result;

/// Most staging memory of one transfer.
const CHUNK_BYTES: u64 = 16 << 20;
/// Size of the chunks in which mapped memory is read: they stay in the cache.
const MAPPED_CHUNK_BYTES: u64 = 256 << 10;

impl Context {
    /// Copies bytes into the start of a buffer and waits: directly if the memory is mapped, otherwise through
    /// staging memory in bounded chunks.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] when the bytes do not fit, or while a submission that uses the buffer's
    /// arena is running.
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
            // The last chunk may end within a word: the rest of that word is in the buffer's padding.
            let length = (chunk.len() as u64).next_multiple_of(4).min(buffer.bytes() - offset);
            self.run("upload", |recorder| {
                recorder.copy(&staging.range(0, length), &buffer.range(offset, length));
                Ok(())
            })?;
            offset += length;
        }
        Ok(())
    }

    /// The bytes of a buffer, after all earlier submissions.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] while a submission that uses the buffer's arena is running.
    pub fn download(&self, buffer: &Buffer) -> Result<Vec<u8>> {
        let mut bytes = Vec::with_capacity(buffer.bytes() as usize);
        self.download_chunks(buffer, |chunk| bytes.extend_from_slice(chunk))?;
        Ok(bytes)
    }

    /// Passes the contents of a buffer to `take` in order, chunk by chunk, so that they need not be held
    /// twice. All chunks except the last have a multiple of 256 bytes.
    ///
    /// # Errors
    /// As [`Context::download`].
    pub fn download_chunks(&self, buffer: &Buffer, mut take: impl FnMut(&[u8])) -> Result<()> {
        let total = buffer.bytes();
        let mapped = buffer.block().is_read_mapped();
        if total == 0 {
            return Ok(());
        }
        if mapped {
            buffer.check_idle()?;
        }
        let staging = if mapped { None } else { Some(self.staging(total)?) };
        let step = if mapped { MAPPED_CHUNK_BYTES } else { CHUNK_BYTES };
        let mut chunk = vec![0; total.min(step) as usize];
        for offset in (0..total).step_by(step as usize) {
            let length = (total - offset).min(step);
            let bytes = &mut chunk[..length as usize];
            match &staging {
                None => {
                    buffer.block().read_mapped(buffer.offset() + offset, bytes);
                }
                Some(staging) => {
                    self.run("download", |recorder| {
                        recorder.copy(&buffer.range(offset, length), &staging.range(0, length));
                        Ok(())
                    })?;
                    staging.read(0, bytes)?;
                }
            }
            take(bytes);
        }
        Ok(())
    }

    /// Most bytes of temporary memory for an upload of `bytes` bytes.
    pub(crate) fn staging_bytes(&self, bytes: u64) -> u64 {
        if self.device.unified_memory { 0 } else { bytes.min(CHUNK_BYTES) }
    }

    fn staging(&self, bytes: u64) -> Result<Buffer> {
        let request = [("staging", bytes.min(CHUNK_BYTES))];
        let mut buffers = self.allocate("staging", &request, MemoryKind::HostVisible)?;
        Ok(buffers.swap_remove(0))
    }
}
