//! All attacks.

mod bombs;
mod connections;
mod floods;
mod kills;
mod photos;
mod resources;

use crate::siege::{Outcome, Result, Siege};

/// An attack. It returns an error if the program misbehaves.
pub struct Attack {
    pub name: &'static str,
    pub run: fn(&Siege) -> Result<Outcome>,
}

/// In order of execution.
pub const ATTACKS: [Attack; 23] = [
    Attack { name: "connections that say nothing, to a training", run: connections::silent },
    Attack { name: "WebSockets whose hand-shake never ends", run: connections::unfinished },
    Attack { name: "SIBR clients that say nothing", run: connections::network_viewer },
    Attack { name: "large photos asked for at once", run: photos::at_once },
    Attack { name: "photos asked for by a foreign page", run: photos::foreign },
    Attack { name: "pages that flood a training and read nothing", run: floods::pages },
    Attack { name: "SIBR clients that flood a training", run: floods::network_viewer },
    Attack { name: "file_path of 100,000 folders", run: bombs::photo_path },
    Attack { name: "mask_path of 100,000 folders", run: bombs::mask_path },
    Attack { name: "names of 100,000 folders in images.txt", run: bombs::colmap_names },
    Attack { name: "JSON 100,000 levels deep", run: bombs::deep_json },
    Attack { name: "JSON with lists of millions", run: bombs::wide_json },
    Attack { name: "JSON beyond --max-host-memory", run: bombs::bounded_json },
    Attack { name: "blocks.json with other values", run: bombs::damaged_blocks },
    Attack { name: "a GLB of 60 MiB from a page", run: bombs::upload },
    Attack { name: "pipes and devices for files", run: bombs::no_files },
    Attack { name: "photos, PLY and SPZ that claim to be huge", run: bombs::claims },
    Attack { name: "a full disk, freed later", run: resources::full },
    Attack { name: "files of limited size", run: resources::file_size },
    Attack { name: "40 descriptors", run: resources::descriptors },
    Attack { name: "a scene larger than the address space", run: resources::memory },
    Attack { name: "killed while it saves", run: kills::killed },
    Attack { name: "interrupted and resumed", run: kills::interrupted },
];
