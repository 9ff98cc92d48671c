//! Arbitrary bytes as a checkpoint. Fingerprints are not compared, because nearly every change would fail there.
#![no_main]

use ashsplat::train::checkpoint::Checkpoint;
use ashsplat_files::CheckpointFile;
use ashsplat_fuzz::{checkpoint, folder, gaussians, in_one_line, leave_seed, within};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("checkpoint").join("input.safetensors"));

fn seeds() {
    for sh_degree in [0, 1] {
        checkpoint(gaussians(2, sh_degree), sh_degree).write(&*FILE).expect("written");
        leave_seed(&format!("degree{sh_degree}"), &std::fs::read(&*FILE).expect("there"));
    }
}

fuzz_target!(init: seeds(), |data: &[u8]| {
    std::fs::write(&*FILE, data).expect("written");
    within(data.len(), |_| {
        if let Some(checkpoint) = in_one_line(Checkpoint::read(&*FILE)) {
            // A checkpoint that was read can be written and read again unchanged.
            checkpoint.write(&*FILE).expect("written");
            let again = Checkpoint::read(&*FILE).expect("its own");
            assert_eq!(again.fingerprint(), checkpoint.fingerprint());
            assert_eq!((again.capacities, again.skipped), (checkpoint.capacities, checkpoint.skipped));
        }
    });
});
