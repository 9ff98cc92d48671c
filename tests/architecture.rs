//! Links of documents lead somewhere.

use crate::common::{files_below, root};
use std::path::PathBuf;

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
