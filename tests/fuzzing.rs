//! The crate that fuzzes the readers (tests/fuzz) is built by hand, with another compiler: what can be said of it here.

use std::path::Path;

/// What the readers are made of; the fuzzing crate compiles them from their own place.
const READERS: [&str; 7] = [
    "engine/io",
    "engine/scene",
    "engine/trainer/checkpoint",
    "engine/trainer/settings.rs",
    "engine/error.rs",
    "engine/fingerprint.rs",
    "engine/metrics.rs",
];

fn sources(path: &Path, found: &mut String) {
    if path.is_dir() {
        for entry in std::fs::read_dir(path).expect("a folder") {
            sources(&entry.expect("an entry").path(), found);
        }
    } else if path.extension().is_some_and(|extension| extension == "rs") {
        let text = std::fs::read_to_string(path).expect("a source");
        text.lines().filter(|line| !line.trim_start().starts_with("//")).for_each(|line| *found += line);
    }
}

/// Lines of `[dependencies]`: name and the rest.
fn dependencies(manifest: &str) -> Vec<(&str, &str)> {
    let lines = manifest.lines().skip_while(|line| *line != "[dependencies]").skip(1);
    lines.take_while(|line| !line.starts_with('[')).filter_map(|line| line.split_once(" = ")).collect()
}

/// What the readers use and the fuzzing crate has not, or has in another version.
fn missing<'a>(own: &[(&'a str, &str)], fuzzing: &[(&str, &str)], sources: &str) -> Vec<&'a str> {
    let used = own.iter().filter(|(name, _)| sources.contains(&format!("{}::", name.replace('-', "_"))));
    used.filter(|dependency| !fuzzing.contains(dependency)).map(|(name, _)| *name).collect()
}

/// Modules of the crate that the readers name and the fuzzing crate has not.
fn missing_modules<'a>(sources: &'a str, fuzzing: &str) -> Vec<&'a str> {
    let end = |text: &str| text.find(|c: char| !(c.is_ascii_lowercase() || c == '_')).unwrap_or(text.len());
    let mut named: Vec<&str> = sources.split("crate::").skip(1).map(|text| &text[..end(text)]).collect();
    named.sort_unstable();
    named.dedup();
    named.retain(|name| !name.is_empty() && !fuzzing.contains(&format!("pub mod {name};")));
    named
}

#[test]
fn fuzzing_has_the_readers_modules() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let fuzzing = std::fs::read_to_string(root.join("tests/fuzz/src/lib.rs")).expect("a source");
    let mut readers = String::new();
    READERS.iter().for_each(|path| sources(&root.join(path), &mut readers));
    assert_eq!(missing_modules(&readers, &fuzzing), [""; 0], "add it to tests/fuzz/src/lib.rs");
    assert_eq!(missing_modules("use crate::{Error}; use crate::vk::Buffer;", &fuzzing), ["vk"]);
}

#[test]
fn fuzzing_has_the_readers_dependencies() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest = |path: &str| std::fs::read_to_string(root.join(path)).expect("a manifest");
    let (own, fuzzing) = (manifest("Cargo.toml"), manifest("tests/fuzz/Cargo.toml"));
    let mut readers = String::new();
    READERS.iter().for_each(|path| sources(&root.join(path), &mut readers));
    let (own, fuzzing) = (dependencies(&own), dependencies(&fuzzing));
    assert_eq!(missing(&own, &fuzzing, &readers), [""; 0], "add it to tests/fuzz/Cargo.toml");
    assert!(missing(&own, &[], &readers).contains(&"serde_json"), "the rule finds nothing");
}
