//! Recognises files that are something else than their name says.

/// What the first bytes of a file really are, and what to do about it; `None` when nothing known.
///
/// The problem is worded to follow "this ", e.g. "is a Git LFS pointer, not the file itself".
pub(super) fn recognise(start: &[u8]) -> Option<(&'static str, &'static str)> {
    if start.is_empty() {
        return Some(("is empty", "download or copy it again"));
    }
    if start.starts_with(b"version https://git-lfs") {
        return Some(("is a Git LFS pointer, not the file itself", "run `git lfs pull` in its repository"));
    }
    if start.starts_with(&[0x1f, 0x8b]) {
        return Some(("is compressed with gzip", "unpack it with `gunzip` first"));
    }
    if start.starts_with(b"PK\x03\x04") {
        return Some(("is a ZIP archive", "unpack it first"));
    }
    if start.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) {
        return Some(("is compressed with zstd", "unpack it with `unzstd` first"));
    }
    if start.iter().all(|&byte| byte == 0) {
        return Some(("starts with nothing but zeros", "the download or copy was cut short: repeat it"));
    }
    let text = start.trim_ascii_start().to_ascii_lowercase();
    if [b"<!doctype".as_slice(), b"<html", b"<?xml", b"<head"].iter().any(|tag| text.starts_with(tag)) {
        return Some(("is a web page", "download the file itself (its raw or direct link)"));
    }
    None
}
