//! Adapts compiled shaders to the device. The changes affect how subgroups behave, not what shaders compute.

use super::device::OptionalFeatures;
use std::borrow::Cow;
use std::collections::BTreeSet;

const HEADER: usize = 5;
const VERSION_1_5: u32 = 0x0001_0500;
const OP_EXTENSION: u32 = 10;
const OP_ENTRY_POINT: u32 = 15;
const OP_EXECUTION_MODE: u32 = 16;
const OP_CAPABILITY: u32 = 17;
const OP_BROADCAST: u32 = 337;
const OP_SHUFFLE: u32 = 345;
const CAPABILITY_SHUFFLE: u32 = 65;

/// Guarantee that the invocations of a subgroup reconverge after a branch or a loop, as the shaders assume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reconvergence {
    /// Invocations that took the same path before reconverge: VK_KHR_shader_maximal_reconvergence.
    Maximal,
    /// All invocations reconverge if all were converged before: VK_KHR_shader_subgroup_uniform_control_flow.
    Uniform,
}

impl Reconvergence {
    pub(super) fn of(features: &OptionalFeatures) -> Option<Self> {
        match (features.reconverges, features.uniform_control_flow) {
            (true, _) => Some(Self::Maximal),
            (false, true) => Some(Self::Uniform),
            (false, false) => None,
        }
    }

    /// Returns the SPIR-V extension and its execution mode.
    const fn words(self) -> (&'static [u8], u32) {
        match self {
            Self::Maximal => (b"SPV_KHR_maximal_reconvergence", 6023),
            Self::Uniform => (b"SPV_KHR_subgroup_uniform_control_flow", 4421),
        }
    }
}

/// Requirements of a device on modules that use subgroups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SubgroupRules {
    /// The subgroup size cannot be required, so it must be the reported one. From SPIR-V 1.6 on a driver may choose another
    /// size for each pipeline; before, only if a flag allows it (VkPipelineShaderStageCreateFlagBits).
    pub(super) fixed_size: bool,
    pub(super) reconvergence: Option<Reconvergence>,
    /// True if subgroupBroadcastDynamicId is on. Without it, a module may not even contain a broadcast from a lane known
    /// only at run time (VUID-RuntimeSpirv-subgroupBroadcastDynamicId-06276).
    pub(super) broadcasts: bool,
}

impl SubgroupRules {
    pub(super) fn apply(self, module: &[u32]) -> Cow<'_, [u32]> {
        let mut module = Cow::Borrowed(module);
        if self.fixed_size
            && let Some(version) = module.to_mut().get_mut(1)
        {
            // The kernels use nothing of 1.6; LocalSizeId is older.
            *version = VERSION_1_5.min(*version);
        }
        if let Some((extension, mode)) = self.reconvergence.map(Reconvergence::words)
            && let Some(changed) = with_mode(&module, extension, mode)
        {
            module = Cow::Owned(changed);
        }
        if !self.broadcasts {
            let places = dynamic_broadcasts(&module);
            for at in places {
                // Both instructions have the same operands.
                let head = &mut module.to_mut()[at];
                *head = *head & 0xFFFF_0000 | OP_SHUFFLE;
            }
        }
        module
    }
}

/// Returns the position and the words of each instruction; None if the words are not a module.
fn instructions(module: &[u32]) -> Option<Vec<(usize, &[u32])>> {
    let (mut all, mut at) = (Vec::new(), HEADER);
    while at < module.len() {
        let count = ((module[at] >> 16) as usize).max(1);
        all.push((at, module.get(at..at + count)?));
        at += count;
    }
    Some(all)
}

fn opcode(instruction: &[u32]) -> u32 {
    instruction[0] & 0xFFFF
}

/// Returns the module with an execution mode of an extension; None if the words are not a module.
fn with_mode(module: &[u32], extension: &[u8], mode: u32) -> Option<Vec<u32>> {
    let mut out = module.get(..HEADER)?.to_vec();
    let (mut has_extension, mut entry) = (false, None);
    for (_, instruction) in instructions(module)? {
        // Capabilities come first, extensions follow them. Execution modes follow the entry points.
        if !has_extension && opcode(instruction) != OP_CAPABILITY {
            out.extend(extension_words(extension));
            has_extension = true;
        }
        if opcode(instruction) == OP_ENTRY_POINT {
            entry = Some(*instruction.get(2)?);
        } else if let Some(entry) = entry.take() {
            out.extend([(3 << 16) | OP_EXECUTION_MODE, entry, mode]);
        }
        out.extend(instruction);
    }
    Some(out)
}

/// Returns the positions of broadcasts from a lane that is no constant; empty if the module may not shuffle.
fn dynamic_broadcasts(module: &[u32]) -> Vec<usize> {
    let (mut constants, mut shuffles, mut found) = (BTreeSet::<u32>::new(), false, Vec::new());
    for (at, instruction) in instructions(module).unwrap_or_default() {
        match opcode(instruction) {
            OP_CAPABILITY => shuffles |= instruction.get(1) == Some(&CAPABILITY_SHUFFLE),
            // OpConstantTrue to OpSpecConstantOp.
            41..=52 => constants.extend(instruction.get(2)),
            OP_BROADCAST if instruction.get(5).is_some_and(|lane| !constants.contains(lane)) => {
                found.push(at)
            }
            _ => {}
        }
    }
    if shuffles { found } else { Vec::new() }
}

/// Encodes OpExtension: the name's bytes with a terminating zero, in whole words.
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
        let rules = |fixed_size, reconvergence| SubgroupRules { fixed_size, reconvergence, broadcasts: true };
        let fixed = rules(true, None).apply(&module);
        assert_eq!(fixed[1], VERSION_1_5);
        assert_eq!((fixed[0], &fixed[2..]), (module[0], &module[2..]));
        for (kind, length) in [(Reconvergence::Maximal, 9), (Reconvergence::Uniform, 11)] {
            let (extension, mode) = kind.words();
            let (extension, mode) = (extension_words(extension), instruction(OP_EXECUTION_MODE, &[4, mode]));
            assert_eq!(extension.len(), length);
            let parts =
                [&header(VERSION_1_5), &capabilities, &extension, &memory_model, &entry, &mode, &rest];
            let both = rules(true, Some(kind)).apply(&module);
            assert_eq!(both, parts.map(Vec::as_slice).concat());
        }
        // Words that are not a module stay unchanged.
        let reconverging = rules(false, Some(Reconvergence::Maximal));
        assert_eq!(reconverging.apply(&module[..3]), &module[..3]);
        let cut = &module[..module.len() - 1];
        assert_eq!(reconverging.apply(cut), cut);
    }

    /// Returns spirv-val's message about an invalid module; None if it is valid.
    fn refused(module: &[u32]) -> Option<String> {
        let mut validator = Command::new("spirv-val")
            .args(["--target-env", "vulkan1.3", "--scalar-block-layout", "-"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("spirv-val starts");
        // It may refuse the module before it has read all of it.
        let _ = validator.stdin.take().expect("a pipe").write_all(bytemuck::cast_slice(module));
        let output = validator.wait_with_output().expect("spirv-val ends");
        let messages = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        (!output.status.success()).then(|| messages.trim().to_owned())
    }

    /// Returns every module that build.rs made, in each of its forms.
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

    /// Without the feature, a broadcast from a lane unknown to the compiler becomes a shuffle, and nothing else changes.
    #[test]
    fn dynamic_broadcasts_are_shuffles_where_they_may_not_be() {
        let rules = SubgroupRules::default();
        let mut found = 0;
        for (name, module) in modules() {
            let changed = rules.apply(&module);
            let words = module.iter().zip(&*changed).filter(|(a, b)| a != b);
            for (old, new) in words {
                assert_eq!([*old, *new], [6 << 16 | OP_BROADCAST, 6 << 16 | OP_SHUFFLE], "{name}");
                found += 1;
            }
            assert!(module.len() == changed.len() && dynamic_broadcasts(&changed).is_empty(), "{name}");
            let on = SubgroupRules { broadcasts: true, ..rules };
            assert!(*on.apply(&module) == *module);
        }
        assert!(found > 3, "{found} broadcasts");
        // A constant lane, and a module that may not shuffle.
        let module = |capability, lane| {
            let parts = [
                vec![0x0723_0203, 0x0001_0600, 0, 9, 0],
                instruction(OP_CAPABILITY, &[capability]),
                instruction(43, &[1, 2, 5]),
                instruction(OP_BROADCAST, &[1, 8, 2, 7, lane]),
            ];
            parts.concat()
        };
        let is_changed = |module: Vec<u32>| *rules.apply(&module) != *module;
        assert!(is_changed(module(CAPABILITY_SHUFFLE, 3)));
        assert!(!is_changed(module(CAPABILITY_SHUFFLE, 2)) && !is_changed(module(64, 3)));
    }

    /// Changed modules are valid. Validators from before 2024 do not know maximal reconvergence. They know subgroup uniform
    /// control flow, whose words have the same positions.
    #[test]
    fn changed_modules_are_valid() {
        if Command::new("spirv-val").arg("--version").output().is_err() {
            eprintln!("skipped: no spirv-val");
            return;
        }
        let modules = modules();
        assert!(modules.len() > 80, "{} modules", modules.len());
        let rules =
            |fixed_size, kind| SubgroupRules { fixed_size, reconvergence: Some(kind), broadcasts: false };
        let changed = |module: &[u32]| rules(false, Reconvergence::Maximal).apply(module).into_owned();
        let unknown = refused(&changed(&modules[0].1))
            .filter(|messages| messages.contains("6023") || messages.contains("maximal"));
        if let Some(messages) = &unknown {
            eprintln!("skipped: this spirv-val does not know maximal reconvergence: {messages}");
        }
        for (name, module) in &modules {
            let uniform = rules(true, Reconvergence::Uniform).apply(module).into_owned();
            let known = unknown.is_none().then(|| changed(module));
            for form in [Some(uniform), known].into_iter().flatten() {
                assert_eq!(refused(&form), None, "{name}");
            }
        }
    }
}
