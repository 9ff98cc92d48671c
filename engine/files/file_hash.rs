//! Hashes of files, which show if a file has changed.

use std::io::Read;
use std::path::Path;

use super::regular_file;
use ashsplat::fingerprint::Fingerprint;
use ashsplat::{Error, Result};

/// Bytes that are added at a time. The hash depends on this size.
const PIECE: usize = 1 << 20;

/// The hash of a file's bytes: [`Fingerprint`] of pieces of one mebibyte, 16 hexadecimal digits. It detects damage, not
/// forgery. Holds one piece in memory.
///
/// # Errors
/// [`Error::Io`] naming the file.
pub fn file_hash(path: impl AsRef<Path>) -> Result<String> {
    let path = path.as_ref();
    let io = |source| Error::io(path, "read", source);
    let (file, length) = regular_file::open(path)?;
    let mut file = file.take(length);
    let mut print = Fingerprint::new();
    let mut piece = Vec::with_capacity(PIECE);
    loop {
        piece.clear();
        file.by_ref().take(PIECE as u64).read_to_end(&mut piece).map_err(io)?;
        print.add(&piece);
        if piece.len() < PIECE {
            return Ok(format!("{:016x}", print.finish()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;

    #[test]
    fn every_byte_and_the_length_count() {
        let _turn = turn();
        let folder = tempfile::tempdir().expect("a folder");
        let of = |bytes: &[u8]| {
            let path = folder.path().join("file");
            std::fs::write(&path, bytes).expect("written");
            file_hash(path).expect("a hash")
        };
        let mut bytes = vec![7; 2 * PIECE];
        let whole = of(&bytes);
        assert_eq!((whole.len(), &of(&bytes)), (16, &whole));
        for at in [0, PIECE - 1, PIECE, 2 * PIECE - 1] {
            bytes[at] ^= 1;
            assert_ne!(of(&bytes), whole, "{at}");
            bytes[at] ^= 1;
        }
        assert_ne!(of(&bytes[..2 * PIECE - 1]), whole);
        assert_ne!(of(&bytes[..PIECE]), whole);
        assert_ne!(of(b""), of(b"\0"));
        assert!(file_hash(folder.path().join("none")).is_err());
    }
}
