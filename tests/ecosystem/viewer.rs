//! The viewer's page in headless Chromium.

use std::path::Path;
use std::process::Command;

use ashsplat_files::splats::Format;

/// Uses a model and a training as a user would. The screenshots stay below `target` for inspection.
pub fn works_in_chromium(modules: &Path, _: Format) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("viewer");
    std::fs::remove_dir_all(&folder).ok();
    let program = env!("CARGO_BIN_EXE_ashsplat");
    let demo =
        Command::new(program).args(["demo", "--quiet", "--iterations", "150", "--out"]).arg(&folder).output();
    assert!(demo.expect("the program").status.success());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/ecosystem/viewer.mjs");
    let mut node = Command::new("node");
    let result = node.arg(script).arg(modules).arg(program).arg(&folder).output().expect("node");
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
}
