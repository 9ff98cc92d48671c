//! Reads from a shader's SPIR-V its bindings, push constants, specialization constants, workgroup size and shared memory.
//!
//! build.rs generates the typed interface of each kernel from them. Only SPIR-V that this crate's compute shaders use is
//! supported; an error names anything else.

// Also a module of `vk`, which build.rs does not compile.
#[allow(clippy::duplicate_mod)]
#[path = "../vk/binding_numbers.rs"]
mod binding_numbers;

use binding_numbers::{BUFFERS, SAMPLED_IMAGE, STORAGE_IMAGE, UNIFORM_BLOCK};
use std::collections::BTreeMap;

/// Interface that a shader declares.
#[derive(Debug, Default, PartialEq)]
pub struct Shader {
    /// Buffers by binding.
    pub bindings: Vec<Binding>,
    /// Images by binding.
    pub images: Vec<Binding>,
    /// Members of the push constant block, in order.
    pub push: Vec<Field>,
    /// Specialization constants by id.
    pub spec: Vec<SpecConstant>,
    /// Workgroup size: a Rust expression of type u32 over `spec` for each axis.
    pub workgroup_size: [String; 3],
    /// Bytes of shared memory: a Rust expression of type u32 over `spec`.
    pub shared_bytes: String,
}

impl Shader {
    /// Returns the first part of the interface that differs from another shader's. With `forms`, the two may be forms of
    /// one shader: they read the same buffers in different ways, and the other one may have more members in blocks, more constants
    /// and shared memory of its own.
    pub fn difference(&self, other: &Self, forms: bool) -> Option<&'static str> {
        let same = |(a, b): (&Binding, &Binding)| {
            let access = |binding: &Binding| (binding.reads, binding.writes, binding.aliased);
            (&a.name, a.binding, access(a)) == (&b.name, b.binding, access(b))
                && (a.kind == b.kind || forms && are_forms(&a.kind, &b.kind))
        };
        let buffers = (self.bindings.len() == other.bindings.len()
            || forms && self.bindings.len() < other.bindings.len())
            && self.bindings.iter().zip(&other.bindings).all(same);
        let parts = [
            (buffers, "buffers"),
            (self.images == other.images, "images"),
            (self.push == other.push || forms && other.push.starts_with(&self.push), "push constants"),
            (
                self.spec == other.spec || forms && other.spec.starts_with(&self.spec),
                "specialization constants",
            ),
            (self.workgroup_size == other.workgroup_size, "workgroup"),
            (forms || self.shared_bytes == other.shared_bytes, "shared memory"),
        ];
        parts.into_iter().find(|(same, _)| !same).map(|(_, what)| what)
    }
}

/// A buffer or an image.
#[derive(Debug, PartialEq)]
pub struct Binding {
    /// First member of a storage buffer, name of a texel buffer or image, or name of a uniform block with underscores.
    pub name: String,
    /// Number of the binding in set 0.
    pub binding: u32,
    /// True if the shader may read it.
    pub reads: bool,
    /// True if the shader may write it.
    pub writes: bool,
    /// True if another binding of the shader may be the same memory while one of them is written.
    pub aliased: bool,
    /// How it is bound.
    pub kind: BindingKind,
}

/// True if a binding of one form of a shader may be the other in another form.
fn are_forms(kind: &BindingKind, other: &BindingKind) -> bool {
    match (kind, other) {
        (BindingKind::Uniform(own), BindingKind::Uniform(other)) => other.members.starts_with(&own.members),
        (BindingKind::Uniform(_), _) | (_, BindingKind::Uniform(_)) => false,
        _ => true,
    }
}

/// How a buffer or an image is bound.
#[derive(Debug, PartialEq)]
pub enum BindingKind {
    /// Storage buffer.
    Storage,
    /// Texel buffer, of this variant of `TexelFormat`.
    Texels(&'static str),
    /// Uniform block.
    Uniform(Block),
    /// Storage image.
    StorageImage,
    /// Sampled image without sampler.
    SampledImage,
}

/// A uniform block.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Its name in the shader.
    pub name: String,
    /// Its members, in order.
    pub members: Vec<Field>,
}

/// A member of the push constant block or of a uniform block.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Bytes from the start of the block.
    pub offset: u32,
    /// Its type in Rust.
    pub rust_type: String,
    /// Its size.
    pub bytes: u32,
}

/// A specialization constant.
#[derive(Debug, PartialEq)]
pub struct SpecConstant {
    /// `constant_id`.
    pub id: u32,
    /// Its name in the shader.
    pub name: String,
    /// "bool", "u32", "i32" or "f32".
    pub rust_type: &'static str,
    /// The default's bits.
    pub default_bits: u32,
}

#[derive(Clone, Debug)]
enum Type {
    Bool,
    Int {
        bits: u32,
        signed: bool,
    },
    Float {
        bits: u32,
    },
    Vector {
        of: u32,
        count: u32,
    },
    Matrix {
        column: u32,
        columns: u32,
    },
    Array {
        of: u32,
        length: u32,
    },
    RuntimeArray,
    Struct(Vec<u32>),
    Pointer {
        of: u32,
    },
    /// Buffer of texels, by the type of a component.
    TexelBuffer {
        of: u32,
    },
    /// Two-dimensional, one sample, no array.
    Image {
        storage: bool,
    },
}

#[derive(Clone, Debug)]
enum Constant {
    Value { ty: u32, bits: u32 },
    Composite(Vec<u32>),
    Operation { opcode: u32, operands: Vec<u32> },
}

const SPEC_ID: u32 = 1;
const BLOCK: u32 = 2;
const ARRAY_STRIDE: u32 = 6;
const MATRIX_STRIDE: u32 = 7;
const RESTRICT: u32 = 19;
const ALIASED: u32 = 20;
const NON_WRITABLE: u32 = 24;
const NON_READABLE: u32 = 25;
const BINDING: u32 = 33;
const DESCRIPTOR_SET: u32 = 34;
const OFFSET: u32 = 35;

#[derive(Default)]
struct Module {
    names: BTreeMap<u32, String>,
    member_names: BTreeMap<(u32, u32), String>,
    decorations: BTreeMap<(u32, u32), u32>,
    member_decorations: BTreeMap<(u32, u32, u32), u32>,
    types: BTreeMap<u32, Type>,
    constants: BTreeMap<u32, Constant>,
    /// (result id, pointer type, storage class)
    variables: Vec<(u32, u32, u32)>,
    workgroup_size_ids: Option<[u32; 3]>,
    workgroup_size: Option<[u32; 3]>,
    uses_subgroups: bool,
}

/// Reflects one compute shader.
pub fn reflect(spirv: &[u32]) -> Result<Shader, String> {
    let module = Module::parse(spirv)?;
    let spec = module.spec_constants()?;
    if module.uses_subgroups && !spec.iter().any(|c| c.name == "SUBGROUP_SIZE") {
        // Without the constant the pipeline's subgroup size is not fixed, and some drivers vary it between pipelines.
        return Err("subgroup operations without `layout(constant_id = 1) const uint SUBGROUP_SIZE`".into());
    }
    let mut shader = Shader { spec, ..Shader::default() };
    let mut shared = Vec::new();
    for &(id, pointer, storage_class) in &module.variables {
        let Some(Type::Pointer { of }) = module.types.get(&pointer) else { continue };
        match storage_class {
            12 => shader.bindings.push(module.storage_buffer(id, *of)?),
            9 => shader.push = module.members(*of, "push constant")?,
            2 => shader.bindings.push(module.uniform_block(id, *of)?),
            4 => shared.push(module.shared_layout(*of, &shader.spec)?),
            0 if matches!(module.types.get(of), Some(Type::TexelBuffer { .. })) => {
                shader.bindings.push(module.texel_buffer(id, *of)?);
            }
            0 if matches!(module.types.get(of), Some(Type::Image { .. })) => {
                shader.images.push(module.image(id, *of)?);
            }
            0 => {
                return Err(format!("'{}': only buffers and plain 2D images can be bound", module.name(id)));
            }
            _ => {}
        }
    }
    shader.bindings.sort_by_key(|b| b.binding);
    shader.images.sort_by_key(|i| i.binding);
    shader.shared_bytes = total(shared).bytes;
    shader.workgroup_size = module.workgroup_size(&shader.spec)?;
    Ok(shader)
}

/// Converts `CameraBlock` to `camera_block`.
fn with_underscores(name: &str) -> String {
    let mut words = String::new();
    for (place, letter) in name.char_indices() {
        if letter.is_ascii_uppercase() && place > 0 {
            words.push('_');
        }
        words.push(letter.to_ascii_lowercase());
    }
    words
}

impl Module {
    fn parse(spirv: &[u32]) -> Result<Self, String> {
        if spirv.first() != Some(&0x0723_0203) || spirv.len() < 5 {
            return Err("not a SPIR-V module".into());
        }
        let mut module = Self::default();
        let mut rest = &spirv[5..];
        while let Some(&head) = rest.first() {
            let (words, opcode) = ((head >> 16) as usize, head & 0xffff);
            if words == 0 || words > rest.len() {
                return Err("truncated SPIR-V".into());
            }
            module.instruction(opcode, &rest[1..words]);
            rest = &rest[words..];
        }
        Ok(module)
    }

    fn instruction(&mut self, opcode: u32, o: &[u32]) {
        match opcode {
            5 => drop(self.names.insert(o[0], text(&o[1..]))),
            6 => drop(self.member_names.insert((o[0], o[1]), text(&o[2..]))),
            16 if o[1] == 17 => self.workgroup_size = Some([o[2], o[3], o[4]]),
            331 if o[1] == 38 => self.workgroup_size_ids = Some([o[2], o[3], o[4]]),
            20 => drop(self.types.insert(o[0], Type::Bool)),
            21 => drop(self.types.insert(o[0], Type::Int { bits: o[1], signed: o[2] != 0 })),
            22 => drop(self.types.insert(o[0], Type::Float { bits: o[1] })),
            23 => drop(self.types.insert(o[0], Type::Vector { of: o[1], count: o[2] })),
            24 => drop(self.types.insert(o[0], Type::Matrix { column: o[1], columns: o[2] })),
            28 => drop(self.types.insert(o[0], Type::Array { of: o[1], length: o[2] })),
            29 => drop(self.types.insert(o[0], Type::RuntimeArray)),
            30 => drop(self.types.insert(o[0], Type::Struct(o[1..].to_vec()))),
            // Dimension buffer, read by texel.
            25 if o[2] == 5 && o[6] == 1 => drop(self.types.insert(o[0], Type::TexelBuffer { of: o[1] })),
            // Dimension 2D, not arrayed, not multisampled; sampled 1: by texel, 2: storage.
            25 if o[2] == 1 && o[4] == 0 && o[5] == 0 => {
                self.types.insert(o[0], Type::Image { storage: o[6] == 2 });
            }
            32 => drop(self.types.insert(o[0], Type::Pointer { of: o[2] })),
            41 | 48 => drop(self.constants.insert(o[1], Constant::Value { ty: o[0], bits: 1 })),
            42 | 49 => drop(self.constants.insert(o[1], Constant::Value { ty: o[0], bits: 0 })),
            43 | 50 => drop(self.constants.insert(o[1], Constant::Value { ty: o[0], bits: o[2] })),
            44 | 51 => drop(self.constants.insert(o[1], Constant::Composite(o[2..].to_vec()))),
            52 => {
                let operation = Constant::Operation { opcode: o[2], operands: o[3..].to_vec() };
                self.constants.insert(o[1], operation);
            }
            59 => self.variables.push((o[1], o[0], o[2])),
            // OpGroupNonUniformElect to OpGroupNonUniformQuadSwap.
            333..=366 => self.uses_subgroups = true,
            71 => drop(self.decorations.insert((o[0], o[1]), o.get(2).copied().unwrap_or(0))),
            72 => {
                self.member_decorations.insert((o[0], o[1], o[2]), o.get(3).copied().unwrap_or(0));
            }
            _ => {}
        }
    }

    fn name(&self, id: u32) -> &str {
        self.names.get(&id).map_or("", String::as_str)
    }

    fn member_name(&self, block: u32, member: u32) -> Result<String, String> {
        match self.member_names.get(&(block, member)) {
            Some(name) if !name.is_empty() => Ok(name.clone()),
            _ => Err(format!("member {member} of block '{}' has no name", self.name(block))),
        }
    }

    fn binding(&self, variable: u32, name: &str) -> Result<u32, String> {
        if self.decorations.get(&(variable, DESCRIPTOR_SET)) != Some(&0) {
            return Err(format!("buffer '{name}': write set = 0"));
        }
        if self.is_aliased(variable) && self.decorations.contains_key(&(variable, RESTRICT)) {
            return Err(format!("buffer '{name}' is both ALIASED and restrict"));
        }
        let binding = self.decorations.get(&(variable, BINDING)).copied();
        binding.ok_or_else(|| format!("buffer '{name}' has no binding number"))
    }

    fn is_aliased(&self, variable: u32) -> bool {
        self.decorations.contains_key(&(variable, ALIASED))
    }

    fn storage_buffer(&self, variable: u32, block: u32) -> Result<Binding, String> {
        let block_name = self.name(block);
        let Some(Type::Struct(members)) = self.types.get(&block) else {
            return Err(format!("binding '{}': arrays of buffers cannot be bound", self.name(variable)));
        };
        if !self.decorations.contains_key(&(block, BLOCK)) {
            return Err(format!("'{block_name}' is not a buffer block"));
        }
        let binding = self.binding(variable, block_name)?;
        let everywhere = |decoration| {
            self.decorations.contains_key(&(variable, decoration))
                || (0..members.len() as u32)
                    .all(|m| self.member_decorations.contains_key(&(block, m, decoration)))
        };
        if binding >= BUFFERS {
            return Err(format!("buffer '{block_name}': its binding is not below {BUFFERS}"));
        }
        let (reads, writes) = (!everywhere(NON_READABLE), !everywhere(NON_WRITABLE));
        let (name, aliased, kind) =
            (self.member_name(block, 0)?, self.is_aliased(variable), BindingKind::Storage);
        Ok(Binding { name, binding, reads, writes, aliased, kind })
    }

    fn texel_buffer(&self, variable: u32, ty: u32) -> Result<Binding, String> {
        let name = self.name(variable).to_owned();
        let binding = self.binding(variable, &name)?;
        let component = match self.types.get(&ty) {
            Some(Type::TexelBuffer { of }) => self.types.get(of),
            _ => None,
        };
        let format = match component {
            Some(Type::Float { bits: 32 }) => "Rgba32Float",
            Some(Type::Int { bits: 32, signed: false }) => "R32Uint",
            _ => return Err(format!("texels '{name}': neither textureBuffer nor utextureBuffer")),
        };
        let (aliased, kind) = (self.is_aliased(variable), BindingKind::Texels(format));
        Ok(Binding { name, binding, reads: true, writes: false, aliased, kind })
    }

    fn image(&self, variable: u32, ty: u32) -> Result<Binding, String> {
        let name = self.name(variable).to_owned();
        let storage = matches!(self.types.get(&ty), Some(Type::Image { storage: true }));
        let (binding, kind) = match storage {
            true => (STORAGE_IMAGE, BindingKind::StorageImage),
            false => (SAMPLED_IMAGE, BindingKind::SampledImage),
        };
        let at = |decoration| self.decorations.get(&(variable, decoration)).copied();
        if at(DESCRIPTOR_SET) != Some(0) || at(BINDING) != Some(binding) {
            return Err(format!("image '{name}': write set = 0, binding = {binding}"));
        }
        let (reads, writes) = (at(NON_READABLE).is_none(), storage && at(NON_WRITABLE).is_none());
        Ok(Binding { name, binding, reads, writes, aliased: self.is_aliased(variable), kind })
    }

    fn uniform_block(&self, variable: u32, block: u32) -> Result<Binding, String> {
        let name = self.name(block).to_owned();
        if !self.decorations.contains_key(&(block, BLOCK)) {
            return Err(format!("'{name}' is not a uniform block"));
        }
        if self.binding(variable, &name)? != UNIFORM_BLOCK {
            return Err(format!("uniform block '{name}': write set = 0, binding = {UNIFORM_BLOCK}"));
        }
        let members = self.members(block, "member of a uniform block")?;
        Ok(Binding {
            name: with_underscores(&name),
            binding: UNIFORM_BLOCK,
            reads: true,
            writes: false,
            aliased: false,
            kind: BindingKind::Uniform(Block { name, members }),
        })
    }

    /// Returns the members of a block, for a host struct without padding. `what` names a member in errors.
    fn members(&self, block: u32, what: &str) -> Result<Vec<Field>, String> {
        let Some(Type::Struct(members)) = self.types.get(&block) else {
            return Err(format!("'{}' is not a block", self.name(block)));
        };
        let mut end = 0;
        let mut fields = Vec::new();
        for (index, &ty) in members.iter().enumerate() {
            let index = index as u32;
            let name = self.member_name(block, index)?;
            let offset = *self.member_decorations.get(&(block, index, OFFSET)).unwrap_or(&0);
            let matrix_stride = self.member_decorations.get(&(block, index, MATRIX_STRIDE)).copied();
            let (rust_type, bytes) =
                self.host_type(ty, matrix_stride).map_err(|e| format!("{what} '{name}': {e}"))?;
            if offset != end {
                return Err(format!(
                    "{what} '{name}' lies at {offset}, {} bytes after the one before it: declare the block scalar",
                    offset - end
                ));
            }
            end = offset + bytes;
            fields.push(Field { name, offset, rust_type, bytes });
        }
        Ok(fields)
    }

    fn host_type(&self, ty: u32, matrix_stride: Option<u32>) -> Result<(String, u32), String> {
        let wrap = |element: u32, count: u32, stride: Option<u32>| {
            let (inner, bytes) = self.host_type(element, matrix_stride)?;
            match stride {
                Some(stride) if stride != bytes => {
                    Err(format!("elements of {bytes} bytes lie {stride} apart: declare the block scalar"))
                }
                _ => Ok((format!("[{inner}; {count}]"), bytes * count)),
            }
        };
        match self.types.get(&ty) {
            Some(Type::Int { bits: 32, signed: false }) => Ok(("u32".into(), 4)),
            Some(Type::Int { bits: 32, signed: true }) => Ok(("i32".into(), 4)),
            Some(Type::Float { bits: 32 }) => Ok(("f32".into(), 4)),
            Some(&Type::Vector { of, count }) => wrap(of, count, None),
            Some(&Type::Matrix { column, columns }) => wrap(column, columns, matrix_stride),
            Some(&Type::Array { of, length }) => match self.constants.get(&length) {
                Some(&Constant::Value { bits, .. }) if !self.decorations.contains_key(&(length, SPEC_ID)) => {
                    wrap(of, bits, self.decorations.get(&(ty, ARRAY_STRIDE)).copied())
                }
                _ => Err("its length is not a plain constant".into()),
            },
            other => Err(format!("type {other:?} cannot be passed")),
        }
    }

    fn spec_constants(&self) -> Result<Vec<SpecConstant>, String> {
        let mut found: BTreeMap<u32, SpecConstant> = BTreeMap::new();
        for (&(target, decoration), &id) in &self.decorations {
            if decoration != SPEC_ID {
                continue;
            }
            let Some(&Constant::Value { ty, bits }) = self.constants.get(&target) else { continue };
            let rust_type = match self.types.get(&ty) {
                Some(Type::Bool) => "bool",
                Some(Type::Int { bits: 32, signed: false }) => "u32",
                Some(Type::Int { bits: 32, signed: true }) => "i32",
                Some(Type::Float { bits: 32 }) => "f32",
                other => {
                    return Err(format!("specialization constant {id}: type {other:?} is not supported"));
                }
            };
            let name = self.name(target).to_owned();
            // local_size_x_id creates an unnamed second constant with the same id: the named one counts.
            if !name.is_empty() || !found.contains_key(&id) {
                found.insert(id, SpecConstant { id, name, rust_type, default_bits: bits });
            }
        }
        match found.values().find(|c| c.name.is_empty()) {
            Some(c) => {
                Err(format!("specialization constant {} has no name: declare it with constant_id", c.id))
            }
            None => Ok(found.into_values().collect()),
        }
    }

    fn workgroup_size(&self, spec: &[SpecConstant]) -> Result<[String; 3], String> {
        if let Some([x, y, z]) = self.workgroup_size_ids {
            return Ok([self.expression(x, spec)?, self.expression(y, spec)?, self.expression(z, spec)?]);
        }
        let size = self.workgroup_size.ok_or("no workgroup size: write layout(local_size_x_id = 0) in;")?;
        Ok(size.map(|n| n.to_string()))
    }

    /// Returns the value of a constant, as a u32 expression over `spec`.
    fn expression(&self, id: u32, spec: &[SpecConstant]) -> Result<String, String> {
        if let Some(spec_id) = self.decorations.get(&(id, SPEC_ID))
            && let Some(constant) = spec.iter().find(|c| c.id == *spec_id)
        {
            let field = format!("spec.{}", constant.name.to_lowercase());
            return Ok(if constant.rust_type == "u32" { field } else { format!("({field} as u32)") });
        }
        match self.constants.get(&id) {
            Some(Constant::Value { bits, .. }) => Ok(bits.to_string()),
            Some(Constant::Operation { opcode: 81, operands }) => match self.constants.get(&operands[0]) {
                Some(Constant::Composite(elements)) => self.expression(elements[operands[1] as usize], spec),
                _ => Err("an array length takes an element of something unknown".into()),
            },
            Some(Constant::Operation { opcode, operands }) => {
                let values: Result<Vec<_>, _> = operands.iter().map(|&x| self.expression(x, spec)).collect();
                operation(*opcode, &values?)
            }
            _ => Err("an array length is not a constant".into()),
        }
    }

    fn shared_layout(&self, ty: u32, spec: &[SpecConstant]) -> Result<Layout, String> {
        let times = |count: &str, of: u32| {
            let Layout { bytes, alignment } = self.shared_layout(of, spec)?;
            Ok(Layout { bytes: format!("({count}) * ({bytes})"), alignment })
        };
        let plain = |bytes: u32| Layout { bytes: bytes.to_string(), alignment: bytes };
        match self.types.get(&ty) {
            Some(Type::Bool) => Ok(plain(4)),
            Some(Type::Int { bits, .. } | Type::Float { bits }) => Ok(plain(bits / 8)),
            Some(Type::Vector { of, count }) => {
                let components = count.next_power_of_two();
                let Layout { bytes, alignment } = times(&components.to_string(), *of)?;
                Ok(Layout { bytes, alignment: components * alignment })
            }
            Some(Type::Matrix { column, columns }) => times(&columns.to_string(), *column),
            Some(Type::Array { of, length }) => times(&self.expression(*length, spec)?, *of),
            Some(Type::Struct(members)) => {
                let members: Result<_, String> =
                    members.iter().map(|&m| self.shared_layout(m, spec)).collect();
                Ok(total(members?))
            }
            other => Err(format!("shared memory of type {other:?} is not supported")),
        }
    }
}

// Upper bound of the shared memory that a shader takes.
//
// Vulkan leaves the layout to the driver, and counts its padding against maxComputeSharedMemorySize
// (VUID-RuntimeSpirv-Workgroup-06530). Some drivers pad a `vec3` to four components, like GLSL's std430. So this follows
// std430, and pads each variable and struct member to the widest alignment.

/// Bytes, a multiple of the alignment, as an expression over `spec`.
struct Layout {
    bytes: String,
    alignment: u32,
}

/// Returns the layout of variables, or of a struct's members, in any order.
fn total(parts: Vec<Layout>) -> Layout {
    let alignment = parts.iter().map(|part| part.alignment).max().unwrap_or(1);
    let padded = |part: &Layout| match part.alignment == alignment {
        true => part.bytes.clone(),
        false => format!("({} + {}) / {alignment} * {alignment}", part.bytes, alignment - 1),
    };
    let bytes: Vec<_> = parts.iter().map(padded).collect();
    Layout { bytes: if bytes.is_empty() { "0".into() } else { bytes.join(" + ") }, alignment }
}

/// Returns the Rust expression of a SPIR-V opcode over its operands' expressions.
fn operation(opcode: u32, v: &[String]) -> Result<String, String> {
    let binary = |op: &str| Ok(format!("(({}) {op} ({}))", v[0], v[1]));
    let compare = |op: &str| Ok(format!("((({}) {op} ({})) as u32)", v[0], v[1]));
    match opcode {
        124 => Ok(v[0].clone()),
        128 => binary("+"),
        130 => binary("-"),
        132 => binary("*"),
        134 | 135 => binary("/"),
        137..=139 => binary("%"),
        194 | 195 => binary(">>"),
        196 => binary("<<"),
        166 | 197 => binary("|"),
        198 => binary("^"),
        167 | 199 => binary("&"),
        169 => Ok(format!("(if ({}) != 0 {{ {} }} else {{ {} }})", v[0], v[1], v[2])),
        164 | 170 => compare("=="),
        165 | 171 => compare("!="),
        172 | 173 => compare(">"),
        174 | 175 => compare(">="),
        176 | 177 => compare("<"),
        178 | 179 => compare("<="),
        168 => Ok(format!("(1 - ({}))", v[0])),
        other => Err(format!("operation {other} in an array length is not supported")),
    }
}

fn text(words: &[u32]) -> String {
    let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).take_while(|&b| b != 0).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}
