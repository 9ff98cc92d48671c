//! Writes the Rust side of each shader from its reflection ([`super::reflect`]). Used by build.rs.

use super::reflect::{Binding, BindingKind, Block, Field, Shader};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// A compiled shader.
pub struct Kernel {
    /// Path below glsl/ without extension, "sort/sort_upsweep".
    pub name: String,
    /// Its source, from which documentation comments are copied.
    pub source: String,
    /// Its forms, the plain one first.
    pub forms: Vec<Form>,
}

/// A form of a shader: it may read texels, and draw through a lens.
pub struct Form {
    /// True if it reads texels.
    pub texels: bool,
    /// True if it is for cameras with a lens.
    pub lenses: bool,
    /// Its interface.
    pub shader: Shader,
    /// File with its SPIR-V as a Rust array.
    pub spirv_file: String,
}

impl Kernel {
    /// Interface of the plain form.
    fn plain(&self) -> &Shader {
        &self.forms[0].shader
    }

    fn has_lenses(&self) -> bool {
        self.forms.iter().any(|form| form.lenses)
    }

    /// Interface of the form with the most bindings, constants and shared memory.
    fn widest(&self) -> &Shader {
        self.forms.iter().find(|form| form.lenses).map_or(self.plain(), |form| &form.shader)
    }
}

/// Returns the text of `kernels.rs`: modules that mirror the folders of glsl/.
pub fn kernels(kernels: &[Kernel], constants: &str) -> Result<String, String> {
    let mut tree: BTreeMap<&str, Vec<(&str, &Kernel)>> = BTreeMap::new();
    let mut errors = Vec::new();
    for kernel in kernels {
        let (folder, stem) = kernel.name.rsplit_once('/').unwrap_or(("", &kernel.name));
        tree.entry(folder).or_default().push((stem, kernel));
    }
    let mut out = constants.to_owned();
    let mut visits = String::new();
    for (folder, members) in tree {
        if folder.contains('/') {
            errors.push(format!("glsl/{folder}: kernels lie in folders directly below glsl/"));
        }
        let nested = !folder.is_empty();
        if nested {
            let _ = writeln!(out, "/// Kernels of `glsl/{folder}`.\npub mod {folder} {{");
        }
        for (stem, kernel) in members {
            let path = kernel.name.replace('/', "::");
            let _ = writeln!(visits, "visitor.visit::<{path}::Interface>();");
            match module(stem, kernel) {
                Ok(text) => out.push_str(&text),
                Err(error) => errors.push(format!("glsl/{}.comp: {error}", kernel.name)),
            }
        }
        if nested {
            out.push_str("}\n");
        }
    }
    let _ = writeln!(
        out,
        "/// Shows every kernel to a visitor, by name in alphabetical order of the folders.\n\
         pub fn visit_all(visitor: &mut impl crate::vk::KernelVisitor) {{\n{visits}let _ = visitor;\n}}"
    );
    match blocks(kernels) {
        Ok(text) => out.push_str(&text),
        Err(error) => errors.push(error),
    }
    if errors.is_empty() { Ok(out) } else { Err(errors.join("\n")) }
}

/// Returns the module of uniform blocks, one struct for all kernels that share a block.
fn blocks(kernels: &[Kernel]) -> Result<String, String> {
    let mut all: BTreeMap<&str, (&Block, &Kernel)> = BTreeMap::new();
    let mut out = String::from(
        "/// Uniform blocks, which several kernels may share.\n#[allow(clippy::all)]\npub mod blocks {\n",
    );
    for kernel in kernels {
        for binding in &kernel.plain().bindings {
            let BindingKind::Uniform(block) = &binding.kind else { continue };
            let (first, other) = *all.entry(&block.name).or_insert((block, kernel));
            if first != block {
                return Err(format!(
                    "uniform block '{}' has other members in glsl/{}.comp than in glsl/{}.comp",
                    block.name, kernel.name, other.name
                ));
            }
        }
    }
    for (name, (block, kernel)) in all {
        check_identifier(name)?;
        let about = format!("A uniform block, as in `glsl/{}.comp`.", kernel.name);
        let _ = writeln!(out, "#[doc = {about:?}]");
        out.push_str(&host_struct(name, &block.members, &kernel.source)?);
    }
    out.push_str("}\n");
    Ok(out)
}

/// Returns the end of a block's last member, bytes.
fn end_of(members: &[Field]) -> u32 {
    members.last().map_or(0, |m| m.offset + m.bytes)
}

/// Returns a struct with a block's layout and asserted offsets.
fn host_struct(name: &str, members: &[Field], source: &str) -> Result<String, String> {
    let mut out = format!(
        "#[repr(C)]\n#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]\npub struct {name} {{\n"
    );
    for member in members {
        check_identifier(&member.name)?;
        let about = format!("At byte {}.{}", member.offset, comment_of(source, &member.name));
        let _ = writeln!(out, "#[doc = {about:?}]\npub {}: {},", member.name, member.rust_type);
    }
    let _ = writeln!(
        out,
        "}}\nimpl Default for {name} {{ fn default() -> Self {{ bytemuck::Zeroable::zeroed() }} }}\nconst _: () = {{"
    );
    for Field { name: field, offset, .. } in members {
        let _ = writeln!(out, "assert!(std::mem::offset_of!({name}, {field}) == {offset});");
    }
    let _ = writeln!(out, "assert!(std::mem::size_of::<{name}>() == {});\n}};", end_of(members));
    Ok(out)
}

/// Mirrors lines `const uint NAME = 16;` (and float, int, bool) with their comments.
pub fn constants(source: &str) -> Result<String, String> {
    let mut out =
        String::from("/// Constants that host and shaders share, from `glsl/include/constants.glsl`.\n");
    out.push_str("pub mod constants {\n");
    let mut documentation: Vec<&str> = Vec::new();
    for (index, line) in source.lines().enumerate() {
        let line = line.trim();
        if let Some(comment) = line.strip_prefix("//") {
            documentation.push(comment.trim_start_matches('/').trim());
            continue;
        }
        let Some(rest) = line.strip_prefix("const ") else {
            documentation.clear();
            continue;
        };
        let (declaration, comment) = rest.split_once("//").unwrap_or((rest, ""));
        let parsed = declaration.trim().strip_suffix(';').and_then(|d| {
            let (left, value) = d.split_once('=')?;
            let (ty, name) = left.trim().split_once(' ')?;
            Some((ty.trim(), name.trim(), value.trim()))
        });
        let Some((ty, name, value)) = parsed else {
            return Err(format!(
                "glsl/include/constants.glsl:{}: write `const TYPE NAME = LITERAL;`",
                index + 1
            ));
        };
        let value = match ty {
            "uint" => format!("u32 = {}", value.trim_end_matches(['u', 'U'])),
            "int" => format!("i32 = {value}"),
            "float" => format!("f32 = {}", value.trim_end_matches(['f', 'F'])),
            "bool" => format!("bool = {value}"),
            _ => continue,
        };
        let comment = comment.trim().to_owned();
        let text = if comment.is_empty() { documentation.join(" ") } else { comment };
        let text = if text.is_empty() { format!("`{name}`") } else { text };
        let _ = writeln!(out, "#[doc = {text:?}]\n#[allow(clippy::all)]\npub const {name}: {value};");
        documentation.clear();
    }
    out.push_str("}\n");
    Ok(out)
}

fn module(stem: &str, kernel: &Kernel) -> Result<String, String> {
    let mut out = String::new();
    check_identifier(stem)?;
    if let Some(difference) =
        kernel.forms.iter().find_map(|form| kernel.plain().difference(&form.shader, true))
    {
        return Err(format!("one of its forms has other {difference}"));
    }
    let _ = writeln!(out, "#[doc = \"`glsl/{}.comp`\"]\n#[doc = \"\"]\n#[doc = \"```text\"]", kernel.name);
    for line in leading_comment(&kernel.source) {
        let _ = writeln!(out, "#[doc = {line:?}]");
    }
    let _ = writeln!(
        out,
        "#[doc = \"```\"]\n#[allow(clippy::all, unused_imports, unused_variables, unused_parens)]"
    );
    let _ = writeln!(
        out,
        "pub mod {stem} {{\nuse crate::vk::{{Access, BindingInfo, BindingKind, Buffer, ConstantInfo, ConstantKind, Form, Generated, Image, ImageInfo, ImageKind, KernelInterface, Limits, TexelFormat}};"
    );
    out.push_str(&bind(kernel)?);
    out.push_str(&push(kernel)?);
    out.push_str(&spec(kernel)?);
    out.push_str(&interface(kernel));
    out.push_str("}\n");
    Ok(out)
}

fn bind(kernel: &Kernel) -> Result<String, String> {
    let shader = kernel.widest();
    let mut names = BTreeSet::new();
    let mut numbers = BTreeSet::new();
    let mut fields = String::new();
    for b in shader.bindings.iter().chain(&shader.images) {
        check_identifier(&b.name)?;
        if !names.insert(&b.name) {
            return Err(format!(
                "two bindings are named '{}', by a first member, a block or an image: rename one",
                b.name
            ));
        }
        if !numbers.insert(b.binding) {
            return Err(format!("two bindings have number {}", b.binding));
        }
        let access = match b.kind {
            BindingKind::Storage if !b.writes => "read",
            BindingKind::Storage if !b.reads => "written",
            BindingKind::Storage => "read and written",
            BindingKind::Texels(_) => "read as texels",
            BindingKind::Uniform(_) => "a uniform block",
            BindingKind::StorageImage | BindingKind::SampledImage => "an image",
        };
        let resource = if is_image(b) { "Image" } else { "Buffer" };
        let about = format!("Binding {}, {access}.{}", b.binding, comment_of(&kernel.source, &b.name));
        let _ = writeln!(fields, "#[doc = {about:?}]\npub {}: &'a {resource},", b.name);
    }
    if fields.is_empty() {
        fields.push_str("#[doc(hidden)] pub none: std::marker::PhantomData<&'a Buffer>,\n");
    }
    Ok(format!("/// What the kernel works on.\n#[derive(Clone, Copy)]\npub struct Bind<'a> {{\n{fields}}}\n"))
}

fn push(kernel: &Kernel) -> Result<String, String> {
    let about = "/// The push constants of one dispatch.\n";
    let push = &kernel.widest().push;
    if push.is_empty() {
        let derives = "#[derive(Clone, Copy, Debug, Default, PartialEq)]";
        return Ok(format!("{about}#[repr(C)]\n{derives}\npub struct Push {{}}\n"));
    }
    Ok(format!("{about}{}", host_struct("Push", push, &kernel.source)?))
}

fn spec(kernel: &Kernel) -> Result<String, String> {
    let shader = kernel.widest();
    let mut fields = String::new();
    let mut defaults = String::new();
    for c in &shader.spec {
        let name = c.name.to_lowercase();
        check_identifier(&name)?;
        let about = format!("`{}`, constant_id {}.{}", c.name, c.id, comment_of(&kernel.source, &c.name));
        let _ = writeln!(fields, "#[doc = {about:?}]\npub {name}: {},", c.rust_type);
        let value = match c.rust_type {
            "bool" => (c.default_bits != 0).to_string(),
            "i32" => format!("{}", c.default_bits as i32),
            "f32" => format!("f32::from_bits({})", c.default_bits),
            _ => c.default_bits.to_string(),
        };
        let _ = writeln!(defaults, "{name}: {value},");
    }
    if kernel.has_lenses() {
        fields.push_str(
            "/// True for cameras with a lens: a form of the shader, no constant.\npub lenses: bool,\n",
        );
        defaults.push_str("lenses: false,\n");
    }
    Ok(format!(
        "/// The specialization constants of a pipeline; the shader's own values by default.\n\
         #[derive(Clone, Copy, Debug, PartialEq)]\npub struct Spec {{\n{fields}}}\n\
         impl Default for Spec {{ fn default() -> Self {{ Self {{\n{defaults}}} }} }}\n{}",
        for_device(shader)
    ))
}

/// Returns a constructor of `Spec` that fits a device.
fn for_device(shader: &Shader) -> String {
    let has = |name: &str| shader.spec.iter().any(|c| c.name == name && c.rust_type == "u32");
    let mut body = String::from("let mut spec = Self::default();\n");
    if has("SUBGROUP_SIZE") {
        body.push_str("spec.subgroup_size = limits.subgroup_size;\n");
    }
    if has("REGION_HEIGHT") {
        body.push_str("spec.region_height = spec.region_height.max(limits.subgroup_size / 8);\n");
    }
    if has("WORKGROUP_SIZE") {
        body.push_str(
            "spec.workgroup_size = limits.workgroup_size(spec.workgroup_size);\n\
             while Interface::shared_bytes(&spec) > limits.shared_memory_bytes\n\
             && spec.workgroup_size > limits.subgroup_size {\n\
             spec.workgroup_size = limits.workgroup_size(spec.workgroup_size / 2);\n}\n",
        );
    }
    format!(
        "impl Spec {{\n/// The shader's values, with the device's subgroup size and the largest workgroup up to the \
         shader's own\n/// that the device's limits on invocations, subgroups and shared memory allow.\n\
         #[allow(unused_mut)]\npub fn for_device(limits: &Limits) -> Self {{\n{body}spec\n}}\n}}\n"
    )
}

fn interface(kernel: &Kernel) -> String {
    let shader = kernel.plain();
    let image_infos = binding_infos(&shader.images);
    let all =
        |bindings: &[Binding]| bindings.iter().map(|b| format!("bind.{}, ", b.name)).collect::<String>();
    let wide = kernel.widest();
    let (buffers, images) = (all(&wide.bindings), all(&shader.images));
    let mut forms = String::new();
    for Form { texels, lenses, shader, spirv_file } in &kernel.forms {
        let (push, infos) = (end_of(&shader.push), binding_infos(&shader.bindings));
        let _ = writeln!(
            forms,
            "Form {{ spirv: &include!(concat!(env!(\"OUT_DIR\"), \"/\", {spirv_file:?})), bindings: &[\n{infos}], \
             push_bytes: {push}, texels: {texels}, lenses: {lenses} }},"
        );
    }
    let lenses = if kernel.has_lenses() { "spec.lenses" } else { "false" };
    let (mut constants, mut entries) = (String::new(), String::new());
    for c in &kernel.widest().spec {
        let kind = match c.rust_type {
            "f32" => "Float",
            "i32" => "Int",
            "bool" => "Bool",
            _ => "Uint",
        };
        let _ = writeln!(
            constants,
            "ConstantInfo {{ name: {:?}, id: {}, kind: ConstantKind::{kind} }},",
            c.name, c.id
        );
        let field = format!("spec.{}", c.name.to_lowercase());
        let bits = match c.rust_type {
            "f32" => format!("{field}.to_bits()"),
            "u32" => field,
            _ => format!("{field} as u32"),
        };
        let _ = write!(entries, "({}, {bits}), ", c.id);
    }
    let subgroup = if shader.spec.iter().any(|c| c.name.to_lowercase() == "subgroup_size") {
        "Some(spec.subgroup_size)"
    } else {
        "None"
    };
    let push_bytes = if kernel.widest().push.is_empty() { "&[]" } else { "bytemuck::bytes_of(push)" };
    let [x, y, z] = &shader.workgroup_size;
    format!(
        "/// What the kernel is, for [`crate::vk::Kernel`].\npub struct Interface;\n\
         impl Generated for Interface {{}}\n\
         impl KernelInterface for Interface {{\n\
         const NAME: &'static str = {name:?};\n\
         const FORMS: &'static [Form] = &[\n{forms}];\n\
         const IMAGES: &'static [ImageInfo] = &[\n{image_infos}];\n\
         const CONSTANTS: &'static [ConstantInfo] = &[\n{constants}];\n\
         type Bind<'a> = Bind<'a>;\ntype Push = Push;\ntype Spec = Spec;\n\
         fn buffers<'a>(bind: &Self::Bind<'a>) -> impl AsRef<[&'a Buffer]> {{ let all: [&'a Buffer; {count}] = [{buffers}]; all }}\n\
         fn images<'a>(bind: &Self::Bind<'a>) -> impl AsRef<[&'a Image]> {{ let all: [&'a Image; {image_count}] = [{images}]; all }}\n\
         fn push_bytes(push: &Push) -> &[u8] {{ {push_bytes} }}\n\
         fn spec_entries(spec: &Spec) -> Vec<(u32, u32)> {{ vec![{entries}] }}\n\
         fn lenses(spec: &Spec) -> bool {{ {lenses} }}\n\
         fn subgroup_size(spec: &Spec) -> Option<u32> {{ {subgroup} }}\n\
         fn spec_for(limits: &Limits) -> Spec {{ Spec::for_device(limits) }}\n\
         fn workgroup_size(spec: &Spec) -> [u32; 3] {{ [{x}, {y}, {z}] }}\n\
         fn shared_bytes(spec: &Spec) -> u32 {{ {shared} }}\n}}\n",
        name = kernel.name,
        count = wide.bindings.len(),
        image_count = shader.images.len(),
        shared = kernel.widest().shared_bytes,
    )
}

fn is_image(binding: &Binding) -> bool {
    matches!(binding.kind, BindingKind::StorageImage | BindingKind::SampledImage)
}

fn binding_infos(bindings: &[Binding]) -> String {
    let mut infos = String::new();
    for b in bindings {
        let access = match (b.reads, b.writes) {
            (true, false) => "Read",
            (false, true) => "Write",
            _ => "ReadWrite",
        };
        let (info, kind) = match &b.kind {
            BindingKind::Storage => ("BindingInfo", "BindingKind::Storage".to_owned()),
            BindingKind::Texels(format) => {
                ("BindingInfo", format!("BindingKind::Texels(TexelFormat::{format})"))
            }
            BindingKind::Uniform(block) => {
                ("BindingInfo", format!("BindingKind::Uniform {{ bytes: {} }}", end_of(&block.members)))
            }
            BindingKind::StorageImage => ("ImageInfo", "ImageKind::Storage".to_owned()),
            BindingKind::SampledImage => ("ImageInfo", "ImageKind::Sampled".to_owned()),
        };
        let aliased = if is_image(b) { String::new() } else { format!("aliased: {}, ", b.aliased) };
        let _ = writeln!(
            infos,
            "{info} {{ name: {:?}, binding: {}, access: Access::{access}, {aliased}kind: {kind} }},",
            b.name, b.binding
        );
    }
    infos
}

/// Returns the first block of `//` lines, before or after `#version` and extensions.
fn leading_comment(source: &str) -> Vec<&str> {
    let lines = source.lines().map(str::trim).skip_while(|l| l.is_empty() || l.starts_with('#'));
    lines.map_while(|l| l.strip_prefix("//")).map(|l| l.strip_prefix(' ').unwrap_or(l)).collect()
}

/// Returns the comment after the declaration of a name, with a space before it; empty without one.
fn comment_of(source: &str, name: &str) -> String {
    let declares = |code: &str| {
        let mut words = code.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
        code.contains(';') && words.any(|w| w == name)
    };
    let mut declarations =
        source.lines().filter_map(|l| l.split_once("//")).filter(|(code, _)| declares(code));
    match declarations.next() {
        Some((_, comment)) => format!(" {}", comment.trim()),
        None => String::new(),
    }
}

fn check_identifier(name: &str) -> Result<(), String> {
    const KEYWORDS: [&str; 18] = [
        "as", "box", "crate", "dyn", "enum", "fn", "impl", "in", "let", "loop", "match", "mod", "move",
        "mut", "ref", "self", "type", "use",
    ];
    let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if name.is_empty() || !plain || name.starts_with(|c: char| c.is_ascii_digit()) || KEYWORDS.contains(&name)
    {
        return Err(format!("'{name}' cannot be a name in Rust: rename it"));
    }
    Ok(())
}
