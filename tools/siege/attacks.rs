//! All attacks.

mod bombs;
mod connections;
mod floods;
mod photos;
mod resources;

use crate::siege::{Result, Siege};

/// An attack. Returns what the program withstood in words, or an error if it misbehaves; `ErrorKind::Unsupported` if the attack is
/// impossible here.
pub type Attack = fn(&Siege) -> Result<String>;

/// Names and attacks, in order of execution.
pub const ATTACKS: [(&str, Attack); 9] = [
    ("connections that say nothing, to a training", connections::silent),
    ("WebSockets whose hand-shake never ends", connections::unfinished),
    ("large photos asked for at once", photos::at_once),
    ("pages that flood a training and read nothing", floods::pages),
    ("JSON beyond --max-host-memory", bombs::bounded_json),
    ("blocks.json with other values", bombs::damaged_blocks),
    ("a GLB of 60 MiB from a page", bombs::upload),
    ("a full disk, freed later", resources::full),
    ("40 descriptors", resources::descriptors),
];
