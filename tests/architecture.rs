//! Dependencies between the engine's modules point one way, and links of documents lead somewhere.

use crate::common::{files_below, root};
use std::collections::HashMap;
use std::path::PathBuf;

/// A source of Rust: path from the root with forward slashes, and code without line comments. Strings stay.
struct Source {
    path: String,
    code: String,
}

fn sources(folder: &str) -> Vec<Source> {
    let mut files = files_below(&root().join(folder));
    files.retain(|path| path.extension().is_some_and(|extension| extension == "rs"));
    let read = |path: PathBuf| {
        let text = std::fs::read_to_string(root().join(folder).join(&path)).expect("sources are text");
        let code = text.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned() + "\n");
        Source { path: format!("{folder}/{}", path.display()).replace('\\', "/"), code: code.collect() }
    };
    files.into_iter().map(read).collect()
}

fn assert_none(rule: &str, violations: Vec<String>) {
    assert!(violations.is_empty(), "{rule}:\n  {}", violations.join("\n  "));
}

/// True if the order of the modules lets one name the other.
fn may_name(module: &str, target: &str) -> bool {
    const ORDER: [&str; 8] = ["error", "scene", "vk", "kernels", "frame", "passes", "render", "train"];
    let floor = |name: &str| ORDER.iter().position(|room| *room == name).unwrap_or(ORDER.len());
    floor(target) < floor(module) && !(module == "vk" && target == "scene")
}

fn module_of(path: &str) -> &str {
    let below = path.strip_prefix("engine/").unwrap_or(path);
    below.split('/').next().unwrap_or(below).trim_end_matches(".rs")
}

/// The first name behind each `crate::`. Groups in braces, which would hide names, are refused.
fn names_used(code: &str) -> Vec<String> {
    let paths = code.match_indices("crate::").filter(|(at, _)| !code[..*at].ends_with('$'));
    let name = |(at, found): (usize, &str)| first_name(&code[at + found.len()..]);
    paths.map(|path| name(path).expect("a name, not a group, behind `crate::`")).collect()
}

fn first_name(text: &str) -> Option<String> {
    let name: String = text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    (!name.is_empty()).then_some(name)
}

/// Which module each name that lib.rs re-exports belongs to.
fn re_exports(lib: &str) -> HashMap<String, String> {
    let mut exports = HashMap::new();
    for statement in lib.split(';') {
        let Some((_, path)) = statement.split_once("pub use ") else { continue };
        let module = first_name(path).unwrap_or_default();
        let names = path.split(|c: char| !(c.is_alphanumeric() || c == '_')).filter(|name| !name.is_empty());
        exports.extend(names.map(|name| (name.to_owned(), module.clone())));
    }
    exports
}

fn forbidden_arrows(source: &Source, exports: &HashMap<String, String>) -> Vec<String> {
    let module = module_of(&source.path);
    // The table of tunings and the hash of data count as the lowest module, which all may name.
    let ground = ["crate::frame::tuning::", "crate::scene::Fingerprint"];
    let code = ground.iter().fold(source.code.clone(), |code, path| code.replace(path, "crate::error::"));
    names_used(&code)
        .into_iter()
        .map(|name| exports.get(&name).cloned().unwrap_or(name))
        .filter(|target| module != "lib" && target != module && !may_name(module, target))
        .map(|target| format!("{}: {module} → {target}", source.path))
        .collect()
}

#[test]
fn dependencies_between_modules_point_one_way() {
    // The crate of files is left out, because Cargo itself keeps it above the engine.
    let (files, engine): (Vec<_>, Vec<_>) =
        sources("engine").into_iter().partition(|source| source.path.starts_with("engine/files/"));
    let lib = engine.iter().find(|source| source.path == "engine/lib.rs").expect("the crate has a root");
    let exports = re_exports(&lib.code);
    let arrows = engine.iter().flat_map(|source| forbidden_arrows(source, &exports)).collect();
    assert_none("arrows against the order of the modules", arrows);
    let vulkan = files.into_iter().filter(|source| source.code.contains("ashsplat::vk"));
    assert_none("files know no Vulkan", vulkan.map(|source| source.path).collect());
}

fn documents() -> Vec<PathBuf> {
    let mut found = ["README.md", "CHANGELOG.md"].map(|name| root().join(name)).to_vec();
    for folder in ["engine/guide", "tools"].map(|folder| root().join(folder)) {
        found.extend(files_below(&folder).into_iter().map(|path| folder.join(path)));
    }
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
