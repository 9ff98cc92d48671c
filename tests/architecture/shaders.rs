//! Rules for shaders, their twins and their tests.

use super::{Source, assert_none, code_lines, has_word, root, sources};

/// Subgroup sizes are never literal, but `SUBGROUP_SIZE` or `gl_SubgroupSize`.
fn literal_subgroup_sizes(source: &Source) -> Vec<String> {
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
    code_lines(&source.text)
        .filter(|(_, line)| assumes(line))
        .map(|(number, line)| format!("{}:{number}: {}", source.path, line.trim()))
        .collect()
}

#[test]
fn architecture_no_literal_subgroup_sizes() {
    let check =
        |line: &str| literal_subgroup_sizes(&Source { path: "glsl/a.comp".into(), text: line.into() }).len();
    assert_eq!(check("if (gl_SubgroupSize == 32) {"), 1);
    assert_eq!(check("uint lane = gl_SubgroupInvocationID & 31;"), 1);
    assert_eq!(check("uint lane = gl_SubgroupInvocationID % SUBGROUP_SIZE;"), 0);
    assert_eq!(check("if (gl_SubgroupInvocationID == 0) {"), 0);
    let shaders = sources(&["glsl"], &["comp", "glsl"]);
    assert_none("literal subgroup sizes", shaders.iter().flat_map(literal_subgroup_sizes).collect());
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
    let source = |text: &str| Source { path: "glsl/a.comp".into(), text: text.into() };
    let include = source("uint f(uint x) {\n    barrier();\n    return x;\n}\n");
    assert_eq!(barrier_functions(&include), ["f"]);
    let early = source("void main() {\n    if (x) return;\n    f(1);\n}");
    assert_eq!(return_before_barrier(&early, &["f".into()]).len(), 1);
    let late = source("void main() {\n    barrier();\n    if (x) return;\n    y = 1;\n}");
    assert_eq!(return_before_barrier(&late, &["f".into()]).len(), 0);

    let shaders = sources(&["glsl"], &["comp", "glsl"]);
    let functions: Vec<String> = shaders.iter().flat_map(barrier_functions).filter(|f| f != "main").collect();
    let violations = shaders.iter().flat_map(|s| return_before_barrier(s, &functions)).collect();
    assert_none("return before a barrier", violations);
}

/// True if a shader or its includes use subgroups.
fn knows_of_subgroups(name: &str, shaders: &[Source]) -> bool {
    let file = |source: &&Source| source.path.rsplit('/').next() == Some(name);
    let source = shaders.iter().find(file).unwrap_or_else(|| panic!("{name} is no shader"));
    let operation = |line: &str| {
        let mut after = line.match_indices("subgroup").map(|(at, word)| &line[at + word.len()..]);
        after.any(|rest| rest.starts_with(|c: char| c.is_ascii_uppercase()))
    };
    code_lines(&source.text).any(|(_, line)| {
        let included = line.strip_prefix("#include \"").and_then(|rest| rest.split('"').next());
        operation(line)
            || ["gl_Subgroup", "gl_NumSubgroups"].iter().any(|word| line.contains(word))
            || included.is_some_and(|name| knows_of_subgroups(name, shaders))
    })
}

/// `.ci/run` skips them at other subgroup sizes.
#[test]
fn architecture_kernels_without_subgroups() {
    let source = |path: &str, text: &str| Source { path: path.into(), text: text.into() };
    let examples = [
        source("glsl/a.comp", "#include \"b.glsl\"\nvoid main() {}"),
        source("glsl/b.glsl", "uint sum(uint x) {\n    return subgroupAdd(x);\n}"),
        source("glsl/c.comp", "// subgroupAdd\nuint subgroups = SUBGROUP_SIZE;"),
        source("glsl/d.comp", "uint lane = gl_SubgroupInvocationID;"),
    ];
    let known = ["a.comp", "b.glsl", "c.comp", "d.comp"].map(|name| knows_of_subgroups(name, &examples));
    assert_eq!(known, [true, true, false, true]);

    let script = std::fs::read_to_string(root().join(".ci/run")).expect("a script");
    let list = script.split_once("without_subgroups='").and_then(|(_, rest)| rest.split_once('\''));
    let names: Vec<&str> = list.expect("a list").0.split_whitespace().collect();
    assert!(names.len() > 30, "{names:?}");
    let shaders = sources(&["glsl"], &["comp", "glsl"]);
    let wrong = names.iter().filter(|name| knows_of_subgroups(&format!("{name}.comp"), &shaders));
    assert_none("kernels with subgroups", wrong.map(|name| (*name).to_owned()).collect());
}

/// `.ci/run` runs these trainings with the kernels of GPUs: each word of its list must match a trial's name.
#[test]
fn architecture_trainings_of_gpus_are_trials() {
    let script = std::fs::read_to_string(root().join(".ci/run")).expect("a script");
    let list = script.split_once("trainings_of_gpus='").and_then(|(_, rest)| rest.split_once('\''));
    let words: Vec<&str> = list.expect("a list").0.split_whitespace().collect();
    assert!(words.len() > 10, "{words:?}");
    let tests = sources(&["tests"], &["rs"]);
    let is_trial = |word: &str| match word.strip_suffix("::") {
        Some(file) => tests.iter().any(|source| source.path == format!("tests/{file}.rs")),
        None => tests.iter().any(|source| source.text.contains(&format!("#[test]\nfn {word}"))),
    };
    let unknown = words.iter().filter(|word| !is_trial(word)).map(|word| (*word).to_owned());
    assert_none("words that are no trial's", unknown.collect());
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

/// Missing tests and twins of kernels. A kernel in [`ALIKE`] needs no twin.
fn missing_of_kernels(shaders: &[String], exists: impl Fn(&str) -> bool) -> Vec<String> {
    let mut missing = Vec::new();
    for shader in shaders {
        let stem = shader.rsplit('/').next().unwrap_or(shader).trim_end_matches(".comp");
        let twin = ALIKE.iter().find(|(kernel, _)| *kernel == stem).map_or(stem, |(_, other)| other);
        let wanted = [format!("tests/reference/{twin}.rs"), format!("tests/kernels/{stem}.rs")];
        missing.extend(wanted.into_iter().filter(|path| !exists(path)));
    }
    missing
}

#[test]
fn architecture_each_shader_has_its_twin_and_its_test() {
    let missing = missing_of_kernels(&["glsl/sort/a.comp".into()], |path| path == "tests/kernels/a.rs");
    assert_eq!(missing, ["tests/reference/a.rs"]);
    let missing = missing_of_kernels(&["glsl/forward/blend_shared.comp".into()], |path| {
        path == "tests/reference/blend.rs"
    });
    assert_eq!(missing, ["tests/kernels/blend_shared.rs"]);
    let shaders: Vec<String> = sources(&["glsl"], &["comp"]).into_iter().map(|source| source.path).collect();
    assert!(!shaders.is_empty());
    let root = root();
    assert_none("missing", missing_of_kernels(&shaders, |path| root.join(path).exists()));
}

/// True if a twin file only re-exports another one.
fn is_no_twin(source: &Source) -> bool {
    !code_lines(&source.text)
        .any(|(_, line)| has_word(line, "fn") || has_word(line, "mod") || has_word(line, "struct"))
}

#[test]
fn architecture_twins_compute() {
    let twin = |text: &str| Source { path: "tests/reference/a.rs".into(), text: text.into() };
    assert!(is_no_twin(&twin("//! The twin of a.\npub use super::b::b;")));
    assert!(!is_no_twin(&twin("pub fn a(x: f64) -> f64 {\n    x\n}")));
    let twins = sources(&["tests/reference"], &["rs"]);
    assert_none("twins of nothing", twins.into_iter().filter(is_no_twin).map(|twin| twin.path).collect());
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
