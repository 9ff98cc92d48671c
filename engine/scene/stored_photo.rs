//! Photos of a data set with their masks: in memory, or in a file until they are needed.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use super::photo::Photo;
use crate::fingerprint::Fingerprint;
use crate::{Error, Result};

/// Bytes of a pixel in a file: r, g, b, mask.
pub(crate) const TEXEL_BYTES: u64 = 4;

/// A photo and its mask. Cheap to clone: the pixels are shared.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredPhoto {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    masked: bool,
    place: Place,
}

#[derive(Clone, Debug, PartialEq)]
enum Place {
    Memory { photo: Arc<Photo>, mask: Option<Arc<[u8]>> },
    File { file: Arc<PhotoFile>, offset: u64, fingerprint: u64 },
}

impl From<Photo> for StoredPhoto {
    /// A photo without a mask.
    fn from(photo: Photo) -> Self {
        Self::new(photo, None)
    }
}

impl StoredPhoto {
    /// A photo in memory. `mask` has one byte per pixel, 0 where the pixel does not count.
    pub fn new(photo: Photo, mask: Option<Vec<u8>>) -> Self {
        let (width, height, masked) = (photo.width, photo.height, mask.is_some());
        let place = Place::Memory { photo: Arc::new(photo), mask: mask.map(Into::into) };
        Self { width, height, masked, place }
    }

    /// Whether there are pixels that do not count.
    pub fn is_masked(&self) -> bool {
        self.masked
    }

    /// Bytes of the photo in a file.
    pub fn bytes(&self) -> u64 {
        TEXEL_BYTES * u64::from(self.width) * u64::from(self.height)
    }

    /// The file, if the photo is in one.
    pub fn file(&self) -> Option<&Arc<PhotoFile>> {
        match &self.place {
            Place::Memory { .. } => None,
            Place::File { file, .. } => Some(file),
        }
    }

    /// The photo.
    ///
    /// # Errors
    /// [`Error::Io`] when it is in a file that cannot be read.
    pub fn photo(&self) -> Result<Arc<Photo>> {
        if let Place::Memory { photo, .. } = &self.place {
            return Ok(photo.clone());
        }
        let rgb = self.texels()?.as_chunks::<4>().0.iter().flat_map(|t| [t[0], t[1], t[2]]).collect();
        Ok(Arc::new(Photo { width: self.width, height: self.height, rgb }))
    }

    /// One byte per pixel, 0 where the pixel does not count. None if all pixels count.
    ///
    /// # Errors
    /// As [`StoredPhoto::photo`].
    pub fn mask(&self) -> Result<Option<Arc<[u8]>>> {
        match &self.place {
            Place::Memory { mask, .. } => Ok(mask.clone()),
            Place::File { .. } if !self.masked => Ok(None),
            Place::File { .. } => Ok(Some(self.texels()?.as_chunks::<4>().0.iter().map(|t| t[3]).collect())),
        }
    }

    /// The photo and its mask: r, g, b and mask (255 without one) per pixel, row-major.
    ///
    /// # Errors
    /// As [`StoredPhoto::photo`].
    pub fn texels(&self) -> Result<Vec<u8>> {
        match &self.place {
            Place::Memory { photo, mask } => Ok(texels(photo, mask.as_deref())),
            Place::File { file, offset, .. } => file.read(*offset, self.bytes()),
        }
    }

    /// A hash of photo and mask, the same in memory and in a file.
    pub(crate) fn fingerprint(&self) -> u64 {
        match &self.place {
            Place::Memory { photo, mask } => fingerprint(photo, mask.as_deref()),
            Place::File { fingerprint, .. } => *fingerprint,
        }
    }

    /// Refuses a photo or mask whose number of bytes does not fit its size.
    pub(crate) fn check(&self) -> Result<(), String> {
        let Place::Memory { photo, mask } = &self.place else { return Ok(()) };
        let pixels = self.width as usize * self.height as usize;
        if photo.rgb.len() != 3 * pixels {
            return Err(format!("the photo has {} bytes, not three per pixel", photo.rgb.len()));
        }
        match mask {
            Some(mask) if mask.len() != pixels => {
                Err(format!("the mask has {} bytes, not one per pixel", mask.len()))
            }
            _ => Ok(()),
        }
    }
}

fn texels(photo: &Photo, mask: Option<&[u8]>) -> Vec<u8> {
    let pixels = photo.rgb.as_chunks::<3>().0.iter().enumerate();
    let counts = |i: usize| if mask.is_none_or(|mask| mask.get(i) != Some(&0)) { 255 } else { 0 };
    pixels.flat_map(|(i, &[r, g, b])| [r, g, b, counts(i)]).collect()
}

fn fingerprint(photo: &Photo, mask: Option<&[u8]>) -> u64 {
    let mut print = Fingerprint::new();
    print.add(&photo.rgb);
    if let Some(mask) = mask {
        print.add(mask);
    }
    print.finish()
}

/// Photos with their masks, one after the other, in an unnamed file that is deleted with this value.
#[derive(Debug)]
pub struct PhotoFile {
    folder: PathBuf,
    memory_bytes: u64,
    file: Mutex<File>,
}

impl PartialEq for PhotoFile {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }
}

impl PhotoFile {
    /// An empty file in a folder. `memory_bytes` bounds the memory of its photos during training, host and
    /// device together.
    pub fn new(file: File, folder: PathBuf, memory_bytes: u64) -> Arc<Self> {
        Arc::new(Self { folder, memory_bytes, file: Mutex::new(file) })
    }

    /// Bound of the memory of the file's photos, bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    /// Moves a photo into the file.
    ///
    /// # Errors
    /// [`Error::Io`] when the disk is full, for example.
    pub fn store(self: &Arc<Self>, photo: &StoredPhoto) -> Result<StoredPhoto> {
        let (texels, fingerprint) = (photo.texels()?, photo.fingerprint());
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let written = file.seek(SeekFrom::End(0)).and_then(|at| file.write_all(&texels).map(|()| at));
        let offset = written.map_err(|e| Error::io(&self.folder, "keep photos", e))?;
        let place = Place::File { file: self.clone(), offset, fingerprint };
        Ok(StoredPhoto { place, ..photo.clone() })
    }

    fn read(&self, offset: u64, bytes: u64) -> Result<Vec<u8>> {
        let mut texels = Vec::with_capacity(bytes as usize);
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(offset))
            .and_then(|_| Read::take(&mut *file, bytes).read_to_end(&mut texels))
            .and_then(|read| if read as u64 == bytes { Ok(()) } else { Err(cut_short()) })
            .map_err(|e| Error::io(&self.folder, "read kept photos", e))?;
        Ok(texels)
    }
}

fn cut_short() -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "the file ends too early")
}
