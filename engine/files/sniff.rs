//! Recognises files whose content does not match their name.

/// The actual kind of a file by its first bytes, and the remedy; `None` if it is not recognised.
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
    if let Some(kind) = picture(start).or_else(|| utf16(start)) {
        return Some(kind);
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

/// Recognises UTF-16 text by its byte-order mark and a first letter of ASCII.
pub(super) fn utf16(start: &[u8]) -> Option<(&'static str, &'static str)> {
    let is_text = matches!(start, [0xff, 0xfe, 1..=255, 0, ..] | [0xfe, 0xff, 0, 1..=255, ..]);
    is_text.then_some(("is text in UTF-16", "save it in UTF-8"))
}

/// Recognises pictures other than JPEG and PNG. The tools named here keep the size and names of phone photos; otherwise
/// the cameras would not fit.
fn picture(start: &[u8]) -> Option<(&'static str, &'static str)> {
    let brand = start.get(8..12).filter(|_| start.get(4..8) == Some(b"ftyp"));
    match brand {
        Some(b"heic" | b"heix" | b"heim" | b"heis" | b"hevc" | b"mif1" | b"msf1") => {
            let remedy = "convert it to JPEG (`heif-convert a.heic a.jpg`, or sips on macOS) before the cameras are computed";
            return Some(("is a HEIC photo, as iPhones take them", remedy));
        }
        Some(b"avif" | b"avis") => {
            return Some(("is an AVIF picture", "convert it to PNG or JPEG of the same size"));
        }
        Some(b"qt  " | b"isom" | b"mp41" | b"mp42" | b"M4V ") => {
            return Some((
                "is a video",
                "`ashsplat poses VIDEO` takes frames from it and makes a data set of them",
            ));
        }
        _ => {}
    }
    if start.starts_with(b"RIFF") && start.get(8..12) == Some(b"WEBP") {
        return Some(("is a WebP picture", "convert it to PNG or JPEG of the same size"));
    }
    if start.starts_with(b"II*\0") || start.starts_with(b"MM\0*") {
        return Some(("is a TIFF or a raw photo", "convert it to PNG or JPEG of the same size"));
    }
    None
}
