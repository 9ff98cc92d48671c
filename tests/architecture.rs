//! The rules of the house that a machine can check.

use crate::common::root;
use std::collections::HashMap;
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

// ---- dependencies between modules ---------------------------------------------------------------------------------

/// True if the order of the rooms lets one name the other. The table of tunings and the hash of data stand on the ground.
fn may_name(module: &str, target: &str) -> bool {
    const ORDER: [&str; 8] = ["error", "scene", "vk", "kernels", "frame", "passes", "render", "train"];
    let floor = |name: &str| ORDER.iter().position(|room| *room == name).unwrap_or(ORDER.len());
    floor(target) < floor(module) && !(module == "vk" && target == "scene")
}

fn module_of(path: &str) -> &str {
    let below = path.strip_prefix("engine/").unwrap_or(path);
    below.split('/').next().unwrap_or(below).trim_end_matches(".rs")
}

/// The first names behind each `crate::`, also within braces.
fn names_used(text: &str) -> Vec<String> {
    let code: String = text.lines().map(|line| without_comment(line).to_owned() + "\n").collect();
    let mut names = Vec::new();
    for (at, found) in code.match_indices("crate::").filter(|(at, _)| !code[..*at].ends_with('$')) {
        let rest = &code[at + found.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            names.extend(first_name(rest));
            continue;
        };
        let (mut depth, mut start) = (0, 0);
        for (place, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth > 0 => depth -= 1,
                ',' | '}' if depth == 0 => {
                    names.extend(first_name(&group[start..place]));
                    start = place + 1;
                    if c == '}' {
                        break;
                    }
                }
                _ => {}
            }
        }
    }
    names
}

fn first_name(text: &str) -> Option<String> {
    let name: String = text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    (!name.is_empty()).then_some(name)
}

/// Which module each name that lib.rs re-exports belongs to.
fn re_exports(lib: &str) -> HashMap<String, String> {
    let mut exports = HashMap::new();
    let code: String = lib.lines().map(|line| without_comment(line).to_owned() + " ").collect();
    for statement in code.split(';') {
        let Some((_, path)) = statement.split_once("pub use ") else { continue };
        let module = first_name(path).unwrap_or_default();
        let names = path.split(|c: char| !(c.is_alphanumeric() || c == '_')).filter(|name| !name.is_empty());
        for name in names {
            exports.insert(name.to_owned(), module.clone());
        }
    }
    exports
}

fn forbidden_arrows(source: &Source, exports: &HashMap<String, String>) -> Vec<String> {
    let module = module_of(&source.path);
    if module == "lib" {
        return vec![];
    }
    let ground = ["crate::frame::tuning::", "crate::scene::Fingerprint"];
    let text = ground.iter().fold(source.text.clone(), |text, path| text.replace(path, "crate::error::"));
    names_used(&text)
        .into_iter()
        .map(|name| exports.get(&name).cloned().unwrap_or(name))
        .filter(|target| target != module && !may_name(module, target))
        .map(|target| format!("{}: {module} → {target}", source.path))
        .collect()
}

#[test]
fn architecture_dependencies_point_one_way() {
    let sources = sources(&["engine"], &["rs"]);
    let lib = sources.iter().find(|s| s.path == "engine/lib.rs").expect("the crate has a root");
    let exports = re_exports(&lib.text);
    // The crate of files has names of its own: Cargo sees to it that it stands above the engine.
    let (files, engine): (Vec<_>, Vec<_>) =
        sources.iter().partition(|source| source.path.starts_with("engine/files/"));
    let arrows = engine.iter().flat_map(|source| forbidden_arrows(source, &exports)).collect();
    assert_none("arrows against the order of the modules", arrows);
    assert!(!files.is_empty());
    let vulkan = files.iter().filter(|source| source.text.contains(concat!("ashsplat::", "vk")));
    assert_none("files know no Vulkan", vulkan.map(|source| source.path.clone()).collect());
    // Paths of the tools into the engine's files other than through the crate.
    let tools = self::sources(&["tools"], &["rs"]);
    let includes = |text: &str| text.contains("#[path") || text.contains("include!");
    let inside = tools.iter().filter(|source| source.text.contains("engine/") && includes(&source.text));
    assert_none("tools stand on the public API only", inside.map(|source| source.path.clone()).collect());
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

// ---- data ---------------------------------------------------------------------------------------------------------

/// No file has the bytes of one of the shared folder. Files of a few bytes may agree by chance.
#[test]
fn architecture_nothing_is_copied_from_the_shared_folder() {
    let size = |path: &Path| path.metadata().map_or(0, |metadata| metadata.len());
    let mut shared: HashMap<u64, Vec<PathBuf>> = HashMap::new();
    for path in files_below(&crate::common::shared_folder()) {
        shared.entry(size(&path)).or_default().push(path);
    }
    let is_copy = |path: &PathBuf| {
        let mut of_its_size = shared.get(&size(path)).into_iter().flatten();
        size(path) > 16 && of_its_size.any(|other| fs::read(path).ok() == fs::read(other).ok())
    };
    let folders = ["engine", "glsl", "tools", "tests", ".ci"].map(|folder| files_below(&root().join(folder)));
    let copies = folders.into_iter().flatten().filter(is_copy).map(|path| path.display().to_string());
    assert_none("copied", copies.collect());
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
