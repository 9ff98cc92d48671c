//! Changes to compiled shaders that depend on the device. They concern how subgroups behave, and nothing that is computed.

use std::borrow::Cow;

/// Words of a module's header.
const HEADER: usize = 5;
const VERSION_1_5: u32 = 0x0001_0500;
const OP_EXTENSION: u32 = 10;
const OP_ENTRY_POINT: u32 = 15;
const OP_EXECUTION_MODE: u32 = 16;
const OP_CAPABILITY: u32 = 17;
const MAXIMALLY_RECONVERGES: u32 = 6023;
const RECONVERGENCE: &[u8] = b"SPV_KHR_maximal_reconvergence";

/// What a device asks of modules that use subgroups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SubgroupRules {
    /// The subgroup size cannot be required, so that it must be the one the device reports. From SPIR-V 1.6 on a driver may
    /// choose another one for each pipeline; before, only where a flag allows it (VkPipelineShaderStageCreateFlagBits).
    pub(super) fixed_size: bool,
    /// The device has VK_KHR_shader_maximal_reconvergence: after a branch or a loop the invocations that took the same way
    /// before are together again, as the shaders take for granted.
    pub(super) reconverges: bool,
}

impl SubgroupRules {
    /// The module as the device needs it.
    pub(super) fn apply(self, module: &[u32]) -> Cow<'_, [u32]> {
        let mut module = Cow::Borrowed(module);
        if self.fixed_size
            && let Some(version) = module.to_mut().get_mut(1)
        {
            // The kernels have nothing of 1.6; LocalSizeId is older.
            *version = VERSION_1_5.min(*version);
        }
        if self.reconverges
            && let Some(changed) = with_mode(&module, RECONVERGENCE, MAXIMALLY_RECONVERGES)
        {
            module = Cow::Owned(changed);
        }
        module
    }
}

/// The module with an execution mode of an extension; None where the words are no module.
fn with_mode(module: &[u32], extension: &[u8], mode: u32) -> Option<Vec<u32>> {
    let mut out = module.get(..HEADER)?.to_vec();
    let (mut at, mut has_extension, mut entry) = (HEADER, false, None);
    while at < module.len() {
        let word = module[at];
        let (opcode, count) = (word & 0xFFFF, (word >> 16) as usize);
        let instruction = module.get(at..at + count.max(1))?;
        // Capabilities come first, extensions follow them; execution modes follow the entry points.
        if !has_extension && opcode != OP_CAPABILITY {
            out.extend(extension_words(extension));
            has_extension = true;
        }
        if opcode != OP_ENTRY_POINT
            && let Some(entry) = entry.take()
        {
            out.extend([(3 << 16) | OP_EXECUTION_MODE, entry, mode]);
        }
        if opcode == OP_ENTRY_POINT {
            entry = Some(*instruction.get(2)?);
        }
        out.extend(instruction);
        at += count.max(1);
    }
    Some(out)
}

/// OpExtension: the name's bytes, ended by a zero, in whole words.
fn extension_words(extension: &[u8]) -> Vec<u32> {
    let mut name = extension.to_vec();
    name.resize((name.len() + 1).next_multiple_of(4), 0);
    let words =
        name.chunks_exact(4).map(|bytes| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    let count = name.len() as u32 / 4 + 1;
    std::iter::once((count << 16) | OP_EXTENSION).chain(words).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::path::Path;
    use std::process::{Command, Stdio};

    /// Instructions of an opcode with these operands.
    fn instruction(opcode: u32, operands: &[u32]) -> Vec<u32> {
        [&[(operands.len() as u32 + 1) << 16 | opcode], operands].concat()
    }

    #[test]
    fn modules_are_changed_where_the_device_asks_for_it() {
        let header = |version| vec![0x0723_0203, version, 0, 8, 0];
        // Two capabilities, a memory model, an entry point with its name and an interface, a mode with ids, a type.
        let capabilities = [instruction(OP_CAPABILITY, &[1]), instruction(OP_CAPABILITY, &[61])].concat();
        let memory_model = instruction(14, &[0, 1]);
        let entry = instruction(OP_ENTRY_POINT, &[5, 4, 0x6E69_616D, 0, 7]);
        let rest = [instruction(331, &[4, 38, 8, 9, 9]), instruction(19, &[2])].concat();
        let module =
            [header(0x0001_0600), capabilities.clone(), memory_model.clone(), entry.clone(), rest.clone()];
        let module = module.concat();
        assert!(matches!(SubgroupRules::default().apply(&module), Cow::Borrowed(same) if same == module));
        let fixed = SubgroupRules { fixed_size: true, reconverges: false }.apply(&module);
        assert_eq!(fixed[1], VERSION_1_5);
        assert_eq!((fixed[0], &fixed[2..]), (module[0], &module[2..]));
        let mode = instruction(OP_EXECUTION_MODE, &[4, MAXIMALLY_RECONVERGES]);
        let extension = extension_words(RECONVERGENCE);
        assert_eq!(extension.len(), 9);
        let parts = [header(VERSION_1_5), capabilities, extension, memory_model, entry, mode, rest];
        let both = SubgroupRules { fixed_size: true, reconverges: true }.apply(&module);
        assert_eq!(both, parts.concat());
        // What is no module stays as it is.
        let reconverging = SubgroupRules { fixed_size: false, reconverges: true };
        assert_eq!(reconverging.apply(&module[..3]), &module[..3]);
        let cut = &module[..module.len() - 1];
        assert_eq!(reconverging.apply(cut), cut);
    }

    /// What spirv-val says against a module; None: nothing.
    fn refused(module: &[u32]) -> Option<String> {
        let mut validator = Command::new("spirv-val")
            .args(["--target-env", "vulkan1.3", "--scalar-block-layout", "-"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("spirv-val starts");
        let bytes: Vec<u8> = module.iter().flat_map(|word| word.to_le_bytes()).collect();
        // It may refuse before it has read all.
        let _ = validator.stdin.take().expect("a pipe").write_all(&bytes);
        let output = validator.wait_with_output().expect("spirv-val ends");
        let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        (!output.status.success()).then(|| said.trim().to_owned())
    }

    /// Every module that build.rs made, in each of its forms.
    fn modules() -> Vec<(String, Vec<u32>)> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(Path::new(env!("OUT_DIR"))).expect("what build.rs made") {
            let path = entry.expect("a file").path();
            if path.extension().is_some_and(|extension| extension == "spv") {
                let bytes = std::fs::read(&path).expect("a module");
                let words = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
                found.push((path.display().to_string(), words.collect()));
            }
        }
        found
    }

    /// The changed modules are valid. A validator from before 2024 does not know maximal reconvergence. It knows its forerunner,
    /// subgroup uniform control flow, whose words stand in the same places.
    #[test]
    fn changed_modules_are_valid() {
        if Command::new("spirv-val").arg("--version").output().is_err() {
            eprintln!("skipped: no spirv-val");
            return;
        }
        const FORERUNNER: (&[u8], u32) = (b"SPV_KHR_subgroup_uniform_control_flow", 4421);
        let modules = modules();
        assert!(modules.len() > 80, "{} modules", modules.len());
        let changed = |module: &[u32]| {
            SubgroupRules { fixed_size: false, reconverges: true }.apply(module).into_owned()
        };
        let unknown =
            refused(&changed(&modules[0].1)).filter(|said| said.contains("6023") || said.contains("maximal"));
        if let Some(said) = &unknown {
            eprintln!("skipped: this spirv-val does not know maximal reconvergence: {said}");
        }
        for (name, module) in &modules {
            let fixed = SubgroupRules { fixed_size: true, reconverges: false }.apply(module);
            let forerunner = with_mode(&fixed, FORERUNNER.0, FORERUNNER.1).expect("a module");
            let known = unknown.is_none().then(|| changed(module));
            for form in [Some(forerunner), known].into_iter().flatten() {
                assert_eq!(refused(&form), None, "{name}");
            }
        }
        // Words in a wrong place are seen: a mode before the entry point that it is of.
        let (name, module) = &modules[0];
        let mut wrong = with_mode(module, FORERUNNER.0, FORERUNNER.1).expect("a module");
        let at = wrong.windows(3).position(|w| w[0] == (3 << 16 | OP_EXECUTION_MODE) && w[2] == FORERUNNER.1);
        let at = at.expect("the mode");
        let mode: Vec<u32> = wrong.drain(at..at + 3).collect();
        wrong.splice(HEADER..HEADER, mode);
        assert!(refused(&wrong).is_some(), "{name}");
    }
}
