//! Compiles every `glsl/**/*.comp` to SPIR-V, reflects it, and generates the typed host side of each kernel.
//!
//! All failing shaders are reported at once, with file and line. Compiled modules are kept in OUT_DIR under the hash
//! of everything that went into them, so that only what changed is compiled again.
#![allow(clippy::unwrap_used)]

#[path = "engine/kernels/generate.rs"]
mod generate;
#[path = "engine/kernels/reflect.rs"]
mod reflect;

use glslang::include::{IncludeHandler, IncludeResult, IncludeType};
use glslang::{
    Compiler, CompilerOptions, ShaderInput, ShaderMessage, ShaderSource, ShaderStage, SourceLanguage,
};
use glslang::{SpirvVersion, Target, VulkanVersion};
use std::collections::BTreeSet;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Extensions that every shader may use without naming them.
const EXTENSIONS: &str = "\
#extension GL_GOOGLE_include_directive : enable
#extension GL_EXT_scalar_block_layout : enable
#extension GL_EXT_control_flow_attributes : enable
#extension GL_KHR_shader_subgroup_basic : enable
#extension GL_KHR_shader_subgroup_vote : enable
#extension GL_KHR_shader_subgroup_arithmetic : enable
#extension GL_KHR_shader_subgroup_ballot : enable
#extension GL_KHR_shader_subgroup_shuffle : enable
#extension GL_KHR_shader_subgroup_shuffle_relative : enable
";

fn main() {
    let root = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").unwrap());
    let out = PathBuf::from(std::env::var_os("OUT_DIR").unwrap());
    let glsl = root.join("glsl");
    for path in ["glsl", "build.rs", "engine/kernels"] {
        println!("cargo:rerun-if-changed={path}");
    }
    let mut shaders = Vec::new();
    let mut includes = Vec::new();
    collect(&glsl, &mut shaders, &mut includes);
    for path in shaders.iter().chain(&includes) {
        println!("cargo:rerun-if-changed={}", path.display());
    }

    let results = compile_all(&root, &glsl, &out, &shaders);
    let (kernels, mut errors): (Vec<_>, Vec<_>) = results.into_iter().partition(Result::is_ok);
    let kernels: Vec<_> = kernels.into_iter().filter_map(Result::ok).collect();
    let constants = fs::read_to_string(glsl.join("include/constants.glsl")).unwrap_or_default();
    let generated = generate::constants(&constants).and_then(|c| generate::kernels(&kernels, &c));
    match generated {
        Ok(text) if errors.is_empty() => fs::write(out.join("kernels.rs"), text).unwrap(),
        Ok(_) => {}
        Err(error) => errors.push(Err(error)),
    }
    if !errors.is_empty() {
        for error in errors.iter().filter_map(|e| e.as_ref().err()) {
            eprintln!("{error}\n");
        }
        eprintln!("{} shader(s) failed", errors.len());
        std::process::exit(1);
    }
}

/// Finds `*.comp` and `*.glsl` below a folder, sorted.
fn collect(folder: &Path, shaders: &mut Vec<PathBuf>, includes: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut paths: Vec<_> = entries.map(|e| e.unwrap().path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            collect(&path, shaders, includes);
        } else if path.extension().is_some_and(|e| e == "comp") {
            shaders.push(path);
        } else if path.extension().is_some_and(|e| e == "glsl") {
            includes.push(path);
        }
    }
}

type Compiled = Result<generate::Kernel, String>;

fn compile_all(root: &Path, glsl: &Path, out: &Path, shaders: &[PathBuf]) -> Vec<Compiled> {
    let validator = Command::new("spirv-val").arg("--version").output().is_ok();
    let next = AtomicUsize::new(0);
    let results: Mutex<Vec<(usize, Compiled)>> = Mutex::new(Vec::new());
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get()).min(shaders.len());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some((index, path)) =
                    Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|i| Some((i, shaders.get(i)?)))
                {
                    let display = path.strip_prefix(root).unwrap().display().to_string().replace('\\', "/");
                    let result = kernel(glsl, out, path, &display, validator);
                    results.lock().unwrap().push((index, result));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap();
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Compiles (or takes from the cache), reflects, and writes the module as a Rust array.
fn kernel(glsl: &Path, out: &Path, path: &Path, display: &str, validator: bool) -> Compiled {
    let name = display.trim_start_matches("glsl/").trim_end_matches(".comp").to_owned();
    let source = fs::read_to_string(path).map_err(|e| format!("{display}: cannot read: {e}"))?;
    let mut hasher = DefaultHasher::new();
    (EXTENSIONS, validator).hash(&mut hasher);
    hash_with_includes(glsl, path, &source, &mut BTreeSet::new(), &mut hasher);
    let flat = name.replace('/', "__");
    let cached = out.join(format!("{flat}.{:016x}.spv", hasher.finish()));
    let spirv = match fs::read(&cached) {
        Ok(bytes) => bytes.chunks_exact(4).map(|c| u32::from_le_bytes(c.try_into().unwrap())).collect(),
        Err(_) => {
            let spirv = compile(glsl, path, display, &source)?;
            let bytes: Vec<u8> = spirv.iter().flat_map(|w| w.to_le_bytes()).collect();
            if validator {
                validate(&bytes, &out.join(format!("{flat}.unchecked.spv")), display)?;
            }
            forget_older(out, &flat);
            fs::write(&cached, bytes).unwrap();
            spirv
        }
    };
    let spirv_file = format!("{flat}.spv.rs");
    let array = format!("{spirv:?}");
    if fs::read_to_string(out.join(&spirv_file)).ok().as_ref() != Some(&array) {
        fs::write(out.join(&spirv_file), array).unwrap();
    }
    let shader = reflect::reflect(&spirv).map_err(|e| format!("{display}: {e}"))?;
    Ok(generate::Kernel { name, source, shader, spirv_file })
}

fn compile(glsl: &Path, path: &Path, display: &str, source: &str) -> Result<Vec<u32>, String> {
    let compiler = Compiler::acquire().ok_or("glslang does not start")?;
    let options = CompilerOptions {
        source_language: SourceLanguage::GLSL,
        target: Target::Vulkan { version: VulkanVersion::Vulkan1_3, spirv_version: SpirvVersion::SPIRV1_6 },
        version_profile: None,
        messages: ShaderMessage::VULKAN_RULES | ShaderMessage::SPV_RULES | ShaderMessage::ENHANCED,
    };
    let mut includer = Includer { glsl, file: path };
    let source = ShaderSource::from(with_extensions(source));
    let none: Option<&[(&str, Option<&str>)]> = None;
    let input = ShaderInput::new(&source, ShaderStage::Compute, &options, none, Some(&mut includer))
        .map_err(|e| report(&e, display))?;
    let shader = glslang::Shader::new(compiler, input).parse().map_err(|e| report(&e, display))?;
    shader.compile().map_err(|e| report(&e, display))
}

/// The source with [`EXTENSIONS`] after its `#version`, its line numbers kept.
fn with_extensions(source: &str) -> String {
    let Some(at) = source.find("#version") else { return source.to_owned() };
    let end = source[at..].find('\n').map_or(source.len(), |n| at + n + 1);
    let line = source[..end].lines().count() + 1;
    format!("{}{EXTENSIONS}#line {line}\n{}", &source[..end], &source[end..])
}

/// glslang's log as "path:line: message"; it calls the file itself 0 and includes by their name.
fn report(error: &dyn std::fmt::Display, display: &str) -> String {
    let log = error.to_string();
    let lines = log.lines().filter(|l| l.contains("ERROR: ") && !l.contains("compilation errors"));
    let found: Vec<_> = lines
        .map(|l| match l.trim().trim_start_matches("ERROR: ") {
            l if l.starts_with("0:") => format!("error: {display}{}", &l[1..]),
            l => format!("error: {l} (compiling {display})"),
        })
        .collect();
    if found.is_empty() { format!("error: {display}: {log}") } else { found.join("\n") }
}

struct Includer<'a> {
    glsl: &'a Path,
    file: &'a Path,
}

/// An include is looked for next to the shader, then in glsl/include, then below glsl.
fn resolve(glsl: &Path, file: &Path, name: &str) -> Option<PathBuf> {
    let candidates = [file.parent()?.join(name), glsl.join("include").join(name), glsl.join(name)];
    candidates.into_iter().find(|p| p.is_file())
}

impl IncludeHandler for Includer<'_> {
    fn include(&mut self, _: IncludeType, name: &str, includer: &str, _: usize) -> Option<IncludeResult> {
        // Includes go by their path from the crate's root, which is what errors then show.
        let root = self.glsl.parent()?;
        let from = if includer.is_empty() { self.file.to_owned() } else { root.join(includer) };
        let path = resolve(self.glsl, &from, name).or_else(|| resolve(self.glsl, self.file, name))?;
        let shown = path.strip_prefix(root).unwrap_or(&path).display().to_string().replace('\\', "/");
        Some(IncludeResult { name: shown, data: fs::read_to_string(path).ok()? })
    }
}

fn hash_with_includes(
    glsl: &Path,
    path: &Path,
    source: &str,
    seen: &mut BTreeSet<PathBuf>,
    hasher: &mut DefaultHasher,
) {
    if !seen.insert(path.to_owned()) {
        return;
    }
    source.hash(hasher);
    for line in source.lines().filter_map(|l| l.trim().strip_prefix("#include")) {
        let name = line.trim().trim_matches(['"', '<', '>']);
        if let Some(found) = resolve(glsl, path, name)
            && let Ok(text) = fs::read_to_string(&found)
        {
            hash_with_includes(glsl, &found, &text, seen, hasher);
        }
    }
}

fn validate(spirv: &[u8], scratch: &Path, display: &str) -> Result<(), String> {
    fs::write(scratch, spirv).unwrap();
    let checked = Command::new("spirv-val")
        .args(["--target-env", "vulkan1.3", "--scalar-block-layout"])
        .arg(scratch)
        .output()
        .map_err(|e| format!("{display}: spirv-val: {e}"))?;
    let _ = fs::remove_file(scratch);
    if checked.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&checked.stdout) + String::from_utf8_lossy(&checked.stderr);
    Err(format!("{display}: invalid SPIR-V: {said}"))
}

fn forget_older(out: &Path, flat: &str) {
    for entry in fs::read_dir(out).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let hash =
            name.strip_prefix(flat).and_then(|n| n.strip_prefix('.')).and_then(|n| n.strip_suffix(".spv"));
        if hash.is_some_and(|h| h.len() == 16) {
            let _ = fs::remove_file(entry.path());
        }
    }
}
