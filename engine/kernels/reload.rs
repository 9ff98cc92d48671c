//! Recompiles kernels while a program runs (feature `hot-reload`).

use super::compile;
use super::reflect::reflect;
use crate::error::{Error, Result};
use crate::vk::{Form, KernelInterface, KernelVisitor, Limits};
use std::fs;
use std::path::{Path, PathBuf};

/// Returns the source files of a kernel: its own, then its includes. `glsl` is the folder of all shaders.
pub fn files(glsl: &Path, kernel: &str) -> Vec<PathBuf> {
    compile::files_with_includes(glsl, &source(glsl, kernel))
}

fn source(glsl: &Path, kernel: &str) -> PathBuf {
    glsl.join(format!("{kernel}.comp"))
}

/// Compiles the current source of a kernel, in its form for a device, for [`crate::vk::Context::replace_shader`].
///
/// # Errors
/// [`Error::Input`] with the compiler's messages, each "file:line: message". Also when buffers, push constants,
/// specialization constants or workgroup differ from the built program's.
pub fn compile(glsl: &Path, kernel: &str, limits: &Limits) -> Result<Vec<u32>> {
    let path = source(glsl, kernel);
    let text = fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let shown = format!("glsl/{kernel}.comp");
    let failed = |problem: String| Error::input(&path, problem, "");
    let mut built = Built { kernel, limits, form: None };
    super::visit_all(&mut built);
    let form = if built.form.is_some_and(|form| form.texels) { compile::TEXELS } else { "" };
    let spirv = compile::compile(glsl, &path, &shown, &text, form)
        .map_err(|log| failed(log.replace("error: ", "")))?;
    let new = reflect(&spirv).map_err(failed)?;
    let Some(old) = built.form.and_then(|form| reflect(form.spirv).ok()) else {
        return Err(Error::input(&path, "is no kernel of this program", "build the program again"));
    };
    match old.difference(&new, false) {
        None => Ok(spirv),
        Some(what) => Err(Error::input(&path, format!("its {what} changed"), "build the program again")),
    }
}

/// Finds the form of a kernel that the program was built with.
struct Built<'a> {
    kernel: &'a str,
    limits: &'a Limits,
    form: Option<Form>,
}

impl KernelVisitor for Built<'_> {
    fn visit<K: KernelInterface>(&mut self) {
        if K::NAME == self.kernel {
            self.form = Some(K::form(self.limits, &K::spec_for(self.limits)));
        }
    }
}
