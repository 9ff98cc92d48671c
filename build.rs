//! Compiles every `glsl/**/*.comp` to SPIR-V, reflects it, and generates the typed host side of each kernel.
//!
//! All failing shaders are reported at once, with file and line. OUT_DIR caches each compiled module under the hash of its
//! sources, so that only changed shaders are compiled again.
#![allow(clippy::disallowed_methods, clippy::expect_used, clippy::unwrap_used)]

#[path = "engine/kernels/compile.rs"]
mod compile;
#[path = "engine/kernels/generate.rs"]
mod generate;
#[path = "engine/kernels/reflect.rs"]
mod reflect;

use compile::{EXTENSIONS, LENSES, TEXELS, compile, files_with_includes, has_lens_form, has_texel_form};
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

fn main() {
    let root = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").unwrap());
    let out = PathBuf::from(std::env::var_os("OUT_DIR").unwrap());
    let glsl = root.join("glsl");
    for path in ["glsl", "build.rs", "engine/kernels"] {
        println!("cargo:rerun-if-changed={path}");
    }
    guide(&root, &out);
    let mut shaders = Vec::new();
    let mut includes = Vec::new();
    collect(&glsl, &mut shaders, &mut includes);
    for path in shaders.iter().chain(&includes) {
        println!("cargo:rerun-if-changed={}", path.display());
    }

    let results = compile_all(&root, &glsl, &out, &shaders);
    let (kernels, mut errors): (Vec<_>, Vec<_>) = results.into_iter().partition(Result::is_ok);
    errors.extend(embed(&root, &glsl, &out).err().map(Err));
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

/// Writes the guide's chapters for rustdoc. As files, chapters link to each other and to sources, so that they can be read
/// where the project is browsed. In rustdoc, chapters are sibling modules, a link to a source becomes the item in its
/// title, and pictures are embedded.
fn guide(root: &Path, out: &Path) {
    println!("cargo:rerun-if-changed=engine/guide");
    fs::create_dir_all(out.join("guide")).unwrap();
    let files = fs::read_dir(root.join("engine/guide")).unwrap().map(|entry| entry.unwrap().path());
    let chapters: Vec<PathBuf> = files.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    let names = || chapters.iter().filter_map(|path| path.file_stem()?.to_str());
    for path in &chapters {
        let text = fs::read_to_string(path).unwrap();
        let linked = names()
            .fold(text, |text, name| text.replace(&format!("]({name}.md"), &format!("](super::{name}")));
        let items = linked.lines().map(|line| {
            if let Some((before, name)) = line.split_once("](pictures/") {
                let name = name.trim_end_matches(')');
                let picture = fs::read(root.join("engine/guide/pictures").join(name)).unwrap();
                return format!("{before}](data:image/png;base64,{})\n", base64(&picture));
            }
            let link =
                line.split_once("]: ../").and_then(|(name, rest)| Some((name, rest.split('"').nth(1)?)));
            link.map_or(format!("{line}\n"), |(name, item)| format!("{name}]: {item}\n"))
        });
        fs::write(out.join("guide").join(path.file_name().unwrap()), items.collect::<String>()).unwrap();
    }
}

/// Base64 of RFC 4648.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let quartet = |three: &[u8]| {
        let all = (0..3).fold(0, |all, k| all << 8 | u32::from(*three.get(k).unwrap_or(&0)));
        let letter = |k: usize| char::from(LETTERS[(all >> (18 - 6 * k) & 63) as usize]);
        (0..4).map(move |k| if k <= three.len() { letter(k) } else { '=' }).collect::<String>()
    };
    bytes.chunks(3).map(quartet).collect()
}

/// Compiles the graphics shaders of the embedding example to `embed_NAME.spv`.
fn embed(root: &Path, glsl: &Path, out: &Path) -> Result<(), String> {
    let names = ["cube.vert", "cube.frag", "splat_depth.frag", "tonemap.vert", "tonemap.frag"];
    for name in names {
        println!("cargo:rerun-if-changed=tools/embed/{name}");
    }
    for name in names {
        let path = root.join("tools/embed").join(name);
        let display = format!("tools/embed/{name}");
        let source = fs::read_to_string(&path).map_err(|e| format!("{display}: cannot read: {e}"))?;
        let spirv = compile(glsl, &path, &display, &source, "")?;
        let bytes: Vec<u8> = spirv.iter().flat_map(|w| w.to_le_bytes()).collect();
        fs::write(out.join(format!("embed_{name}.spv")), bytes).unwrap();
    }
    Ok(())
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

/// Compiles a shader in all of its forms.
fn kernel(glsl: &Path, out: &Path, path: &Path, display: &str, validator: bool) -> Compiled {
    let name = display.trim_start_matches("glsl/").trim_end_matches(".comp").to_owned();
    let source = fs::read_to_string(path).map_err(|e| format!("{display}: cannot read: {e}"))?;
    let files = files_with_includes(glsl, path);
    let mut hasher = DefaultHasher::new();
    (EXTENSIONS, validator).hash(&mut hasher);
    for file in &files {
        fs::read(file).unwrap_or_default().hash(&mut hasher);
    }
    let shader = Source { glsl, out, path, display, text: &source, hash: hasher.finish(), validator };
    let flat = name.replace('/', "__");
    let (has_texels, has_lenses) = (has_texel_form(&files), has_lens_form(&files));
    let all = [(false, false), (true, false), (false, true), (true, true)];
    let mut forms = Vec::new();
    for (texels, lenses) in all.into_iter().filter(|form| form.0 <= has_texels && form.1 <= has_lenses) {
        let [(texel_name, texel_macro), (lens_name, lens_macro)] =
            [(texels, ("__texels", TEXELS)), (lenses, ("__lenses", LENSES))]
                .map(|(has, form)| if has { form } else { ("", "") });
        let name = format!("{flat}{texel_name}{lens_name}");
        let (spirv_file, shader) = shader.form(&name, &format!("{texel_macro}{lens_macro}"))?;
        forms.push(generate::Form { texels, lenses, spirv_file, shader });
    }
    Ok(generate::Kernel { name, source, forms })
}

/// Source of a shader.
struct Source<'a> {
    glsl: &'a Path,
    out: &'a Path,
    path: &'a Path,
    display: &'a str,
    text: &'a str,
    /// Hash of all files and options that the compiled module depends on.
    hash: u64,
    validator: bool,
}

impl Source<'_> {
    /// Compiles one form (or takes it from the cache), reflects it, and writes the module as a Rust array.
    fn form(&self, flat: &str, macros: &str) -> Result<(String, reflect::Shader), String> {
        let Self { out, display, .. } = self;
        let cached = out.join(format!("{flat}.{:016x}.spv", self.hash));
        let spirv = match fs::read(&cached) {
            Ok(bytes) => bytes.chunks_exact(4).map(|c| u32::from_le_bytes(c.try_into().unwrap())).collect(),
            Err(_) => {
                let spirv = compile(self.glsl, self.path, display, self.text, macros)?;
                let bytes: Vec<u8> = spirv.iter().flat_map(|w| w.to_le_bytes()).collect();
                if self.validator {
                    validate(&bytes, &out.join(format!("{flat}.unchecked.spv")), display)?;
                }
                forget_older(out, flat);
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
        Ok((spirv_file, shader))
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
