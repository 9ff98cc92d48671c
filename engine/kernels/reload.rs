//! Compiles kernels again while a program runs: the feature `hot-reload`.

use super::compile;
use super::reflect::{Shader, reflect};
use crate::vk::{KernelInterface, KernelVisitor};
use crate::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// The files that a kernel is made of: its own, then its includes. `glsl` is the folder of all shaders.
pub fn files(glsl: &Path, kernel: &str) -> Vec<PathBuf> {
    compile::files_with_includes(glsl, &source(glsl, kernel))
}

fn source(glsl: &Path, kernel: &str) -> PathBuf {
    glsl.join(format!("{kernel}.comp"))
}

/// Compiles a kernel from its source as it is now, for [`crate::vk::Context::replace_shader`].
///
/// # Errors
/// [`Error::Input`] with the compiler's messages, each "file:line: message"; for a shader whose buffers, push
/// constants, specialization constants or workgroup differ from those that the program was built with.
pub fn compile(glsl: &Path, kernel: &str) -> Result<Vec<u32>> {
    let path = source(glsl, kernel);
    let text = fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let shown = format!("glsl/{kernel}.comp");
    let failed = |problem: String| Error::input(&path, problem, "");
    let spirv =
        compile::compile(glsl, &path, &shown, &text).map_err(|log| failed(log.replace("error: ", "")))?;
    let new = reflect(&spirv).map_err(failed)?;
    let mut built = Built { kernel, shader: None };
    super::visit_all(&mut built);
    let Some(old) = built.shader else {
        return Err(Error::input(&path, "is no kernel of this program", "build the program again"));
    };
    match difference(&old, &new) {
        None => Ok(spirv),
        Some(what) => Err(Error::input(&path, format!("its {what} changed"), "build the program again")),
    }
}

/// Finds what a kernel was when the program was built.
struct Built<'a> {
    kernel: &'a str,
    shader: Option<Shader>,
}

impl KernelVisitor for Built<'_> {
    fn visit<K: KernelInterface>(&mut self) {
        if K::NAME == self.kernel {
            self.shader = reflect(K::SPIRV).ok();
        }
    }
}

fn difference(old: &Shader, new: &Shader) -> Option<&'static str> {
    let parts = [
        (old.bindings != new.bindings, "buffers"),
        (old.images != new.images, "images"),
        (old.push != new.push, "push constants"),
        (old.spec != new.spec, "specialization constants"),
        (old.workgroup_size != new.workgroup_size, "workgroup"),
        (old.shared_bytes != new.shared_bytes, "shared memory"),
    ];
    parts.into_iter().find(|(differs, _)| *differs).map(|(_, what)| what)
}
