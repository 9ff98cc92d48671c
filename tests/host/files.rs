//! Helpers of the tests that write files.

use std::path::Path;

/// Sorted names in a folder.
pub fn names(folder: &Path) -> Vec<String> {
    let entry = |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = std::fs::read_dir(folder).unwrap().map(entry).collect();
    names.sort();
    names
}

/// Cuts `bytes` at each of their [`places`], writes the file and calls `check` with the length.
pub fn for_each_truncation(path: &Path, bytes: &[u8], mut check: impl FnMut(usize)) {
    for length in places(bytes) {
        replace(path, &bytes[..length]);
        check(length);
    }
}

/// Replaces the byte at each of the [`places`] by several others, writes the file and calls `check` with the place.
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

/// Places to cut or change a file: all near its beginning and end, every third byte between.
fn places(bytes: &[u8]) -> impl Iterator<Item = usize> + use<> {
    let (begin, end) = (512, bytes.len().saturating_sub(64));
    (0..bytes.len()).filter(move |place| *place < begin || *place >= end || place % 3 == 0)
}

/// Writes a new file, because file systems may flush overwritten files to the disk, which is slow.
fn replace(path: &Path, bytes: &[u8]) {
    let _ = std::fs::remove_file(path);
    std::fs::write(path, bytes).unwrap();
}
