//! Compiles GLSL to SPIR-V. Used by build.rs, and by programs built with the feature `hot-reload`.

use glslang::include::{IncludeHandler, IncludeResult, IncludeType};
use glslang::{
    Compiler, CompilerOptions, ShaderInput, ShaderMessage, ShaderSource, ShaderStage, SourceLanguage,
};
use glslang::{SpirvVersion, Target, VulkanVersion};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Extensions that every shader may use without naming them.
pub const EXTENSIONS: &str = "\
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

/// Macro that selects the texel form of a shader: see [`has_texel_form`].
pub const TEXELS: &str = "#define TEXELS\n";

/// Macro that selects the form of a shader for cameras with a lens: see [`has_lens_form`].
pub const LENSES: &str = "#define LENSES\n";

/// True if a shader with these files has two forms: one reads storage buffers, the other reads texels.
pub fn has_texel_form(files: &[PathBuf]) -> bool {
    files.iter().any(|file| file.ends_with("include/buffers.glsl"))
}

/// True if a shader with these files has two forms: one for pinholes and parallel rays, the other for cameras with a lens.
pub fn has_lens_form(files: &[PathBuf]) -> bool {
    files.iter().any(|file| file.ends_with("include/lens.glsl") || file.ends_with("include/seam.glsl"))
}

/// Compiles a shader for Vulkan 1.3. `form` holds the macros of its form. The file's extension selects the stage. `display` is
/// the file's name in errors. The error has one line "error: path:line: message" for each mistake.
pub fn compile(
    glsl: &Path,
    path: &Path,
    display: &str,
    source: &str,
    form: &str,
) -> Result<Vec<u32>, String> {
    let compiler = Compiler::acquire().ok_or("glslang does not start")?;
    let options = CompilerOptions {
        source_language: SourceLanguage::GLSL,
        target: Target::Vulkan { version: VulkanVersion::Vulkan1_3, spirv_version: SpirvVersion::SPIRV1_6 },
        version_profile: None,
        messages: ShaderMessage::VULKAN_RULES | ShaderMessage::SPV_RULES | ShaderMessage::ENHANCED,
    };
    let mut includer = Includer { glsl, file: path };
    let macros = format!("{form}{}", camera_block_members(glsl)?);
    let source = ShaderSource::from(with_prelude(source, &macros));
    let none: Option<&[(&str, Option<&str>)]> = None;
    let input = ShaderInput::new(&source, stage_of(path), &options, none, Some(&mut includer))
        .map_err(|e| report(&e, display))?;
    let shader = glslang::Shader::new(compiler, input).parse().map_err(|e| report(&e, display))?;
    shader.compile().map_err(|e| report(&e, display))
}

/// Returns the macro of the number of words in camera_members.glsl, which GLSL itself cannot count.
fn camera_block_members(glsl: &Path) -> Result<String, String> {
    let source = fs::read_to_string(glsl.join("include/camera_members.glsl")).unwrap_or_default();
    let members = source.lines().filter(|line| !line.starts_with("//"));
    let words = members.map(|line| match line.split_once(' ').unwrap_or_default().0 {
        "float" | "uint" => Ok(1),
        "vec2" => Ok(2),
        "vec3" => Ok(3),
        "vec4" => Ok(4),
        _ => Err(format!("glsl/include/camera_members.glsl: '{line}' is no float, uint or vec")),
    });
    Ok(format!("#define CAMERA_BLOCK_MEMBERS {}\n", words.sum::<Result<u32, _>>()?))
}

/// Returns Compute, except for the graphics shaders of the embedding example.
fn stage_of(path: &Path) -> ShaderStage {
    match path.extension().and_then(|e| e.to_str()) {
        Some("vert") => ShaderStage::Vertex,
        Some("frag") => ShaderStage::Fragment,
        _ => ShaderStage::Compute,
    }
}

/// Returns the source with [`EXTENSIONS`] and `macros` after its `#version`; line numbers stay the same.
fn with_prelude(source: &str, macros: &str) -> String {
    let Some(at) = source.find("#version") else { return source.to_owned() };
    let end = source[at..].find('\n').map_or(source.len(), |n| at + n + 1);
    let line = source[..end].lines().count() + 1;
    format!("{}{EXTENSIONS}{macros}#line {line}\n{}", &source[..end], &source[end..])
}

/// Formats glslang's log as "path:line: message". glslang calls the file itself 0, and includes by their names.
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

/// Looks for an include next to the shader, then in glsl/include, then below glsl.
fn resolve(glsl: &Path, file: &Path, name: &str) -> Option<PathBuf> {
    let candidates = [file.parent()?.join(name), glsl.join("include").join(name), glsl.join(name)];
    candidates.into_iter().find(|p| p.is_file())
}

impl IncludeHandler for Includer<'_> {
    fn include(&mut self, _: IncludeType, name: &str, includer: &str, _: usize) -> Option<IncludeResult> {
        // Includes are named by their path from the crate's root, which errors show.
        let root = self.glsl.parent()?;
        let from = if includer.is_empty() { self.file.to_owned() } else { root.join(includer) };
        let path = resolve(self.glsl, &from, name).or_else(|| resolve(self.glsl, self.file, name))?;
        let shown = path.strip_prefix(root).unwrap_or(&path).display().to_string().replace('\\', "/");
        // A shader may include another shader after a macro. Only the outer `#version` may remain.
        let data = fs::read_to_string(path).ok()?.replacen("#version 460\n", "\n", 1);
        Some(IncludeResult { name: shown, data })
    }
}

/// Returns a shader and all of its direct and indirect includes, each once.
pub fn files_with_includes(glsl: &Path, path: &Path) -> Vec<PathBuf> {
    fn visit(glsl: &Path, path: &Path, seen: &mut BTreeSet<PathBuf>, files: &mut Vec<PathBuf>) {
        if !seen.insert(path.to_owned()) {
            return;
        }
        files.push(path.to_owned());
        let source = fs::read_to_string(path).unwrap_or_default();
        for line in source.lines().filter_map(|l| l.trim().strip_prefix("#include")) {
            let name = line.trim().trim_matches(['"', '<', '>']);
            if let Some(found) = resolve(glsl, path, name) {
                visit(glsl, &found, seen, files);
            }
        }
    }
    let mut files = Vec::new();
    visit(glsl, path, &mut BTreeSet::new(), &mut files);
    files
}
