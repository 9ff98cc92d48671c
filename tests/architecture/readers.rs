//! File and page contents must not determine the depth of the stack, the length of a queue, or how long a reader
//! waits.

use super::{Source, assert_none, code_lines, has_word, sources};

/// A function of a file.
struct Function<'a> {
    name: &'a str,
    line: usize,
    is_method: bool,
    body: Vec<&'a str>,
}

impl Function<'_> {
    /// True if the body calls another function of the file: by name, or for a method by `self.` or `Self::` and its
    /// name.
    fn calls(&self, other: &Function) -> bool {
        let call = format!("{}(", other.name);
        let calls = |line: &&str| {
            line.match_indices(&call).any(|(at, _)| is_call_within_the_file(&line[..at], other.is_method))
        };
        self.body.iter().any(calls)
    }
}

fn functions(source: &Source) -> Vec<Function<'_>> {
    let lines: Vec<(usize, &str)> = code_lines(&source.text).collect();
    let mut found = Vec::new();
    for (start, &(number, line)) in lines.iter().enumerate() {
        let Some(name) = function_name(line) else { continue };
        let indent = &line[..line.len() - line.trim_start().len()];
        let end = format!("{indent}}}");
        let rest = lines[start + 1..].iter().map(|(_, line)| *line);
        let body: Vec<_> = rest.take_while(|line| !line.starts_with(&end)).collect();
        // Parameters may be on separate lines.
        let until_body = std::iter::once(line).chain(body.iter().copied());
        let head = until_body.scan(false, |over, line| {
            let is_head = !*over;
            *over |= line.trim_end().ends_with('{');
            is_head.then_some(line)
        });
        let is_method = head.into_iter().any(|line| has_word(line, "self"));
        found.push(Function { name, line: number, is_method, body });
    }
    found
}

/// Functions that call themselves, directly or through others of their file, by a plain name, `self.` or `Self::`.
/// Cycles through several files or other values are not found.
fn recursions(source: &Source) -> Vec<String> {
    let functions = functions(source);
    let called = |from: &Function| -> Vec<usize> {
        (0..functions.len()).filter(|&to| from.calls(&functions[to])).collect()
    };
    let calls: Vec<Vec<usize>> = functions.iter().map(called).collect();
    let recurs = |start: usize| {
        let (mut seen, mut open) = (vec![false; functions.len()], calls[start].clone());
        while let Some(next) = open.pop() {
            if !std::mem::replace(&mut seen[next], true) {
                open.extend(&calls[next]);
            }
        }
        seen[start]
    };
    let place = |of: usize| format!("{}:{}: {}", source.path, functions[of].line, functions[of].name);
    (0..functions.len()).filter(|&of| recurs(of)).map(place).collect()
}

/// Name of the function that begins in a line.
fn function_name(line: &str) -> Option<&str> {
    let at = line.match_indices("fn ").map(|(at, _)| at).find(|&at| at == 0 || line[..at].ends_with(' '))?;
    let rest = &line[at + 3..];
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_')?;
    (end > 0 && !line.trim_end().ends_with(';')).then(|| &rest[..end])
}

/// True if a call after this text is a call of a function in the same file.
fn is_call_within_the_file(before: &str, is_method: bool) -> bool {
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
    // Functions of other types with the same name.
    assert_eq!(
        example("    fn walk(&self) {\n        walk(self.0);\n        self.inner.walk();\n    }\n"),
        0
    );
    assert_eq!(
        example("fn walk() {\n    sleepwalk();\n    legs::walk();\n}\nfn run() {\n    walk();\n}\n"),
        0
    );
    // Two functions in a cycle.
    assert_eq!(
        example("fn walk() {\n    run();\n}\nfn run() {\n    walk();\n}\nfn sit() {\n    run();\n}\n"),
        2
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
const MAY_OPEN: [(&str, &str); 6] = [
    ("engine/files/regular_file.rs", "asks both"),
    ("engine/files/atomic.rs", "opens a folder, to synchronise it"),
    ("engine/files/host_memory.rs", "files of /proc and /sys"),
    ("tools/ashsplat/cpu_time.rs", "files of /proc"),
    ("tools/ashsplat/bench/machine.rs", "files of /proc"),
    ("tools/ashsplat/lock.rs", "opens its lock for reading and writing, which waits for nobody"),
];

fn unchecked_opening(source: &Source) -> Vec<String> {
    if MAY_OPEN.iter().any(|(path, _)| *path == source.path) || source.path.contains("/tests/") {
        return Vec::new();
    }
    let opens = |line: &str| UNCHECKED.iter().any(|call| has_word(line, call));
    let lines = code_lines(&source.text).filter(|(_, line)| opens(line));
    lines.map(|(number, line)| format!("{}:{number}: {}", source.path, line.trim())).collect()
}

#[test]
fn architecture_files_are_opened_in_one_way() {
    let example = |text: &str| unchecked_opening(&Source { path: "a.rs".into(), text: text.into() }).len();
    assert_eq!(example("std::fs::read(path)?;\nFile::open(path)?;\nfs::read_to_string(path)?;\n"), 3);
    assert_eq!(example("fs::read_dir(path)?;\nPlyFile::open(path)?;\nregular_file::open(path)?;\n"), 0);
    let sources = sources(&["engine/files", "tools/ashsplat", "tools/capi"], &["rs"]);
    assert_none(
        "regular_file::open refuses pipes and devices: readers use it",
        sources.iter().flat_map(unchecked_opening).collect(),
    );
}
