//! The photos of the data set as the page gets them.

use super::draw;
use ashsplat::Result;
use ashsplat_files::{Gallery, Photo, PhotoFileFormat};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes of encoded photos that are kept.
const KEPT_BYTES: usize = 64 << 20;
const QUALITY: u8 = 92;
const THUMBNAIL_QUALITY: u8 = 75;
/// Width of a thumbnail, pixels.
const THUMBNAIL_WIDTH: u32 = 140;

/// How large a photo is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// As training uses it.
    Full,
    Thumbnail,
}

type Kept = VecDeque<(usize, Size, Arc<Vec<u8>>)>;

/// Photos as JPEG, the newest kept.
pub struct Photos {
    gallery: Gallery,
    kept: Mutex<Kept>,
}

impl Photos {
    pub fn new(gallery: Gallery) -> Photos {
        Photos { gallery, kept: Mutex::new(VecDeque::new()) }
    }

    /// A photo, or in words why not; none beyond the last.
    pub fn jpeg(&self, index: usize, size: Size) -> Option<Result<Arc<Vec<u8>>, String>> {
        let kept = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((.., bytes)) = kept().iter().find(|(i, s, _)| (*i, *s) == (index, size)) {
            return Some(Ok(bytes.clone()));
        }
        let encoded = self.gallery.view(index)?.and_then(|view| encode(&*view.photo.photo()?, size));
        Some(encoded.map_err(|error| error.to_string()).map(|bytes| {
            let bytes = Arc::new(bytes);
            let mut kept = kept();
            kept.push_back((index, size, bytes.clone()));
            while kept.len() > 1 && kept.iter().map(|(.., bytes)| bytes.len()).sum::<usize>() > KEPT_BYTES {
                kept.pop_front();
            }
            bytes
        }))
    }
}

fn encode(photo: &Photo, size: Size) -> Result<Vec<u8>> {
    match size {
        Size::Full => draw::encode(photo, QUALITY),
        Size::Thumbnail => {
            let width = photo.width.min(THUMBNAIL_WIDTH);
            let height = (photo.height * width / photo.width).max(1);
            draw::encode(&photo.clone().scaled_to(width, height)?, THUMBNAIL_QUALITY)
        }
    }
}
