//! Upper bound of the shared memory that a shader takes.
//!
//! Vulkan leaves the layout to the driver, and counts its padding against maxComputeSharedMemorySize
//! (VUID-RuntimeSpirv-Workgroup-06530). Some drivers pad a `vec3` to four components, like GLSL's std430. So this follows
//! std430, and pads each variable and struct member to the widest alignment.

use super::{Module, SpecConstant, Type};

/// Bytes, a multiple of the alignment, as an expression over `spec`.
pub struct Layout {
    pub bytes: String,
    alignment: u32,
}

/// Returns the layout of variables, or of a struct's members, in any order.
pub fn total(parts: Vec<Layout>) -> Layout {
    let alignment = parts.iter().map(|part| part.alignment).max().unwrap_or(1);
    let padded = |part: &Layout| match part.alignment == alignment {
        true => part.bytes.clone(),
        false => format!("({} + {}) / {alignment} * {alignment}", part.bytes, alignment - 1),
    };
    let bytes: Vec<_> = parts.iter().map(padded).collect();
    Layout { bytes: if bytes.is_empty() { "0".into() } else { bytes.join(" + ") }, alignment }
}

impl Module {
    /// Returns the layout of a type.
    pub fn shared_layout(&self, ty: u32, spec: &[SpecConstant]) -> Result<Layout, String> {
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
