//! The program's kernels as data.

use ashsplat::kernels::visit_all;
use ashsplat::vk::{ConstantInfo, Form, KernelInterface, KernelVisitor};

/// A kernel and its shader.
pub struct Kernel {
    pub name: &'static str,
    pub constants: &'static [ConstantInfo],
    pub spirv: &'static [u32],
    /// The form that reads texels, if there is one.
    pub texels: Option<Form>,
}

impl Kernel {
    /// Returns the SPIR-V of the form for a device.
    #[cfg(feature = "hot-reload")]
    pub fn spirv_for(&self, limits: &ashsplat::vk::Limits) -> &'static [u32] {
        self.texels.filter(|_| limits.prefers_texels()).map_or(self.spirv, |form| form.spirv)
    }
}

/// Returns all kernels.
pub fn all() -> Vec<Kernel> {
    struct All(Vec<Kernel>);
    impl KernelVisitor for All {
        fn visit<K: KernelInterface>(&mut self) {
            let (constants, texels) = (K::CONSTANTS, K::TEXELS);
            self.0.push(Kernel { name: K::NAME, constants, spirv: K::SPIRV, texels });
        }
    }
    let mut all = All(Vec::new());
    visit_all(&mut all);
    all.0
}
