//! Photos of the data set for the page, in bounded memory.

mod queue;

use super::draw;
#[cfg(feature = "window")]
use ashsplat::Error;
use ashsplat::Result;
use ashsplat_files::{Gallery, Photo};
use ashsplat_program::output;
use ashsplat_program::session::locked;
use axum::body::Bytes;
use queue::{Permit, Queue};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

pub use queue::Client;

/// Bytes of encoded photos, and of thumbnails, to keep.
const CACHE_BYTES: usize = 64 << 20;
const THUMBNAIL_CACHE_BYTES: usize = 16 << 20;
const QUALITY: u8 = 92;
const THUMBNAIL_QUALITY: u8 = 75;
/// Width of a thumbnail, pixels.
const THUMBNAIL_WIDTH: u32 = 140;
/// Memory for decoding photos, MiB. A photo that takes more is decoded alone.
const DECODING_MIB: u32 = 512;
/// Most photos that are decoded at once.
const DECODERS: u32 = 2;
/// Bytes per pixel while a photo is decoded, scaled and encoded.
const BYTES_PER_PIXEL: u64 = 8;
/// Memory of photos that are being sent, MiB. A page that does not read occupies its share.
const SENDING_MIB: u32 = 128;

/// Requested size of a photo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    Full,
    Thumbnail,
}

#[derive(Debug)]
pub enum Refusal {
    /// No photo has this number.
    Unknown,
    Busy,
    Problem(String),
}

/// The photos encoded last, newest at the end.
struct PhotoCache {
    max_bytes: usize,
    photos: VecDeque<(usize, Arc<Vec<u8>>)>,
}

impl PhotoCache {
    fn new(max_bytes: usize) -> PhotoCache {
        PhotoCache { max_bytes, photos: VecDeque::new() }
    }

    fn find(&self, index: usize) -> Option<Arc<Vec<u8>>> {
        self.photos.iter().find(|(i, _)| *i == index).map(|(_, bytes)| bytes.clone())
    }

    fn add(&mut self, index: usize, bytes: Arc<Vec<u8>>) {
        self.photos.push_back((index, bytes));
        let total = |photos: &VecDeque<(usize, Arc<Vec<u8>>)>| -> usize {
            photos.iter().map(|(_, bytes)| bytes.len()).sum()
        };
        while self.photos.len() > 1 && total(&self.photos) > self.max_bytes {
            self.photos.pop_front();
        }
    }
}

/// Photos as JPEG; the newest stay in memory.
pub struct Photos {
    gallery: Gallery,
    /// Memory that decoding each photo takes, MiB.
    costs: Vec<u32>,
    /// Photos, and thumbnails.
    caches: [Mutex<PhotoCache>; 2],
    decoding: Queue,
    sending: Queue,
}

impl Photos {
    pub fn new(gallery: Gallery) -> Photos {
        let cost = |width: u32, height: u32| {
            let bytes = u64::from(width) * u64::from(height) * BYTES_PER_PIXEL;
            let mib = u32::try_from(bytes >> 20).unwrap_or(u32::MAX);
            mib.clamp(DECODING_MIB / DECODERS, DECODING_MIB)
        };
        let cameras = gallery.cameras();
        Photos {
            costs: cameras.iter().map(|named| cost(named.camera.width, named.camera.height)).collect(),
            gallery,
            caches: [CACHE_BYTES, THUMBNAIL_CACHE_BYTES].map(|max| Mutex::new(PhotoCache::new(max))),
            decoding: Queue::new(DECODING_MIB, DECODING_MIB),
            // A client that does not read occupies at most half.
            sending: Queue::new(SENDING_MIB, SENDING_MIB / 2),
        }
    }

    pub fn is_held_out(&self, index: usize) -> bool {
        self.gallery.held_out().get(index).is_some_and(|held_out| *held_out)
    }

    /// Returns a photo once the client has a permit.
    pub async fn jpeg(
        self: &Arc<Photos>,
        index: usize,
        size: Size,
        client: Client,
    ) -> Result<Bytes, Refusal> {
        let cost = *self.costs.get(index).ok_or(Refusal::Unknown)?;
        let cached = self.cache(size).find(index);
        let bytes = match cached {
            Some(bytes) => bytes,
            None => {
                let permit = self.decoding.acquire(client, cost).await.ok_or(Refusal::Busy)?;
                // Another request may have decoded the same photo meanwhile.
                let cached = self.cache(size).find(index);
                match cached {
                    Some(bytes) => bytes,
                    None => self.decoded(index, size, permit).await?,
                }
            }
        };
        let mib = u32::try_from(bytes.len().div_ceil(1 << 20)).unwrap_or(SENDING_MIB);
        let permit = self.sending.acquire(client, mib).await.ok_or(Refusal::Busy)?;
        Ok(Bytes::from_owner(SentPhoto { bytes, _permit: permit }))
    }

    /// Decodes a photo on this thread.
    #[cfg(feature = "window")]
    pub fn decoded_now(&self, index: usize) -> Result<Photo> {
        let view = self.gallery.view(index).ok_or_else(|| Error::argument("photo", "there is none"))?;
        Ok((*view?.photo.photo()?).clone())
    }

    fn cache(&self, size: Size) -> MutexGuard<'_, PhotoCache> {
        locked(&self.caches[size as usize])
    }

    async fn decoded(
        self: &Arc<Photos>,
        index: usize,
        size: Size,
        permit: Permit,
    ) -> Result<Arc<Vec<u8>>, Refusal> {
        let photos = self.clone();
        let work = move || {
            // The permit lasts until decoding ends, even if the page has gone.
            let _permit = permit;
            let view = photos.gallery.view(index).ok_or(Refusal::Unknown)?;
            let encoded = view.and_then(|view| encode(&*view.photo.photo()?, size));
            let bytes = Arc::new(encoded.map_err(|error| Refusal::Problem(error.to_string()))?);
            photos.cache(size).add(index, bytes.clone());
            Ok(bytes)
        };
        tokio::task::spawn_blocking(work).await.unwrap_or(Err(Refusal::Unknown))
    }
}

struct SentPhoto {
    bytes: Arc<Vec<u8>>,
    _permit: Permit,
}

impl AsRef<[u8]> for SentPhoto {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

fn encode(photo: &Photo, size: Size) -> Result<Vec<u8>> {
    match size {
        Size::Full => draw::encode(photo, QUALITY),
        Size::Thumbnail => {
            draw::encode(&output::narrowed(photo.clone(), THUMBNAIL_WIDTH)?, THUMBNAIL_QUALITY)
        }
    }
}
