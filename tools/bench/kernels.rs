//! The program's kernels as data.

use ashsplat::kernels::visit_all;
use ashsplat::vk::{ConstantInfo, Form, KernelInterface, KernelVisitor};

/// A kernel and its shader.
pub struct Kernel {
    pub name: &'static str,
    pub constants: &'static [ConstantInfo],
    pub spirv: &'static [u32],
    /// Its other forms.
    pub forms: &'static [Form],
}

impl Kernel {
    /// Returns the SPIR-V of the form for a device and cameras without a lens.
    #[cfg(feature = "hot-reload")]
    pub fn spirv_for(&self, limits: &ashsplat::vk::Limits) -> &'static [u32] {
        let texels = self.forms.iter().find(|form| form.texels && !form.lenses);
        texels.filter(|_| limits.prefers_texels()).map_or(self.spirv, |form| form.spirv)
    }
}

/// Returns all kernels.
pub fn all() -> Vec<Kernel> {
    struct All(Vec<Kernel>);
    impl KernelVisitor for All {
        fn visit<K: KernelInterface>(&mut self) {
            let (constants, forms) = (K::CONSTANTS, K::FORMS);
            self.0.push(Kernel { name: K::NAME, constants, spirv: K::SPIRV, forms });
        }
    }
    let mut all = All(Vec::new());
    visit_all(&mut all);
    all.0
}
