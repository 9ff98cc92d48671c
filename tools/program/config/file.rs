//! Settings files: settings.toml and the reference's `cfg_args`.

use super::{DefaultsInput, SETTINGS_FILE, Settings};
use ashsplat::{Error, Result};
use ashsplat_files::regular_file;
use std::path::Path;
use toml::Table;

/// Largest settings file. A longer file is something else, and may exceed the memory.
const MAX_BYTES: u64 = 1 << 20;

pub fn text(path: &Path) -> Result<String> {
    let refuse = |problem: String| {
        Error::input(path, problem, "give one that `ashsplat train` wrote, such as settings.toml")
    };
    let bytes = regular_file::read_at_most(path, MAX_BYTES)?
        .ok_or_else(|| refuse(format!("is longer than {MAX_BYTES} bytes: no file of settings")))?;
    ashsplat_files::text::from_bytes(path, bytes)
}

pub fn dump_line() -> String {
    format!("# Read back by: ashsplat train --config {SETTINGS_FILE}\n")
}

/// True if the file is a settings dump of a run.
pub fn is_dump(path: &Path) -> Result<bool> {
    Ok(text(path)?.starts_with(dump_line().trim_end()))
}

/// The text of `key=value` in a Python `Namespace(…)` line; values with commas are not supported.
pub fn cfg_value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let fields = text.trim().strip_prefix("Namespace(")?.strip_suffix(')')?;
    fields.split(", ").find_map(|field| field.strip_prefix(key)?.strip_prefix('='))
}

/// Reads and checks the settings of a file.
pub fn table(path: &Path) -> Result<Table> {
    let text = text(path)?;
    let remedy =
        "see `ashsplat train --help`; here names have underscores, and a line is such as `iterations = 7000`";
    let table: Table = text.parse().map_err(|e: toml::de::Error| {
        let line = e.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
        Error::input(path, format!("line {line}: {}", e.message()), remedy)
    })?;
    Settings::from_table(table.clone(), &DefaultsInput::default())
        .map_err(|problem| Error::input(path, problem, remedy))?;
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;

    #[test]
    fn settings_may_have_a_byte_order_mark() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("settings.toml");
        std::fs::write(&path, b"\xef\xbb\xbfiterations = 5\n").expect("written");
        assert_eq!(table(&path).expect("settings")["iterations"].as_integer(), Some(5));
        std::fs::write(&path, b"\xff\xfei\0t\0").expect("written");
        assert!(text(&path).expect_err("refused").to_string().contains("is text in UTF-16"));
    }

    #[test]
    fn a_file_of_any_length_is_refused_after_a_mebibyte() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("settings.toml");
        let fits = format!("#{}\n", " ".repeat(MAX_BYTES as usize - 2));
        std::fs::write(&path, &fits).expect("written");
        assert!(table(&path).expect("settings").is_empty());
        File::options().write(true).open(&path).and_then(|file| file.set_len(1 << 31)).expect("longer");
        let problem = table(&path).expect_err("too long").to_string();
        assert!(problem.contains("settings.toml") && problem.contains("longer than"), "{problem}");
    }
}
