//! Helpers of the tests that write files.

use std::path::Path;

/// Names in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entry = |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = std::fs::read_dir(folder).unwrap().map(entry).collect();
    names.sort();
    names
}

/// Calls `check` with `bytes` cut at each of their [`places`] (length, written to `path`).
pub fn for_each_truncation(path: &Path, bytes: &[u8], mut check: impl FnMut(usize)) {
    for length in places(bytes) {
        replace(path, &bytes[..length]);
        check(length);
    }
}

/// Calls `check` with the byte at each of their [`places`] replaced in turn by several others (place, written to `path`).
pub fn for_each_mutation(path: &Path, bytes: &[u8], mut check: impl FnMut(usize)) {
    let mut mutated = bytes.to_vec();
    for place in places(bytes) {
        for change in [0x00, 0xff, 0x7f, b'9', b' ', b'\n', bytes[place] ^ 1, bytes[place] ^ 0x80] {
            mutated[place] = change;
            replace(path, &mutated);
            check(place);
        }
        mutated[place] = bytes[place];
    }
}

/// Where to cut or to change a file: everywhere at its beginning and its end, every third byte between, where elements are alike.
fn places(bytes: &[u8]) -> impl Iterator<Item = usize> + use<> {
    let (begin, end) = (512, bytes.len().saturating_sub(64));
    (0..bytes.len()).filter(move |place| *place < begin || *place >= end || place % 3 == 0)
}

/// Writes a new file: file systems that flush an overwritten one to the disk would make the loops slow.
fn replace(path: &Path, bytes: &[u8]) {
    let _ = std::fs::remove_file(path);
    std::fs::write(path, bytes).unwrap();
}
