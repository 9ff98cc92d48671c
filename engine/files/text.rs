//! Decodes text of other programs: with a byte-order mark, in Latin-1, with decimal commas.

use crate::regular_file;
use ashsplat::{Error, Result};
use serde::de::DeserializeOwned;
use std::path::Path;
use std::str::FromStr;

/// Reads the text of a whole JSON file, without its byte-order mark.
pub(crate) fn read(path: &Path) -> Result<String> {
    from_bytes(path, regular_file::read_json(path)?)
}

/// Reads a JSON file. `kind` and `remedy`: what the file should be.
pub(crate) fn json<T: DeserializeOwned>(path: &Path, kind: &str, remedy: &str) -> Result<T> {
    let problem = |e: serde_json::Error| Error::input(path, format!("is not {kind}: {e}"), remedy);
    serde_json::from_str(&read(path)?).map_err(problem)
}

/// Decodes the bytes of a file, without its byte-order mark.
pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<String> {
    if let Some((problem, remedy)) = regular_file::utf16(&bytes) {
        return Err(Error::input(path, problem, remedy));
    }
    let text = decoded(bytes);
    Ok(text.strip_prefix(MARK).map(str::to_owned).unwrap_or(text))
}

/// UTF-8's byte-order mark, which Windows' editors write.
pub(crate) const MARK: char = '\u{feff}';

/// Decodes UTF-8, or else Latin-1, for names from older systems.
pub(crate) fn decoded(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes)
        .unwrap_or_else(|error| error.as_bytes().iter().copied().map(char::from).collect())
}

/// Parses this many numbers with commas between them.
pub fn numbers<T: FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// Hint about a word that is not a number, if it has a decimal comma.
pub(crate) fn not_a_number(word: &str) -> &'static str {
    match word.contains(',') && word.replacen(',', ".", 1).parse::<f64>().is_ok() {
        true => " (a decimal comma: write numbers with a point)",
        false => "",
    }
}
