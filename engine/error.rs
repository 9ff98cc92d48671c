//! The crate's one error type.
//!
//! Every message is one line that names the file or object, the place in it, what is wrong, and what to do.

use std::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};

/// `Result` with [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// How a system gets a Vulkan loader and a driver.
const INSTALL_VULKAN: &str = if cfg!(windows) {
    "the graphics card's driver brings Vulkan: install its newest version from the maker of the card"
} else if cfg!(target_os = "macos") {
    "install MoltenVK: `brew install vulkan-loader molten-vk`"
} else {
    "install a driver: on Debian or Ubuntu `apt-get install libvulkan1 mesa-vulkan-drivers`, or run tools/setup"
};

/// Errors of the crate, each with a one-line message.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder cannot be used as it is.
    #[error("{}: {}{}", OneLine(path.display()), OneLine(problem), Remedy(remedy))]
    Input {
        /// The file or folder.
        path: PathBuf,
        /// Place in the file and what is wrong there ("vertex 12: property x is NaN").
        problem: String,
        /// What to do about it; may be empty.
        remedy: String,
    },
    /// Reading or writing failed in the operating system.
    #[error("{}: cannot {action}: {}", OneLine(path.display()), OneLine(source))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// "read", "write", "create", …
        action: &'static str,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// An argument of the API, or a setting, is invalid.
    #[error("{}: {}", OneLine(what), OneLine(problem))]
    Argument {
        /// Name of the argument.
        what: String,
        /// What is wrong with it and what would be right.
        problem: String,
    },
    /// There is no Vulkan loader on this machine.
    #[error("no Vulkan loader found ({}); {INSTALL_VULKAN}", OneLine(reason))]
    NoLoader {
        /// The system's reason.
        reason: String,
    },
    /// There is a loader, but no usable device.
    #[error(
        "no usable Vulkan device: {reason}; `ashsplat devices` lists what there is, and {INSTALL_VULKAN}"
    )]
    NoDevice {
        /// Devices found, and why each is not usable.
        reason: String,
    },
    /// No device matches `--device`.
    #[error("no Vulkan device matches '{}'; there are: {}", OneLine(requested), OneLine(available))]
    UnknownDevice {
        /// Device that was requested.
        requested: String,
        /// Available devices, with indices.
        available: String,
    },
    /// The device lacks a required feature.
    #[error("device '{device}' lacks {feature}, which ashsplat needs")]
    MissingFeature {
        /// Name of the device.
        device: String,
        /// Vulkan's name of the feature, extension or limit.
        feature: String,
    },
    /// An object exceeds a limit of the device or a budget.
    #[error("{} needs {needed} {unit}, more than {limit} ({limit_name})", OneLine(what))]
    TooLarge {
        /// Object that does not fit.
        what: String,
        /// Amount that it needs.
        needed: u64,
        /// "bytes", "workgroups", …
        unit: &'static str,
        /// Largest allowed amount.
        limit: u64,
        /// Vulkan's name of the limit, or the setting's.
        limit_name: &'static str,
    },
    /// A Vulkan call failed.
    #[error("{call} failed: {result}{}", Remedy(remedy))]
    Vulkan {
        /// Vulkan function.
        call: &'static str,
        /// Result code in words.
        result: String,
        /// What to do about it; may be empty.
        remedy: String,
    },
    /// The driver has given up the device. The context is unusable; a new context may work.
    #[error("{call} failed: the device is lost; the driver has reset it: see the system's log. Open it anew")]
    DeviceLost {
        /// Vulkan function that reported it.
        call: &'static str,
    },
    /// A submission took longer than [`crate::vk::ContextOptions::timeout`] allows. It is still running. Its outputs are
    /// undefined, and its memory is in use until it ends.
    #[error(
        "a submission is not over after {seconds:.1} s; raise the timeout, or use a smaller scene or resolution"
    )]
    Timeout {
        /// Time waited, seconds.
        seconds: f64,
    },
    /// The user requested a stop.
    #[error("interrupted")]
    Interrupted,
}

/// Displays text in one line: each control character, such as a line break in a quoted name, becomes a space.
struct OneLine<T>(T);

impl<T: Display> Display for OneLine<T> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0.to_string().replace(char::is_control, " "))
    }
}

struct Remedy<'a>(&'a str);

impl Display for Remedy<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        if self.0.is_empty() { Ok(()) } else { write!(f, "; {}", OneLine(self.0)) }
    }
}

impl Error {
    /// Returns an [`Error::Input`].
    pub fn input(path: impl AsRef<Path>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Input { path: path.as_ref().to_owned(), problem: problem.into(), remedy: remedy.into() }
    }

    /// Returns an [`Error::Io`].
    pub fn io(path: impl AsRef<Path>, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_owned(), action, source }
    }

    /// Returns an [`Error::Argument`].
    pub fn argument(what: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Argument { what: what.into(), problem: problem.into() }
    }

    /// Renames the argument to the caller's name for it.
    #[must_use]
    pub(crate) fn of(mut self, name: impl Into<String>) -> Self {
        if let Self::Argument { what, .. } = &mut self {
            *what = name.into();
        }
        self
    }

    /// Returns [`Error::TooLarge`] with the amount and its unit, and the limit and its name.
    pub fn too_large(
        what: impl Into<String>,
        (needed, unit): (u64, &'static str),
        (limit, limit_name): (u64, &'static str),
    ) -> Self {
        Self::TooLarge { what: what.into(), needed, unit, limit, limit_name }
    }

    /// Names the setting, or the frame, that caused an [`Error::TooLarge`].
    #[must_use]
    pub(crate) fn of_field(mut self, field: impl Display) -> Self {
        if let Self::TooLarge { what, .. } = &mut self {
            *what = format!("{field}: {what}");
        }
        self
    }

    /// Prefixes the argument with the name of the outer argument that contains it.
    #[must_use]
    pub(crate) fn within(mut self, outer: impl Display) -> Self {
        if let Self::Argument { what, .. } = &mut self {
            *what = format!("{outer}.{what}");
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_one_line() {
        let error = Error::input("a\nb.json", "unknown field `x\r\n`", "leave it out");
        assert_eq!(error.to_string(), "a b.json: unknown field `x  `; leave it out");
        let large = Error::too_large("photo 'a\nb.jpg'", (9, "bytes"), (8, "--max-memory"));
        assert!(large.to_string().starts_with("photo 'a b.jpg' needs 9 bytes"), "{large}");
        assert_eq!(Error::argument("a\tb", "is\n0").to_string(), "a b: is 0");
        let failed = Error::io("c\n", "read", std::io::Error::other("d\ne"));
        assert_eq!(failed.to_string(), "c : cannot read: d e");
    }
}
