//! The rules of the house that a machine can check. Each rule also has an example that it must reject.

mod links;
mod readers;
mod shaders;

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

/// A file of the repository: path from its root with forward slashes, and contents.
struct Source {
    path: String,
    text: String,
}

fn root() -> PathBuf {
    crate::common::root()
}

fn files_below(folder: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            files_below(&path, found);
        } else {
            found.push(path);
        }
    }
}

/// The sources of some folders with some extensions.
fn sources(folders: &[&str], extensions: &[&str]) -> Vec<Source> {
    let root = root();
    let mut paths = Vec::new();
    for folder in folders {
        files_below(&root.join(folder), &mut paths);
    }
    paths
        .into_iter()
        .filter(|path| path.extension().is_some_and(|e| extensions.iter().any(|wanted| e == *wanted)))
        .map(|path| Source {
            text: fs::read_to_string(&path).expect("sources are text"),
            path: path.strip_prefix(&root).expect("below the root").to_string_lossy().replace('\\', "/"),
        })
        .collect()
}

/// Fails with all the violations of a rule at once.
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

fn unsafe_outside_vk(source: &Source) -> Vec<String> {
    // Hosts in raw Vulkan cannot be written otherwise: the examples that embed, the tests that do, and the program's
    // window. Nor can functions that C calls, nor a layer, which Vulkan's loader calls.
    let window = "tools/ashsplat/view/window/present/";
    let embed = ["tools/embed/", "tools/embed_wgpu/"];
    let allowed =
        ["engine/vk/", embed[0], embed[1], "tools/capi/", "tools/mock_layer/", "tests/embedding/", window];
    if allowed.iter().any(|folder| source.path.starts_with(folder)) {
        return vec![];
    }
    let lines = source.text.lines().enumerate();
    lines
        .filter(|(_, line)| has_word(without_comment(line), concat!("un", "safe")))
        .map(|(number, _)| format!("{}:{}", source.path, number + 1))
        .collect()
}

#[test]
fn architecture_unsafe_only_under_vk() {
    let example = Source { path: "engine/sort.rs".into(), text: concat!("un", "safe { f() }").into() };
    assert_eq!(unsafe_outside_vk(&example).len(), 1);
    let sources = sources(&["engine", "tools", "tests"], &["rs"]);
    assert_none(
        "only engine/vk, hosts and the C interface may do this",
        sources.iter().flat_map(unsafe_outside_vk).collect(),
    );
}

// ---- dependencies between modules ---------------------------------------------------------------------------------

const STAGES: [&str; 16] = [
    "scan",
    "sort",
    "arithmetic",
    "subgroups",
    "forward",
    "pixels",
    "planes",
    "poses",
    "backward",
    "compose",
    "loss",
    "exposure",
    "lens_effects",
    "lpips",
    "optimizer",
    "densify",
];
const DOORS: [&str; 2] = ["renderer", "trainer"];

/// The modules that a module may name.
fn allowed(module: &str) -> Vec<&'static str> {
    let mut allowed = vec!["error", "fingerprint", "tuning"];
    match module {
        "error" | "tuning" => {}
        "scene" => allowed.extend(["scene"]),
        "vk" => {}
        "kernels" => allowed.extend(["vk"]),
        "plan" => allowed.extend(["vk", "scene", "kernels"]),
        stage if STAGES.contains(&stage) => {
            allowed.extend(["vk", "scene", "kernels", "plan"]);
            allowed.extend(STAGES);
        }
        _ => {
            allowed.extend(["vk", "scene", "kernels", "plan"]);
            allowed.extend(STAGES);
            allowed.extend(DOORS);
        }
    }
    allowed
}

/// The module of a file of the engine.
fn module_of(path: &str) -> &str {
    let below = path.strip_prefix("engine/").unwrap_or(path);
    below.split('/').next().unwrap_or(below).trim_end_matches(".rs")
}

/// The first names behind each `crate::`, also within braces.
fn names_used(text: &str) -> Vec<String> {
    let code: String = text.lines().map(|line| without_comment(line).to_owned() + "\n").collect();
    let mut names = Vec::new();
    for (at, found) in code.match_indices("crate::") {
        if code[..at].ends_with('$') {
            continue;
        }
        let rest = &code[at + found.len()..];
        match rest.strip_prefix('{') {
            None => names.extend(first_name(rest)),
            Some(group) => {
                let mut depth = 0;
                let mut start = 0;
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
    let allowed = allowed(module);
    names_used(&source.text)
        .into_iter()
        .map(|name| exports.get(&name).cloned().unwrap_or(name))
        .filter(|target| target != module && !allowed.contains(&target.as_str()))
        .map(|target| format!("{}: {module} → {target}", source.path))
        .collect()
}

#[test]
fn architecture_dependencies_point_one_way() {
    let lib = "pub use error::{Error, Result}; pub use renderer::Renderer;";
    let exports = re_exports(lib);
    let check = |path: &str, text: &str| {
        forbidden_arrows(&Source { path: path.into(), text: text.into() }, &exports).len()
    };
    assert_eq!(check("engine/scene/camera.rs", "use crate::vk::Context;"), 1);
    assert_eq!(check("engine/vk/memory.rs", "use crate::{Error, scene::{Camera, Gaussians}};"), 1);
    assert_eq!(check("engine/sort.rs", "fn f() { crate::Renderer::new() }"), 1);
    assert_eq!(check("engine/sort.rs", "use crate::{Result, vk::Buffer, scan::Scan};"), 0);

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
    let only_public = tools_inside_engine();
    assert_none("tools stand on the public API only", only_public);
}

/// Paths of the tools into the engine's files other than through the crate.
fn tools_inside_engine() -> Vec<String> {
    sources(&["tools"], &["rs"])
        .iter()
        .filter(|source| source.text.contains("engine/"))
        .filter(|source| source.text.contains("#[path") || source.text.contains("include!"))
        .map(|source| source.path.clone())
        .collect()
}

// ---- code in general ----------------------------------------------------------------------------------------------

fn panicking_calls(source: &Source) -> Vec<String> {
    let calls = [
        concat!(".un", "wrap()"),
        concat!(".ex", "pect("),
        concat!("to", "do!("),
        concat!("unimpl", "emented!("),
    ];
    // Compiled into build.rs alone, like build.rs itself; or tests.
    if source.path.starts_with("engine/kernels/") || source.path.contains("/tests/") {
        return vec![];
    }
    code_lines(&source.text)
        .filter(|(_, line)| calls.iter().any(|call| line.contains(call)))
        .map(|(number, line)| format!("{}:{number}: {}", source.path, line.trim()))
        .collect()
}

#[test]
fn architecture_errors_are_returned() {
    let example = Source { path: "engine/a.rs".into(), text: concat!("let x = y.un", "wrap();").into() };
    assert_eq!(panicking_calls(&example).len(), 1);
    let tested =
        Source { path: "engine/a.rs".into(), text: concat!("#[cfg(test)]\nlet x = y.un", "wrap();").into() };
    assert_eq!(panicking_calls(&tested).len(), 0);
    let sources = sources(&["engine", "tools"], &["rs"]);
    assert_none("unwrap or expect outside tests", sources.iter().flat_map(panicking_calls).collect());
}

/// Files whose contents equal a file of another folder.
fn copies(files: &[PathBuf], others: &[PathBuf]) -> Vec<String> {
    let size = |path: &PathBuf| fs::metadata(path).map_or(0, |metadata| metadata.len());
    let mut by_size: HashMap<u64, Vec<&PathBuf>> = HashMap::new();
    for other in others {
        by_size.entry(size(other)).or_default().push(other);
    }
    let mut copies = Vec::new();
    for file in files {
        let length = size(file);
        let same_length = by_size.get(&length).filter(|_| length > 16);
        for other in same_length.into_iter().flatten() {
            if fs::read(file).ok() == fs::read(other).ok() {
                copies.push(format!("{} = {}", file.display(), other.display()));
            }
        }
    }
    copies
}

#[test]
fn architecture_nothing_is_copied_from_the_shared_folder() {
    let shared = crate::common::shared_folder();
    if !shared.exists() {
        eprintln!("skipped: {} is absent", shared.display());
        return;
    }
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for folder in ["engine", "glsl", "tools", "tests", "docs", ".ci"] {
        files_below(&root().join(folder), &mut ours);
    }
    files_below(&shared, &mut theirs);
    assert_none("copied", copies(&ours, &theirs));
    assert_eq!(copies(&ours[..1], &ours[..1]).len(), 1, "a copy would be found");
}
