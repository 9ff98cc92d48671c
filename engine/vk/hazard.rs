//! Finds missing barriers from the declared reads and writes of a recording's commands.
//!
//! It keeps every range that was read or written since the last barrier, and the command. A hazard is a command that
//! touches a range that an earlier one wrote, or writes a range that an earlier one read. One command may read and write
//! its own buffers, by one binding or by two that are ALIASED.

use super::format::Access;
use super::image::Image;
use super::memory::Buffer;
use std::ops::Range;

/// A declared access of a command.
struct Use {
    /// Id of the block of memory, or of the image.
    block: u64,
    bytes: Range<u64>,
    buffer: &'static str,
    /// Role in the command: the binding's name, "destination", …
    role: &'static str,
    access: Access,
    /// True if the command's other accesses may touch the same bytes.
    aliased: bool,
}

/// Accesses of the current command, and of earlier ones since the last barrier.
#[derive(Default)]
pub(super) struct Hazards {
    uses: Vec<Use>,
    since_barrier: Vec<(&'static str, Use)>,
    /// None: a hazard panics.
    #[cfg(feature = "testing")]
    pub(super) collected: Option<Vec<String>>,
}

impl Hazards {
    /// Collects mistakes, without panics.
    #[cfg(feature = "testing")]
    pub(super) fn collecting() -> Self {
        Self { collected: Some(Vec::new()), ..Self::default() }
    }

    pub(super) fn add(&mut self, buffer: &Buffer, role: &'static str, access: Access, aliased: bool) {
        let bytes = buffer.offset()..buffer.offset() + buffer.bytes();
        let (block, buffer) = (buffer.block().id, buffer.name());
        self.uses.push(Use { block, bytes, buffer, role, access, aliased });
    }

    pub(super) fn add_image(&mut self, image: &Image, role: &'static str, access: Access) {
        let (block, buffer) = (image.id(), image.name());
        self.uses.push(Use { block, bytes: 0..1, buffer, role, access, aliased: false });
    }

    /// Ends the current command. Panics with its first mistake, unless hazards are collected.
    pub(super) fn commit(&mut self, command: &'static str) {
        let missing = self.uses.iter().filter_map(|later| {
            let earlier = self.since_barrier.iter().find(|(_, earlier)| conflict(earlier, later));
            earlier.map(|(first, earlier)| missing_barrier((first, earlier), (command, later)))
        });
        let found: Vec<String> = undeclared_alias(command, &self.uses).into_iter().chain(missing).collect();
        self.since_barrier.extend(self.uses.drain(..).map(|own| (command, own)));
        #[cfg(feature = "testing")]
        if let Some(collected) = &mut self.collected {
            return collected.extend(found);
        }
        if let Some(mistake) = found.first() {
            panic!("{mistake}");
        }
    }

    /// Orders all earlier commands before all later ones.
    pub(super) fn barrier(&mut self) {
        self.since_barrier.clear();
    }
}

/// Describes two commands that touch the same bytes without a barrier between them; at least one writes.
fn missing_barrier((first, a): (&str, &Use), (second, b): (&str, &Use)) -> String {
    let kind = match (a.access, b.access) {
        (Access::Read, _) => "write after read",
        (_, Access::Read) => "read after write",
        (Access::Write, Access::Write) => "write after write",
        _ => "read and write after write",
    };
    let verb = |access| match access {
        Access::Read => "reads",
        Access::Write => "writes",
        Access::ReadWrite => "reads and writes",
    };
    let (start, end) = (a.bytes.start.max(b.bytes.start), a.bytes.end.min(b.bytes.end));
    format!(
        "missing barrier ({kind}): '{second}' {} buffer '{}' as '{}' after '{first}' {} buffer '{}' as '{}' \
         ({} bytes in common); call barrier() between them",
        verb(b.access),
        b.buffer,
        b.role,
        verb(a.access),
        a.buffer,
        a.role,
        end - start
    )
}

/// Describes the mistake of a command that reads bytes by one of its bindings and writes them by another. Compilers assume
/// that two buffers of a shader are different memory unless both are decorated `Aliased` (SPIR-V, 2.18.2). Two bindings
/// that both write are allowed: they write different places, or this variant of the kernel does not touch one of them.
fn undeclared_alias(command: &str, uses: &[Use]) -> Option<String> {
    let mut pairs = uses.iter().enumerate().flat_map(|(k, a)| uses[k + 1..].iter().map(move |b| (a, b)));
    let is_alias =
        |a: &Use, b: &Use| (a.access == Access::Read) != (b.access == Access::Read) && conflict(a, b);
    let (a, b) = pairs.find(|(a, b)| is_alias(a, b) && !(a.aliased && b.aliased))?;
    Some(format!(
        "'{command}' has buffer '{}' as '{}' and buffer '{}' as '{}', which have bytes in common, reads one and writes the other: \
         declare both ALIASED in the shader, or give it other memory",
        a.buffer, a.role, b.buffer, b.role
    ))
}

fn conflict(a: &Use, b: &Use) -> bool {
    a.block == b.block
        && a.bytes.start < b.bytes.end
        && b.bytes.start < a.bytes.end
        && (a.access.writes() || b.access.writes())
}
