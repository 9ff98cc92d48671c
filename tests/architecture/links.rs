//! Links of the documents lead somewhere.

use std::path::{Path, PathBuf};

use super::{files_below, root};

fn documents() -> Vec<PathBuf> {
    let mut found = ["README.md", "CHANGELOG.md"].map(|name| root().join(name)).to_vec();
    ["engine/guide", "tools"].iter().for_each(|folder| files_below(&root().join(folder), &mut found));
    found.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
    found
}

/// What stands behind `](` and `]: ` outside of code: the target, and the title if there is one.
fn links(text: &str) -> Vec<(&str, Option<&str>)> {
    let mut is_code = false;
    let mut found = Vec::new();
    for line in text.lines() {
        is_code ^= line.trim_start().starts_with("```");
        if is_code {
            continue;
        }
        let inline =
            line.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
        let defined =
            line.starts_with('[').then(|| line.split_once("]: ")).flatten().map(|(_, target)| target);
        for target in inline.chain(defined) {
            let mut parts = target.split('"');
            found.push((parts.next().unwrap_or_default().trim(), parts.next()));
        }
    }
    found
}

#[test]
fn architecture_links_of_documents_lead_somewhere() {
    let mut checked = 0;
    for document in documents() {
        let text = std::fs::read_to_string(&document).expect("text");
        for (target, item) in links(&text) {
            let path = target.split('#').next().unwrap_or_default();
            if path.is_empty() || target.contains("://") || target.contains("::") {
                continue;
            }
            let file = document.parent().unwrap_or(Path::new("")).join(path);
            assert!(file.exists(), "{}: no {target}", document.display());
            checked += 1;
            // A link to a source names its item, which rustdoc shows.
            if let Some(name) = item.and_then(|item| item.rsplit("::").next()) {
                let source = std::fs::read_to_string(&file).unwrap_or_default();
                let is_module = file.file_stem().is_some_and(|stem| stem == name);
                assert!(is_module || source.contains(name), "{}: no {name} in {target}", document.display());
            }
        }
    }
    assert!(checked > 150, "{checked} links");
}

#[test]
fn architecture_links_are_found() {
    let text = "[a](b.md#c) and [d](e)\n[`F`]: ../f.rs \"crate::F\"\n```\n[x](y)\n```\n";
    assert_eq!(links(text), [("b.md#c", None), ("e", None), ("../f.rs", Some("crate::F"))]);
}
