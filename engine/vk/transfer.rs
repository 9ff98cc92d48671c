//! Uploads to and downloads from device memory.

use super::buffer::Buffer;
use super::context::Context;
use super::memory_types::Place;
use super::recorder::MAX_UPDATE_BYTES;
use crate::{Error, Result};
use std::sync::PoisonError;

/// Most bytes of a download at a time.
const CHUNK_BYTES: u64 = 16 << 20;
/// Chunk size when reading mapped memory: chunks stay in the cache.
const MAPPED_CHUNK_BYTES: u64 = 256 << 10;

impl Context {
    /// Copies bytes to the start of a buffer and waits. Writes directly if the memory is mapped, otherwise copies from a
    /// ring of staging memory that the context keeps ([`Context::free_staging`]).
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
        let copied = self.upload_staged(buffer, bytes);
        if self.is_foreign() {
            // A host gets its memory back.
            self.free_staging();
        }
        copied
    }

    /// Same as [`Context::upload`], but without waiting: the bytes are copied to staging memory. Submissions after
    /// [`Context::take_over_uploads`] see them in the buffer. Until then the caller must not write these bytes otherwise,
    /// and nothing in flight may use them: a copy queue may write them at once.
    ///
    /// # Errors
    /// Same as [`Context::upload`]. A later transfer or [`Context::finish_uploads`] reports failures of the copy itself.
    pub(crate) fn begin_upload(&self, buffer: &Buffer, bytes: &[u8]) -> Result<()> {
        if buffer.block().is_mapped() || self.is_foreign() || self.is_watched() {
            return self.upload(buffer, bytes);
        }
        buffer.check_range(0, bytes.len())?;
        self.copy_staged(buffer, bytes, false)
    }

    /// Same as [`Context::begin_upload`], but uses the copy queue even if the host sees a card's memory (resizable BAR).
    /// Writing that memory would have to wait for the main queue's work. All uploads to a buffer use this function or none:
    /// the host writes only memory that no copy is known to use.
    ///
    /// # Errors
    /// Same as [`Context::begin_upload`].
    pub(crate) fn begin_upload_beside(&self, buffer: &Buffer, bytes: &[u8]) -> Result<()> {
        if self.device.place != Place::Window || self.device.copying.is_none() {
            return self.begin_upload(buffer, bytes);
        }
        if self.is_watched() {
            self.finish_uploads()?;
            return self.upload(buffer, bytes);
        }
        buffer.check_range(0, bytes.len())?;
        self.copy_staged(buffer, bytes, false)
    }

    /// Makes all later submissions see the uploaded data.
    ///
    /// # Errors
    /// When the device is lost or has no memory left.
    pub(crate) fn take_over_uploads(&self) -> Result<()> {
        self.staging.lock().take_over(&self.pools)
    }

    /// True if a profile or an audit observes every command.
    fn is_watched(&self) -> bool {
        let profile = &self.logs.profile.lock().unwrap_or_else(PoisonError::into_inner);
        let audit = &self.logs.audit.lock().unwrap_or_else(PoisonError::into_inner);
        profile.strong_count() > 0 || audit.strong_count() > 0
    }

    /// Copies all bytes through the ring, and waits.
    fn upload_staged(&self, buffer: &Buffer, bytes: &[u8]) -> Result<()> {
        if self.is_watched() {
            return self.upload_watched(buffer, bytes);
        }
        self.copy_staged(buffer, bytes, true)?;
        self.finish_uploads()
    }

    /// Waits for all uploads in flight.
    ///
    /// # Errors
    /// Errors of the copies.
    pub(crate) fn finish_uploads(&self) -> Result<()> {
        self.take_over_uploads()?;
        self.staging.lock().settle(&self.device)
    }

    /// Submits copies of all bytes.
    fn copy_staged(&self, buffer: &Buffer, bytes: &[u8], after_work: bool) -> Result<()> {
        if self.is_lost() {
            return Err(Error::DeviceLost { call: "an earlier call" });
        }
        let mut ring = self.staging.lock();
        let mut done = 0;
        while done < bytes.len() {
            let rest = buffer.range(done as u64, buffer.bytes() - done as u64);
            let copied = ring.copy(&self.pools, &rest, &bytes[done..], after_work);
            done += copied.inspect_err(|_| ring.forget(buffer))?;
        }
        Ok(())
    }

    /// Uploads piece by piece, each as a command that a profile times and an audit hashes.
    fn upload_watched(&self, buffer: &Buffer, bytes: &[u8]) -> Result<()> {
        let mut ring = self.staging.lock();
        let mut offset = 0;
        while offset < bytes.len() {
            let (staging, place) = ring.reserve(&self.device, (bytes.len() - offset) as u64)?;
            let length = place.end - place.start;
            let piece = &bytes[offset..][..length as usize];
            staging.block().write_mapped(staging.offset() + place.start, piece);
            // The last piece may end within a word: the rest of that word is in the buffer's padding.
            let whole = length.next_multiple_of(4).min(buffer.bytes() - offset as u64);
            let ran = self.run("upload", |recorder| {
                recorder.copy(&staging.range(place.start, whole), &buffer.range(offset as u64, whole));
                Ok(())
            });
            ran.inspect_err(|_| ring.abandon())?;
            offset += length as usize;
        }
        Ok(())
    }

    /// Returns the bytes of a buffer, after all earlier submissions.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] while a submission that uses the buffer's arena is running.
    pub fn download(&self, buffer: &Buffer) -> Result<Vec<u8>> {
        let mut bytes = Vec::with_capacity(buffer.bytes() as usize);
        self.download_chunks(buffer, |chunk| bytes.extend_from_slice(chunk))?;
        Ok(bytes)
    }

    /// Passes the contents of a buffer to `take` in order, chunk by chunk, so that they are not held twice. All chunks
    /// except the last have a multiple of 256 bytes.
    ///
    /// # Errors
    /// Same as [`Context::download`].
    pub fn download_chunks(&self, buffer: &Buffer, take: impl FnMut(&[u8])) -> Result<()> {
        let downloaded = self.download_pieces(buffer, take);
        if self.is_foreign() && !buffer.block().is_read_mapped() {
            self.free_staging();
        }
        downloaded
    }

    fn download_pieces(&self, buffer: &Buffer, mut take: impl FnMut(&[u8])) -> Result<()> {
        let total = buffer.bytes();
        let mapped = buffer.block().is_read_mapped();
        if total == 0 {
            return Ok(());
        }
        if mapped {
            buffer.check_idle()?;
        }
        let step = if mapped { MAPPED_CHUNK_BYTES } else { CHUNK_BYTES };
        let mut chunk = vec![0; total.min(step) as usize];
        let mut offset = 0;
        while offset < total {
            let length = (total - offset).min(step);
            let mut bytes = &mut chunk[..length as usize];
            if mapped {
                buffer.block().read_mapped(buffer.offset() + offset, bytes);
            } else {
                let length = self.download_staged(&buffer.range(offset, length), bytes)?;
                bytes = &mut bytes[..length];
            }
            offset += bytes.len() as u64;
            take(bytes);
        }
        Ok(())
    }

    /// Reads as many bytes of a buffer as fit a piece of the ring, and returns their number.
    fn download_staged(&self, from: &Buffer, bytes: &mut [u8]) -> Result<usize> {
        let mut ring = self.staging.lock();
        let (staging, place) = ring.reserve(&self.device, from.bytes())?;
        let length = place.end - place.start;
        let ran = self.run("download", |recorder| {
            recorder.copy(&from.range(0, length), &staging.range(place.start, length));
            Ok(())
        });
        ran.inspect_err(|_| ring.abandon())?;
        staging.block().read_mapped(staging.offset() + place.start, &mut bytes[..length as usize]);
        Ok(length as usize)
    }

    /// Returns the most bytes of temporary memory for an upload of `bytes` bytes.
    pub(crate) fn staging_bytes(&self, bytes: u64) -> u64 {
        if self.device.reads_mapped() { 0 } else { bytes.min(CHUNK_BYTES) }
    }
}
