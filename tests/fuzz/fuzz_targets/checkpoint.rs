//! Arbitrary bytes as a checkpoint. Fingerprints are not compared, because nearly every change would fail there.
#![no_main]

use ashsplat::scene::PointCloud;
use ashsplat::trainer::checkpoint::Checkpoint;
use ashsplat_files::CheckpointFile;
use ashsplat_fuzz::{checkpoint, folder, in_one_line, leave_seed, within};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("checkpoint").join("input.safetensors"));

/// Valid files of two degrees.
fn seeds() {
    let points = PointCloud { positions: vec![[0.0; 3], [1.0, 2.0, 3.0]], colors: vec![[1, 2, 3]; 2] };
    for sh_degree in [0, 1] {
        let gaussians = ashsplat_files::initial_gaussians(&points, sh_degree).expect("Gaussians");
        let checkpoint = checkpoint(gaussians, sh_degree);
        checkpoint.write(&*FILE).expect("written");
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
            assert_eq!((again.room, again.skipped), (checkpoint.room, checkpoint.skipped));
        }
    });
});
