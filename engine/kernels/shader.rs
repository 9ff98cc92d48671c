//! Interface that a shader declares.

/// Interface that a shader declares.
#[derive(Debug, Default, PartialEq)]
pub struct Shader {
    /// Buffers by binding.
    pub bindings: Vec<Binding>,
    /// Images by binding.
    pub images: Vec<ImageBinding>,
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
    /// one shader, which read the same buffers in different ways.
    pub fn difference(&self, other: &Self, forms: bool) -> Option<&'static str> {
        let same = |(a, b): (&Binding, &Binding)| {
            let access = |binding: &Binding| (binding.reads, binding.writes, binding.aliased);
            (&a.name, a.binding, access(a)) == (&b.name, b.binding, access(b))
                && (a.kind == b.kind || forms && !a.is_uniform() && !b.is_uniform())
        };
        let buffers = self.bindings.len() == other.bindings.len()
            && self.bindings.iter().zip(&other.bindings).all(same);
        let parts = [
            (buffers, "buffers"),
            (self.images == other.images, "images"),
            (self.push == other.push, "push constants"),
            (self.spec == other.spec, "specialization constants"),
            (self.workgroup_size == other.workgroup_size, "workgroup"),
            (self.shared_bytes == other.shared_bytes, "shared memory"),
        ];
        parts.into_iter().find(|(same, _)| !same).map(|(_, what)| what)
    }
}

/// A buffer, or the common part of an image.
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

impl Binding {
    fn is_uniform(&self) -> bool {
        matches!(self.kind, BindingKind::Uniform(_))
    }
}

/// How a buffer is bound.
#[derive(Debug, PartialEq)]
pub enum BindingKind {
    /// Storage buffer.
    Storage,
    /// Texel buffer, of this variant of `TexelFormat`.
    Texels(&'static str),
    /// Uniform block.
    Uniform(Block),
}

/// A uniform block.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Its name in the shader.
    pub name: String,
    /// Its members, in order.
    pub members: Vec<Field>,
}

/// A storage image or a sampled image without sampler.
#[derive(Debug, PartialEq)]
pub struct ImageBinding {
    /// Its name, number and use.
    pub binding: Binding,
    /// True for a storage image.
    pub storage: bool,
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
