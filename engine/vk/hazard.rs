//! Finds missing barriers from the declared reads and writes of a recording's commands.
//!
//! It keeps every range that was read or written since the last barrier, and the command. A hazard is a command that
//! touches a range that an earlier one wrote, or writes a range that an earlier one read. One command may read and write
//! its own buffers, by one binding or by two that are ALIASED.
//!
//! It does not use Vulkan: a block of memory is a number, so tests need no device.

use std::fmt;
use std::ops::Range;

/// One declared access of a command.
#[derive(Clone, Debug, PartialEq)]
pub struct Use {
    /// The block of memory.
    pub block: u64,
    /// The range of bytes in it.
    pub bytes: Range<u64>,
    /// The buffer's name.
    pub buffer: &'static str,
    /// Role in the command: the binding's name, "destination", …
    pub role: &'static str,
    /// Read, written, or both.
    pub access: Access,
    /// True if the command's other accesses may touch the same bytes.
    pub aliased: bool,
}

/// Two commands that touch the same bytes without a barrier between them; at least one writes.
#[derive(Clone, Debug, PartialEq)]
pub struct Hazard {
    /// The earlier command and its access.
    pub first: (&'static str, Use),
    /// The later command and its access.
    pub second: (&'static str, Use),
}

impl Hazard {
    /// "read after write", "write after read" or "write after write".
    pub fn kind(&self) -> &'static str {
        match (self.first.1.access, self.second.1.access) {
            (Access::Read, _) => "write after read",
            (_, Access::Read) => "read after write",
            (Access::Write, Access::Write) => "write after write",
            _ => "read and write after write",
        }
    }
}

impl fmt::Display for Hazard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verb = |access| match access {
            Access::Read => "reads",
            Access::Write => "writes",
            Access::ReadWrite => "reads and writes",
        };
        let ((first, a), (second, b)) = (&self.first, &self.second);
        let (start, end) = (a.bytes.start.max(b.bytes.start), a.bytes.end.min(b.bytes.end));
        write!(
            f,
            "missing barrier ({}): '{second}' {} buffer '{}' as '{}' after '{first}' {} buffer '{}' as '{}' \
             ({} bytes in common); call barrier() between them",
            self.kind(),
            verb(b.access),
            b.buffer,
            b.role,
            verb(a.access),
            a.buffer,
            a.role,
            end - start
        )
    }
}

/// Accesses since the last barrier.
#[derive(Debug, Default)]
pub struct HazardTracker {
    since_barrier: Vec<(&'static str, Use)>,
}

impl HazardTracker {
    /// No accesses yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a command. Returns its hazards with earlier commands, the first for each of its accesses.
    pub fn command(&mut self, name: &'static str, uses: &[Use]) -> Vec<Hazard> {
        let mut hazards = Vec::new();
        for later in uses {
            let earlier = self.since_barrier.iter().find(|(_, earlier)| conflict(earlier, later));
            if let Some((first, earlier)) = earlier {
                hazards.push(Hazard { first: (first, earlier.clone()), second: (name, later.clone()) });
            }
        }
        self.since_barrier.extend(uses.iter().map(|u| (name, u.clone())));
        hazards
    }

    /// Orders all earlier commands before all later ones.
    pub fn barrier(&mut self) {
        self.since_barrier.clear();
    }
}

/// Describes the mistake of a command that reads bytes by one of its bindings and writes them by another. Compilers assume
/// that two buffers of a shader are different memory unless both are decorated `Aliased` (SPIR-V, 2.18.2). Two bindings
/// that both write are allowed: they write different places, or this variant of the kernel does not touch one of them.
pub fn undeclared_alias(command: &str, uses: &[Use]) -> Option<String> {
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

// How a command accesses a buffer.

/// How a shader accesses a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Access {
    /// `readonly`.
    Read,
    /// `writeonly`.
    Write,
    /// Neither.
    ReadWrite,
}

impl Access {
    /// True if it writes.
    pub fn writes(self) -> bool {
        self != Self::Read
    }
}
