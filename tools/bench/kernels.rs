//! The program's kernels as data.

use ashsplat::kernels::visit_all;
use ashsplat::vk::{ConstantInfo, Form, KernelInterface, KernelVisitor};

pub struct Kernel {
    pub name: &'static str,
    pub constants: &'static [ConstantInfo],
    /// Its forms, the plain one first.
    #[cfg_attr(not(feature = "hot-reload"), allow(dead_code))]
    pub forms: &'static [Form],
}

impl Kernel {
    /// Returns the SPIR-V of the form for a device and cameras without a lens.
    #[cfg(feature = "hot-reload")]
    pub fn spirv_for(&self, limits: &ashsplat::vk::Limits) -> &'static [u32] {
        let fits = |form: &&Form| !form.lenses && form.texels <= limits.prefers_texels();
        self.forms.iter().rfind(fits).map_or(&[], |form| form.spirv)
    }
}

pub fn all() -> Vec<Kernel> {
    struct All(Vec<Kernel>);
    impl KernelVisitor for All {
        fn visit<K: KernelInterface>(&mut self) {
            self.0.push(Kernel { name: K::NAME, constants: K::CONSTANTS, forms: K::FORMS });
        }
    }
    let mut all = All(Vec::new());
    visit_all(&mut all);
    all.0
}
