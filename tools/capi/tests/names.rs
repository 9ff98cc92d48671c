//! Every call that the engine's messages advise has a name in C.

#![allow(clippy::disallowed_methods, clippy::expect_used)]

use ashsplat_c::CALLS;
use std::path::{Path, PathBuf};

/// Calls of Rust types that have no counterpart in C.
const RUST_ALONE: [&str; 2] = ["Renderer::set_blending", "TrainSettings::reference"];
/// Prefix of fields that messages write like calls.
const FIELDS: &str = "Reservation::";

/// Names of a struct's public fields in a source or a header, between `start` and `end`.
fn fields<'a>(
    text: &'a str,
    [start, end]: [&str; 2],
    name: impl Fn(&'a str) -> Option<&'a str>,
) -> Vec<&'a str> {
    let (_, text) = text.split_once(start).expect("the struct");
    let (text, _) = text.split_once(end).expect("its end");
    text.lines().filter_map(|line| name(line.trim())).collect()
}

#[test]
fn a_reservations_fields_have_their_names_in_c() {
    let rust = include_str!("../../../engine/render/reservation.rs");
    let rust = fields(rust, ["pub struct Reservation {", "\n}"], |line| {
        Some(line.strip_prefix("pub ")?.split_once(':')?.0)
    });
    let c = fields(include_str!("../ashsplat.h"), ["typedef struct AshsplatReservation {", "\n}"], |line| {
        Some(line.strip_suffix(';')?.rsplit_once(' ')?.1)
    });
    assert!(rust.len() > 20, "{rust:?}");
    for field in rust {
        assert!(
            c.contains(&field),
            "messages name AshsplatReservation.{field}, which the header does not have"
        );
    }
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries
        .flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] })
        .filter(|path| path.extension().is_some_and(|ending| ending == "rs"))
        .collect()
}

/// `Type::function` in the texts of a line of source.
fn calls(line: &str) -> impl Iterator<Item = String> {
    let texts = line.split('"').skip(1).step_by(2);
    let words = texts.flat_map(|text| text.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')));
    let is_call = |word: &&str| {
        word.split_once("::").is_some_and(|(of, call)| {
            of.starts_with(char::is_uppercase) && call.starts_with(char::is_lowercase)
        })
    };
    words.map(|word| word.trim_end_matches(':')).filter(is_call).map(str::to_owned)
}

#[test]
fn advised_calls_have_names_in_c() {
    let engine = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../engine");
    let mut found = 0;
    for path in ["render", "train", "vk"].into_iter().flat_map(|folder| sources(&engine.join(folder))) {
        let text = std::fs::read_to_string(&path).expect("a source");
        let code = text.split("#[cfg(test)]").next().unwrap_or_default();
        let lines =
            code.lines().filter(|line| !line.trim_start().starts_with("//") && !line.contains("panic!"));
        for call in lines
            .flat_map(calls)
            .filter(|call| !RUST_ALONE.contains(&call.as_str()) && !call.starts_with(FIELDS))
        {
            let known = CALLS.iter().any(|(rust, _)| *rust == call);
            assert!(known, "{}: '{call}' has no name in C: see CALLS", path.display());
            found += 1;
        }
    }
    assert!(found >= CALLS.len(), "{found} found: the messages are elsewhere");
    let header = include_str!("../ashsplat.h");
    for (_, name) in CALLS {
        assert!(header.contains(&format!(" {name}(")), "{name} is not in the header");
    }
}
