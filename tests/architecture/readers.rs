//! What files and pages say must not decide how deep the stack or how long a queue grows.

use super::{Source, assert_none, code_lines, has_word, sources};

/// Calls of a function of readers to itself: by its name, or for a method by `self.` or `Self::` and its name.
fn recursions(source: &Source) -> Vec<String> {
    let lines: Vec<(usize, &str)> = code_lines(&source.text).collect();
    let mut found = Vec::new();
    for (start, &(_, line)) in lines.iter().enumerate() {
        let Some(name) = function_name(line) else { continue };
        let indent = &line[..line.len() - line.trim_start().len()];
        let end = format!("{indent}}}");
        let body: Vec<_> =
            lines[start + 1..].iter().take_while(|(_, line)| !line.starts_with(&end)).collect();
        // Parameters may stand on lines of their own.
        let until_body = std::iter::once(line).chain(body.iter().map(|(_, line)| *line));
        let head = until_body.scan(false, |over, line| {
            let is_head = !*over;
            *over |= line.trim_end().ends_with('{');
            is_head.then_some(line)
        });
        let is_method = head.into_iter().any(|line| has_word(line, "self"));
        for (number, line) in body {
            if line.match_indices(&format!("{name}(")).any(|(at, _)| calls_itself(&line[..at], is_method)) {
                found.push(format!("{}:{number}: {name}", source.path));
            }
        }
    }
    found
}

/// The name of the function that begins in a line.
fn function_name(line: &str) -> Option<&str> {
    let at = line.match_indices("fn ").map(|(at, _)| at).find(|&at| at == 0 || line[..at].ends_with(' '))?;
    let rest = &line[at + 3..];
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_')?;
    (end > 0 && !line.trim_end().ends_with(';')).then(|| &rest[..end])
}

/// Whether a call with this text before it is one to the function itself.
fn calls_itself(before: &str, is_method: bool) -> bool {
    let own = ["self.", "Self::"].into_iter().any(|prefix| {
        before
            .strip_suffix(prefix)
            .is_some_and(|rest| !rest.ends_with(|c: char| c.is_alphanumeric() || c == '_'))
    });
    let plain = !before.ends_with(|c: char| c.is_alphanumeric() || "_.:".contains(c));
    own || (plain && !is_method)
}

#[test]
fn architecture_readers_do_not_recurse() {
    let example =
        |text: &str| recursions(&Source { path: "engine/files/a.rs".into(), text: text.into() }).len();
    assert_eq!(example("fn walk(n: u32) {\n    if n > 0 {\n        walk(n - 1);\n    }\n}\n"), 1);
    assert_eq!(example("    fn walk(&self, n: u32) {\n        self.walk(n - 1);\n    }\n"), 1);
    assert_eq!(example("    fn walk(\n        n: u32,\n    ) {\n        Self::walk(n - 1);\n    }\n"), 1);
    // Others of the same name.
    assert_eq!(
        example("    fn walk(&self) {\n        walk(self.0);\n        self.inner.walk();\n    }\n"),
        0
    );
    assert_eq!(
        example("fn walk() {\n    sleepwalk();\n    legs::walk();\n}\nfn run() {\n    walk();\n}\n"),
        0
    );
    let sources = sources(&["engine/files"], &["rs"]);
    assert!(sources.len() > 40, "the readers are in engine/files");
    assert_none(
        "readers walk over what they read in loops: a file must not decide how deep the stack grows",
        sources.iter().flat_map(recursions).collect(),
    );
}

fn unbounded_channels(source: &Source) -> Vec<String> {
    let unbounded = |line: &str| has_word(line, "unbounded_channel") || line.contains("mpsc::channel");
    let lines = code_lines(&source.text).filter(|(_, line)| unbounded(line));
    lines.map(|(number, _)| format!("{}:{number}", source.path)).collect()
}

#[test]
fn architecture_channels_are_bounded() {
    let example = |text: &str| unbounded_channels(&Source { path: "a.rs".into(), text: text.into() }).len();
    assert_eq!(example("use std::sync::mpsc::channel;\nlet (a, b) = mpsc::unbounded_channel();\n"), 2);
    assert_eq!(example("let (a, b) = mpsc::sync_channel(2);\nlet (c, d) = oneshot::channel();\n"), 0);
    let sources = sources(&["engine", "tools/ashsplat", "tools/capi"], &["rs"]);
    assert_none(
        "a queue that nobody empties must not grow: give channels a bound",
        sources.iter().flat_map(unbounded_channels).collect(),
    );
}
