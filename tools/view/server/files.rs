//! A file as an answer, read while it is sent: only one piece of a large film is in memory.

use ashsplat_files::regular_file;
use axum::body::{Body, Bytes};
use hyper::body::{Frame, SizeHint};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::pin::Pin;
use std::task::{Context, Poll};

/// Largest piece, bytes.
const PIECE: u64 = 256 << 10;

/// The contents of a regular file; none if there is no such file. Keeps a value until all is sent or the receiver has gone.
pub fn body<T: Send + Unpin + 'static>(path: &Path, kept: T) -> Option<Body> {
    let (file, left) = regular_file::open(path).ok()?;
    Some(Body::new(Pieces { file, left, _kept: kept }))
}

struct Pieces<T> {
    file: File,
    left: u64,
    _kept: T,
}

impl<T: Unpin> hyper::body::Body for Pieces<T> {
    type Data = Bytes;
    type Error = std::io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<std::io::Result<Frame<Bytes>>>> {
        if self.left == 0 {
            return Poll::Ready(None);
        }
        let mut piece = Vec::new();
        let read = (&self.file).take(self.left.min(PIECE)).read_to_end(&mut piece);
        Poll::Ready(Some(read.and_then(|bytes| match bytes {
            // The file is shorter than announced.
            0 => Err(std::io::ErrorKind::UnexpectedEof.into()),
            _ => {
                self.left -= bytes as u64;
                Ok(Frame::data(piece.into()))
            }
        })))
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.left)
    }
}
