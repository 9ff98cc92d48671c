//! The rules of the house that a machine can check.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::common::root;

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

/// Places of the lines of code with something.
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
    // window. Nor can functions that C calls, nor a layer, which Vulkan's loader calls.
    let allowed = [
        "engine/vk/",
        "tools/embed/",
        "tools/embed_wgpu/",
        "tools/capi/",
        "tools/mock_layer/",
        "tools/view/window/present/",
        "tests/embedding/",
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

/// The module of a file of the engine.
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

// ---- readers: contents must not decide depth of stack, length of queues, or waits ----------------------------------

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
    let sources = sources(&["engine/files"], &["rs"]);
    assert!(sources.len() > 40, "the readers are in engine/files");
    assert_none(
        "readers walk over what they read in loops: a file must not decide how deep the stack grows",
        sources.iter().flat_map(recursions).collect(),
    );
}

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
const MAY_OPEN: [(&str, &str); 6] = [
    ("engine/files/regular_file.rs", "asks both"),
    ("engine/files/atomic.rs", "opens a folder, to synchronise it"),
    ("engine/files/host_memory.rs", "files of /proc and /sys"),
    ("tools/program/measure.rs", "files of /proc"),
    ("tools/bench/machine.rs", "files of /proc"),
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

// ---- shaders, their twins and their tests --------------------------------------------------------------------------

/// Subgroup sizes are never literal, but `SUBGROUP_SIZE` or `gl_SubgroupSize`.
#[test]
fn architecture_no_literal_subgroup_sizes() {
    let builtins = ["gl_SubgroupInvocationID", "gl_SubgroupSize", "gl_SubgroupID", "gl_NumSubgroups"];
    let literals = ["4", "8", "16", "31", "32", "63", "64", "127", "128"];
    let assumes = |line: &str| {
        builtins.iter().any(|builtin| {
            line.match_indices(builtin).any(|(at, _)| {
                let after = line[at + builtin.len()..].trim_start_matches([' ', 'u', ')']);
                let operand = after.trim_start_matches(['=', '!', '<', '>', '&', '%', '/', '*', ' ']);
                let literal: String = operand.chars().take_while(char::is_ascii_digit).collect();
                operand.len() < after.len() && literals.contains(&literal.as_str())
            })
        })
    };
    let shaders = sources(&["glsl"], &["comp", "glsl"]);
    assert_none("literal subgroup sizes", lines_with(&shaders, assumes));
}

/// True if a line has a barrier: a call of such an include function, or of the shader's own `barrier()`.
fn has_barrier(line: &str, barrier_functions: &[String]) -> bool {
    has_word(line, "barrier") || barrier_functions.iter().any(|function| has_word(line, function))
}

/// `return` in `main` before a barrier: undefined unless all invocations return.
fn return_before_barrier(source: &Source, barrier_functions: &[String]) -> Vec<String> {
    let lines: Vec<(usize, &str)> = code_lines(&source.text).collect();
    let Some(main) = lines.iter().position(|(_, line)| line.contains("void main()")) else { return vec![] };
    let last_barrier = lines.iter().rposition(|(_, line)| has_barrier(line, barrier_functions)).unwrap_or(0);
    lines[main..]
        .iter()
        .enumerate()
        .filter(|(place, (_, line))| has_word(line, "return") && main + place < last_barrier)
        .map(|(_, (number, _))| format!("{}:{number}", source.path))
        .collect()
}

/// Names of the functions in a shader include that contain a barrier.
fn barrier_functions(source: &Source) -> Vec<String> {
    let mut functions = Vec::new();
    let mut current = String::new();
    for (_, line) in code_lines(&source.text) {
        let starts =
            !line.starts_with([' ', '}', '#']) && line.contains('(') && line.trim_end().ends_with('{');
        if starts {
            let head = line.split('(').next().unwrap_or_default();
            current = head.split_whitespace().next_back().unwrap_or_default().to_owned();
        }
        if has_word(line, "barrier") && !current.is_empty() {
            functions.push(current.clone());
        }
    }
    functions
}

#[test]
fn architecture_no_return_before_a_barrier() {
    let shaders = sources(&["glsl"], &["comp", "glsl"]);
    let functions: Vec<String> = shaders.iter().flat_map(barrier_functions).filter(|f| f != "main").collect();
    let violations = shaders.iter().flat_map(|s| return_before_barrier(s, &functions)).collect();
    assert_none("return before a barrier", violations);
}

/// The words of a list in `.ci/run`.
fn list_of_ci(name: &str) -> Vec<String> {
    let script = std::fs::read_to_string(root().join(".ci/run")).expect("a script");
    let list = script.split_once(&format!("{name}='")).and_then(|(_, rest)| rest.split_once('\''));
    list.expect("a list").0.split_whitespace().map(str::to_owned).collect()
}

/// `.ci/run` runs these trainings with the kernels of GPUs: each word of its list must match a trial's name.
#[test]
fn architecture_trainings_of_gpus_are_trials() {
    let words = list_of_ci("trainings_of_gpus");
    assert!(words.len() > 10, "{words:?}");
    let tests = sources(&["tests"], &["rs"]);
    let is_trial = |word: &String| match word.strip_suffix("::") {
        Some(file) => tests.iter().any(|source| source.path == format!("tests/{file}.rs")),
        None => tests.iter().any(|source| source.text.contains(&format!("#[test]\nfn {word}"))),
    };
    assert_none("words that are no trial's", words.into_iter().filter(|word| !is_trial(word)).collect());
}

/// Kernels that compute the same as another one in another way: they share its twin.
const ALIKE: [(&str, &str); 12] = [
    ("blend_auxiliary", "blend"),
    ("blend_backward_subgroup_per_tile", "blend_backward"),
    ("blend_shared", "blend"),
    ("blend_shared_auxiliary", "blend"),
    ("compose_bgra8", "compose_rgba8"),
    ("compose_r11g11b10f", "compose_rgba32f"),
    ("compose_rgb10a2", "compose_rgba8"),
    ("compose_rgba16f", "compose_rgba32f"),
    ("cull_scenes", "cull"),
    ("project_scenes", "project"),
    ("ssim_backward_sweep", "ssim_backward"),
    ("ssim_forward_sweep", "ssim_forward"),
];

/// Files of tests and of twins name their kernels as `folder/name`. A kernel in [`ALIKE`] needs no twin of its own.
#[test]
fn architecture_each_shader_has_its_twin_and_its_test() {
    let shaders = sources(&["glsl"], &["comp"]);
    assert!(!shaders.is_empty());
    let [tests, twins] = ["tests/kernels", "tests/reference"].map(|folder| sources(&[folder], &["rs"]));
    let names = |sources: &[Source], kernel: &str| {
        sources.iter().any(|source| source.text.contains(&format!("`{kernel}`")))
    };
    let mut missing = Vec::new();
    for shader in &shaders {
        let kernel = shader.path.trim_start_matches("glsl/").trim_end_matches(".comp");
        let (folder, stem) = kernel.rsplit_once('/').unwrap_or(("", kernel));
        let twin = ALIKE.iter().find(|(alike, _)| *alike == stem).map_or(stem, |(_, other)| other);
        if !names(&twins, &format!("{folder}/{twin}")) {
            missing.push(format!("twin of {kernel}"));
        }
        if !names(&tests, kernel) {
            missing.push(format!("test of {kernel}"));
        }
    }
    assert_none("missing", missing);
}

/// A file of twins has more than the names of another one.
#[test]
fn architecture_twins_compute() {
    let computes = |line: &str| ["fn", "mod", "struct"].iter().any(|word| has_word(line, word));
    let mut twins = sources(&["tests/reference"], &["rs"]);
    twins.retain(|source| !code_lines(&source.text).any(|(_, line)| computes(line)));
    assert_none("twins of nothing", twins.into_iter().map(|twin| twin.path).collect());
}

#[test]
fn architecture_each_shader_says_what_it_does() {
    let silent = sources(&["glsl"], &["comp", "glsl"])
        .into_iter()
        .filter(|source| !source.text.starts_with("//"))
        .map(|source| source.path)
        .collect();
    assert_none("shaders without a header", silent);
}

// ---- links of the documents ----------------------------------------------------------------------------------------

fn documents() -> Vec<PathBuf> {
    let mut found = ["README.md", "CHANGELOG.md"].map(|name| root().join(name)).to_vec();
    found.extend(["engine/guide", "tools"].iter().flat_map(|folder| files_below(&root().join(folder))));
    found.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
    found
}

/// Lines outside of code.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut is_code = false;
    text.lines().filter(move |line| {
        is_code ^= line.trim_start().starts_with("```");
        !is_code
    })
}

/// Targets of links outside of code, after `](` and `]: `, with the title if any.
fn links(text: &str) -> Vec<(&str, Option<&str>)> {
    let mut found = Vec::new();
    for line in prose(text) {
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
    let mut found: Vec<String> = Vec::new();
    for line in prose(text) {
        let heading = line.trim_start_matches('#');
        if heading.len() == line.len() || !heading.starts_with(' ') {
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
