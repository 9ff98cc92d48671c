//! Photographs: pictures in memory, and those of a data set with their masks, in memory, in a file, or read again when needed.

use crate::error::{Error, Result};
use crate::scene::Fingerprint;
use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A picture in memory: 8 bits per channel, as stored in the file (no colour management).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Photo {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `[row][column][r, g, b]`, `3 * width * height` bytes.
    pub rgb: Vec<u8>,
}

impl Photo {
    /// Returns the pixels (r, g, b) in [0, 1], row-major.
    pub fn to_f32(&self) -> Vec<[f32; 3]> {
        self.rgb.as_chunks::<3>().0.iter().map(|pixel| pixel.map(|c| f32::from(c) / 255.0)).collect()
    }

    /// Creates a picture from pixels (r, g, b), row-major, clamped to [0, 1] and rounded to 8 bits.
    ///
    /// # Errors
    /// [`Error::Argument`] when the number of pixels does not fit the size.
    pub fn from_f32(width: u32, height: u32, pixels: &[[f32; 3]]) -> Result<Self> {
        let byte = |c: &f32| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
        let photo = Self { width, height, rgb: pixels.as_flattened().iter().map(byte).collect() };
        photo.check_shape()?;
        Ok(photo)
    }

    /// Refuses a picture whose number of bytes does not match its size.
    pub fn check_shape(&self) -> Result<()> {
        let needs = 3 * u64::from(self.width) * u64::from(self.height);
        if self.rgb.len() as u64 == needs {
            return Ok(());
        }
        let Self { width, height, rgb } = self;
        Err(Error::argument("photo", format!("{width}x{height} needs {needs} bytes, has {}", rgb.len())))
    }
}

/// Bytes of a pixel in a file: r, g, b, coverage.
pub(crate) const TEXEL_BYTES: u64 = 4;
/// Coverage of an opaque pixel. A transparent pixel has 1, and a pixel that does not count has 0.
const OPAQUE: u8 = 255;

/// A photograph and its mask. Cheap to clone, because the pixels are shared.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredPhoto {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    masked: bool,
    transparent: bool,
    storage: PhotoStorage,
}

#[derive(Clone, Debug, PartialEq)]
enum PhotoStorage {
    /// The mask of a transparent photograph holds its coverage.
    Memory {
        photo: Arc<Photo>,
        mask: Option<Arc<[u8]>>,
    },
    File {
        file: Arc<PhotoFile>,
        offset: u64,
        fingerprint: u64,
    },
    /// A photograph without a mask.
    Source {
        file: Arc<PhotoFile>,
        source: Arc<dyn PhotoSource>,
        fingerprint: u64,
    },
}

impl From<Photo> for StoredPhoto {
    /// A photograph without a mask.
    fn from(photo: Photo) -> Self {
        Self::new(photo, None)
    }
}

impl StoredPhoto {
    /// Creates a photograph in memory. `mask` has one byte per pixel, 0 if the pixel does not count.
    pub fn new(photo: Photo, mask: Option<Vec<u8>>) -> Self {
        let (width, height, masked) = (photo.width, photo.height, mask.is_some());
        let storage = PhotoStorage::Memory { photo: Arc::new(photo), mask: mask.map(Into::into) };
        Self { width, height, masked, transparent: false, storage }
    }

    /// Same as [`StoredPhoto::new`], but for a photograph composed over the training's background. `opacity`, one byte per
    /// pixel, lets [`TrainSettings::random_background`](crate::TrainSettings::random_background) compose it over others.
    pub fn with_opacity(photo: Photo, opacity: &[u8], mask: Option<Vec<u8>>) -> Self {
        let fits = mask.as_ref().is_none_or(|mask| mask.len() == opacity.len());
        if !fits || opacity.iter().all(|&opacity| opacity == OPAQUE) {
            return Self::new(photo, mask);
        }
        let counts = |pixel: usize| mask.as_ref().is_none_or(|mask| mask[pixel] != 0);
        let covered = |(pixel, &opacity): (usize, &u8)| match counts(pixel) {
            true => 1 + ((254 * u32::from(opacity) + 127) / 255) as u8,
            false => 0,
        };
        let coverage = opacity.iter().enumerate().map(covered).collect();
        Self { masked: mask.is_some(), transparent: true, ..Self::new(photo, Some(coverage)) }
    }

    /// Masks the pixels whose indices are `hidden`, so that they do not count.
    pub fn hiding(&self, hidden: impl Fn(usize) -> bool) -> Result<Self> {
        let texels = self.texels()?;
        let coverage = texels.as_chunks::<4>().0.iter().map(|texel| texel[3]).enumerate();
        let coverage = coverage.map(|(pixel, coverage)| if hidden(pixel) { 0 } else { coverage }).collect();
        let storage = PhotoStorage::Memory { photo: self.photo()?, mask: Some(coverage) };
        Ok(Self { masked: true, storage, ..self.clone() })
    }

    /// True if some pixels do not count or are transparent. The device then stores the coverage.
    pub fn is_masked(&self) -> bool {
        self.masked || self.transparent
    }

    /// True if another background is possible: [`StoredPhoto::with_opacity`].
    pub fn is_transparent(&self) -> bool {
        self.transparent
    }

    /// Bytes of the photograph in a file.
    pub fn bytes(&self) -> u64 {
        TEXEL_BYTES * u64::from(self.width) * u64::from(self.height)
    }

    /// File of the photograph; None if it is in memory.
    pub fn file(&self) -> Option<&Arc<PhotoFile>> {
        match &self.storage {
            PhotoStorage::Memory { .. } => None,
            PhotoStorage::File { file, .. } | PhotoStorage::Source { file, .. } => Some(file),
        }
    }

    /// Returns the picture.
    ///
    /// # Errors
    /// [`Error::Io`] if its file cannot be read; [`Error::Input`] if its source has changed.
    pub fn photo(&self) -> Result<Arc<Photo>> {
        match &self.storage {
            PhotoStorage::Memory { photo, .. } => Ok(photo.clone()),
            PhotoStorage::Source { source, fingerprint, .. } => {
                read_again(&**source, *fingerprint).map(Arc::new)
            }
            PhotoStorage::File { file, offset, .. } => {
                let texels = file.read(*offset, self.bytes())?;
                let rgb: Vec<[u8; 3]> =
                    texels.as_chunks::<4>().0.iter().map(|t| [t[0], t[1], t[2]]).collect();
                Ok(Arc::new(Photo { width: self.width, height: self.height, rgb: rgb.into_flattened() }))
            }
        }
    }

    /// One byte per pixel, 0 if the pixel does not count. None if all pixels count.
    pub fn mask(&self) -> Result<Option<Arc<[u8]>>> {
        match &self.storage {
            _ if !self.masked => Ok(None),
            PhotoStorage::Memory { mask, .. } if !self.transparent => Ok(mask.clone()),
            _ => {
                let counts = |texel: &[u8; 4]| if texel[3] == 0 { 0 } else { OPAQUE };
                Ok(Some(self.texels()?.as_chunks::<4>().0.iter().map(counts).collect()))
            }
        }
    }

    /// Pixels with coverage: r, g, b, coverage per pixel, row-major. Coverage is 0 if the pixel does not count, else from 1
    /// (transparent) to 255 (opaque).
    pub fn texels(&self) -> Result<Vec<u8>> {
        match &self.storage {
            PhotoStorage::Memory { photo, mask } => Ok(self.texels_of(photo, mask.as_deref())),
            PhotoStorage::File { file, offset, .. } => file.read(*offset, self.bytes()),
            PhotoStorage::Source { .. } => Ok(self.texels_of(&*self.photo()?, None)),
        }
    }

    /// Hash of photograph and mask, the same wherever they are.
    pub(crate) fn fingerprint(&self) -> u64 {
        match &self.storage {
            PhotoStorage::Memory { photo, mask } => fingerprint(photo, mask.as_deref()),
            PhotoStorage::File { fingerprint, .. } | PhotoStorage::Source { fingerprint, .. } => *fingerprint,
        }
    }

    /// Refuses a photograph or mask whose number of bytes does not match its size.
    pub(crate) fn check(&self) -> Result<(), String> {
        let PhotoStorage::Memory { photo, mask } = &self.storage else { return Ok(()) };
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

    fn texels_of(&self, photo: &Photo, mask: Option<&[u8]>) -> Vec<u8> {
        let pixels = photo.rgb.as_chunks::<3>().0.iter().enumerate();
        let coverage = |i: usize| match mask.and_then(|mask| mask.get(i)) {
            Some(&coverage) if self.transparent || coverage == 0 => coverage,
            _ => OPAQUE,
        };
        pixels.map(|(i, &[r, g, b])| [r, g, b, coverage(i)]).collect::<Vec<_>>().into_flattened()
    }
}

fn fingerprint(photo: &Photo, mask: Option<&[u8]>) -> u64 {
    let mut print = Fingerprint::new();
    print.add(&photo.rgb);
    if let Some(mask) = mask {
        print.add(mask);
    }
    print.finish()
}

/// A photograph that is read again each time that it is needed, because it takes less memory in its own form.
pub trait PhotoSource: std::fmt::Debug + Send + Sync {
    /// File for errors.
    fn path(&self) -> &Path;

    /// Reads the photograph, from any thread.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Input`].
    fn read(&self) -> Result<Photo>;
}

impl PartialEq for dyn PhotoSource {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::addr_eq(self, other)
    }
}

fn read_again(source: &dyn PhotoSource, expected: u64) -> Result<Photo> {
    let problem = match source.read() {
        Ok(photo) if fingerprint(&photo, None) == expected => return Ok(photo),
        Ok(_) => "has changed since the training began".to_owned(),
        Err(Error::Io { source, .. }) => format!("can no longer be read: {source}"),
        Err(Error::Input { problem, .. }) => format!("has changed since the training began: {problem}"),
        Err(other) => return Err(other),
    };
    let remedy = "put the file back and resume from the newest checkpoint, or train again";
    Err(Error::input(source.path(), problem, remedy))
}

/// Photographs with their masks in an unnamed file, which is deleted with this value.
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
    /// Creates an empty file in a folder. `memory_bytes` limits the memory of its photographs during training, host and device
    /// together.
    pub fn new(file: File, folder: PathBuf, memory_bytes: u64) -> Arc<Self> {
        Arc::new(Self { folder, memory_bytes, file: Mutex::new(file) })
    }

    /// Memory limit of the file's photographs, bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    /// Moves a photograph into the file.
    ///
    /// # Errors
    /// [`Error::Io`], for example when the disk is full.
    pub fn store(self: &Arc<Self>, photo: &StoredPhoto) -> Result<StoredPhoto> {
        let (texels, fingerprint) = (photo.texels()?, photo.fingerprint());
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let written = file.seek(SeekFrom::End(0)).and_then(|at| file.write_all(&texels).map(|()| at));
        let offset = written.map_err(|e| Error::io(&self.folder, "keep photos", e))?;
        let storage = PhotoStorage::File { file: self.clone(), offset, fingerprint };
        Ok(StoredPhoto { storage, ..photo.clone() })
    }

    /// Forgets the pixels of a photograph, which `source` reads when they are needed.
    ///
    /// # Errors
    /// [`Error::Argument`] for a photograph with a mask, which a source does not have.
    pub fn leave(self: &Arc<Self>, photo: &StoredPhoto, source: Arc<dyn PhotoSource>) -> Result<StoredPhoto> {
        if photo.is_masked() {
            return Err(Error::argument("photo", "has a mask: store it in the file"));
        }
        let storage = PhotoStorage::Source { file: self.clone(), source, fingerprint: photo.fingerprint() };
        Ok(StoredPhoto { storage, ..photo.clone() })
    }

    fn read(&self, offset: u64, bytes: u64) -> Result<Vec<u8>> {
        let mut texels = Vec::with_capacity(bytes as usize);
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(offset))
            .and_then(|_| Read::take(&mut *file, bytes).read_to_end(&mut texels))
            .and_then(|read| if read as u64 == bytes { Ok(()) } else { Err(ErrorKind::UnexpectedEof.into()) })
            .map_err(|e| Error::io(&self.folder, "read kept photos", e))?;
        Ok(texels)
    }
}
