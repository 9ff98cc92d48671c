//! A file as an answer, read as it is sent: of a large film, a piece is in memory at a time.

use ashsplat_files::regular_file;
use axum::body::{Body, Bytes};
use hyper::body::{Frame, SizeHint};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::pin::Pin;
use std::task::{Context, Poll};

/// Bytes of a piece.
const PIECE: u64 = 256 << 10;

/// The contents of a regular file; none where there is no such.
pub fn body(path: &Path) -> Option<Body> {
    body_of(path, ())
}

/// The same; something is kept until all of it is sent, or nobody wants it any more.
pub fn body_of<T: Send + Unpin + 'static>(path: &Path, kept: T) -> Option<Body> {
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
            // It was promised longer.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_arrive_whole() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("film.gif");
        let contents: Vec<u8> = (0..3 * PIECE + 77).map(|i| (i % 251) as u8).collect();
        std::fs::write(&path, &contents).expect("written");
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        let sent = runtime.block_on(axum::body::to_bytes(body(&path).expect("a file"), usize::MAX));
        assert!(sent.expect("read") == contents);
        assert!(body(folder.path()).is_none() && body(&folder.path().join("other")).is_none());
    }
}
