//! Links of the documents have existing targets.

use std::path::{Path, PathBuf};

use super::{files_below, root};

fn documents() -> Vec<PathBuf> {
    let mut found = ["README.md", "CHANGELOG.md"].map(|name| root().join(name)).to_vec();
    ["engine/guide", "tools"].iter().for_each(|folder| files_below(&root().join(folder), &mut found));
    found.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
    found
}

/// Targets of links outside of code, after `](` and `]: `, with the title if any.
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

/// Anchors of a document's headings, as GitHub generates them: lower case, no punctuation, a hyphen for each space,
/// and a number for repeated names.
fn anchors(text: &str) -> Vec<String> {
    let mut is_code = false;
    let mut found: Vec<String> = Vec::new();
    for line in text.lines() {
        is_code ^= line.trim_start().starts_with("```");
        let heading = line.trim_start_matches('#');
        if is_code || heading.len() == line.len() || !heading.starts_with(' ') {
            continue;
        }
        // Only the text of a link counts.
        let mut shown = String::new();
        let mut rest = heading.trim();
        while let Some((before, target)) = rest.split_once("](") {
            shown += before;
            rest = target.split_once(')').map_or("", |(_, after)| after);
        }
        shown += rest;
        let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
        let anchor: String =
            shown.to_lowercase().chars().filter(kept).map(|c| if c == ' ' { '-' } else { c }).collect();
        let numbered = |n: usize| if n == 0 { anchor.clone() } else { format!("{anchor}-{n}") };
        let free = (0..).map(numbered).find(|name| !found.contains(name));
        found.extend(free);
    }
    found
}

#[test]
fn architecture_links_of_documents_lead_somewhere() {
    let mut checked = 0;
    let mut headings = 0;
    for document in documents() {
        let text = std::fs::read_to_string(&document).expect("text");
        for (target, item) in links(&text) {
            let (path, anchor) =
                target.split_once('#').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
            if target.contains("://") || target.contains("::") {
                continue;
            }
            let file = match path {
                "" => document.clone(),
                path => document.parent().unwrap_or(Path::new("")).join(path),
            };
            assert!(file.exists(), "{}: no {target}", document.display());
            checked += 1;
            if let Some(anchor) = anchor
                && file.extension().is_some_and(|extension| extension == "md")
            {
                let text = std::fs::read_to_string(&file).expect("text");
                let is_there = anchors(&text).iter().any(|heading| heading == anchor);
                assert!(is_there, "{}: no heading of {target}", document.display());
                headings += 1;
            }
            // A link to a source names an item, which rustdoc shows.
            if let Some(name) = item.and_then(|item| item.rsplit("::").next()) {
                let source = std::fs::read_to_string(&file).unwrap_or_default();
                let is_module = file.file_stem().is_some_and(|stem| stem == name);
                assert!(is_module || source.contains(name), "{}: no {name} in {target}", document.display());
            }
        }
    }
    assert!(checked > 150, "{checked} links");
    assert!(headings > 0, "no link to a heading");
}
