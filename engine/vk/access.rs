//! How a command accesses a buffer.

/// How a shader accesses a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
