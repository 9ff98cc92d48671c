//! The rules of the house that a machine can check.

use crate::common::root;
use std::fs;
use std::path::{Path, PathBuf};

/// A file of the repository: path from its root with forward slashes, and contents.
struct Source {
    path: String,
    text: String,
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    crate::common::files_below(folder).into_iter().map(|path| folder.join(path)).collect()
}

fn sources(folders: &[&str], extensions: &[&str]) -> Vec<Source> {
    let root = root();
    folders
        .iter()
        .flat_map(|folder| files_below(&root.join(folder)))
        .filter(|path| path.extension().is_some_and(|e| extensions.iter().any(|wanted| e == *wanted)))
        .map(|path| Source {
            text: fs::read_to_string(&path).expect("sources are text"),
            path: path.strip_prefix(&root).expect("below the root").to_string_lossy().replace('\\', "/"),
        })
        .collect()
}

fn lines_with(sources: &[Source], is_found: impl Fn(&str) -> bool) -> Vec<String> {
    let of_source = |source: &Source| {
        let lines = code_lines(&source.text).filter(|(_, line)| is_found(line));
        let place = |(number, line): (usize, &str)| format!("{}:{number}: {}", source.path, line.trim());
        lines.map(place).collect::<Vec<String>>()
    };
    sources.iter().flat_map(of_source).collect()
}

fn assert_none(rule: &str, violations: Vec<String>) {
    assert!(violations.is_empty(), "{rule}:\n  {}", violations.join("\n  "));
}

/// Code without line comments; strings stay.
fn without_comment(line: &str) -> &str {
    line.split("//").next().unwrap_or_default()
}

/// Lines of code (number from 1, text without comment) in front of the unit tests of a file.
fn code_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .take_while(|line| !line.trim_start().starts_with("#[cfg(test)]"))
        .enumerate()
        .map(|(number, line)| (number + 1, without_comment(line)))
}

fn has_word(line: &str, word: &str) -> bool {
    line.match_indices(word).any(|(at, _)| {
        let part_of_name = |c: char| c.is_alphanumeric() || c == '_';
        let before = line[..at].chars().next_back();
        let after = line[at + word.len()..].chars().next();
        !before.is_some_and(part_of_name) && !after.is_some_and(part_of_name)
    })
}

// ---- `unsafe` only in engine/vk -----------------------------------------------------------------------------------

#[test]
fn architecture_unsafe_only_under_vk() {
    // Hosts in raw Vulkan cannot be written otherwise: the examples that embed, the tests that do, and the program's
    // window. Nor can functions that C calls, nor a layer, which Vulkan's loader calls, nor Ctrl-Break be sent.
    let allowed = [
        "engine/vk/",
        "tools/embed/",
        "tools/embed_wgpu/",
        "tools/capi/",
        "tools/mock_layer/",
        "tools/view/window/present/",
        "tests/embedding/",
        "tests/program/running.rs",
    ];
    let is_unsafe = |line: &str| has_word(without_comment(line), concat!("un", "safe"));
    let sources = sources(&["engine", "tools", "tests"], &["rs"]).into_iter();
    let others = sources.filter(|source| !allowed.iter().any(|folder| source.path.starts_with(folder)));
    let places = others.filter(|source| source.text.lines().any(is_unsafe)).map(|source| source.path);
    assert_none("only engine/vk, hosts and the C interface may do this", places.collect());
}

// ---- code in general ----------------------------------------------------------------------------------------------

#[test]
fn architecture_errors_are_returned() {
    let panics = [concat!("to", "do!("), concat!("unimpl", "emented!(")];
    let calls = [concat!(".un", "wrap()"), concat!(".ex", "pect("), panics[0], panics[1]];
    let mut sources = sources(&["engine", "tools"], &["rs"]);
    // Compiled into build.rs alone, like build.rs itself; or tests.
    sources.retain(|source| !source.path.starts_with("engine/kernels/") && !source.path.contains("/tests/"));
    let found = lines_with(&sources, |line| calls.iter().any(|call| line.contains(call)));
    assert_none("unwrap or expect outside tests", found);
}

// ---- readers: contents must not decide length of queues, or waits --------------------------------------------------

/// The program's crates, and the C interface.
const PROGRAMS: [&str; 6] =
    ["tools/ashsplat", "tools/bench", "tools/capi", "tools/program", "tools/scale", "tools/view"];

#[test]
fn architecture_channels_are_bounded() {
    let sources = sources(&[&["engine"], &PROGRAMS[..]].concat(), &["rs"]);
    let unbounded = |line: &str| has_word(line, "unbounded_channel") || line.contains("mpsc::channel");
    let rule = "a queue that nobody empties must not grow: give channels a bound";
    assert_none(rule, lines_with(&sources, unbounded));
}

/// Ways to open a file without checking its kind and length.
const UNCHECKED: [&str; 7] = [
    "File::open",
    "fs::read",
    "fs::read_to_string",
    "fs::copy",
    "image::open",
    "ImageReader::open",
    ".read(true)",
];

/// Files that use them, with the reason.
const MAY_OPEN: [(&str, &str); 4] = [
    ("engine/files/regular_file.rs", "asks both"),
    ("engine/files/atomic.rs", "opens a folder, to synchronise it"),
    ("engine/files/host_memory.rs", "files of /proc and /sys"),
    ("tools/program/lock.rs", "opens its lock for reading and writing, which waits for nobody"),
];

#[test]
fn architecture_files_are_opened_in_one_way() {
    let mut sources = sources(&[&["engine/files"], &PROGRAMS[..]].concat(), &["rs"]);
    let may_open = |path: &str| MAY_OPEN.iter().any(|(own, _)| *own == path);
    sources.retain(|source| !may_open(&source.path) && !source.path.contains("/tests/"));
    let opens = |line: &str| UNCHECKED.iter().any(|call| has_word(line, call));
    let rule = "regular_file::open refuses pipes and devices: readers use it";
    assert_none(rule, lines_with(&sources, opens));
}

// ---- links of the documents ----------------------------------------------------------------------------------------

fn documents() -> Vec<PathBuf> {
    let mut found = ["README.md", "CHANGELOG.md"].map(|name| root().join(name)).to_vec();
    found.extend(["engine/guide", "tools"].iter().flat_map(|folder| files_below(&root().join(folder))));
    found.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
    found
}

/// Targets of links outside of code, after `](` and `]: `. rustdoc checks the items that they name.
fn links(text: &str) -> Vec<&str> {
    let mut is_code = false;
    let prose = text.lines().filter(|line| {
        is_code ^= line.trim_start().starts_with("```");
        !is_code
    });
    let mut found = Vec::new();
    for line in prose {
        found.extend(line.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next()));
        let defined = line.starts_with('[').then(|| line.split_once("]: ")).flatten();
        found.extend(defined.and_then(|(_, target)| target.split([' ', '#']).next()));
    }
    found.retain(|target| !target.is_empty() && !target.contains("://") && !target.contains("::"));
    found
}

#[test]
fn architecture_links_of_documents_lead_somewhere() {
    for document in documents() {
        let text = std::fs::read_to_string(&document).expect("text");
        let folder = document.parent().expect("a folder");
        for target in links(&text) {
            assert!(folder.join(target).exists(), "{}: no {target}", document.display());
        }
    }
}
