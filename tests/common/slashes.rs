//! Separators of paths in texts of the program.

/// Text of the program with the separators that tests write.
pub fn with_slashes(text: &str) -> String {
    if cfg!(windows) { text.replace('\\', "/") } else { text.to_owned() }
}
