//! Shaders that are edited while the program runs: its feature `hot-reload`. A separate test program, because the
//! feature recompiles the engine.

#![allow(clippy::disallowed_methods, clippy::expect_used)]

#[path = "common/slashes.rs"]
mod common;
#[allow(dead_code)]
#[path = "cli/run.rs"]
mod run;
#[path = "program/running.rs"]
#[allow(dead_code)]
mod running;

use run::{finish, program, text};
use running::Running;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use tempfile::tempdir;

const SMALL: [&str; 10] =
    ["--gaussians", "300", "--width", "80", "--height", "48", "--frames", "3", "--warmup", "1"];

fn shaders(folder: &Path) -> PathBuf {
    fn copy(from: &Path, to: &Path) {
        fs::create_dir_all(to).expect("a folder");
        for entry in fs::read_dir(from).expect("shaders") {
            let entry = entry.expect("an entry");
            let target = to.join(entry.file_name());
            if entry.path().is_dir() {
                copy(&entry.path(), &target)
            } else {
                drop(fs::copy(entry.path(), target))
            }
        }
    }
    let glsl = folder.join("glsl");
    copy(&Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("glsl"), &glsl);
    glsl
}

fn edit(file: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(file).expect("a shader");
    assert!(text.contains(from), "no '{from}' in {}", file.display());
    fs::write(file, text.replacen(from, to, 1)).expect("written");
}

#[test]
fn profile_watch_shows_an_edit_and_survives_a_broken_one() {
    let folder = tempdir().expect("a temporary folder");
    let glsl = shaders(folder.path());
    let mut command = program();
    // Each edit waits for the result of the previous one, because compile times vary.
    command.args(["profile", "--watch", "--watch-for", "60", "--glsl", text(&glsl)]).args(SMALL);
    let mut child = Running::start(command.stdout(Stdio::piped()).stderr(Stdio::null()));
    let mut lines = BufReader::new(child.stdout.take().expect("its stdout")).lines().map_while(Result::ok);
    let mut said = String::new();
    let mut until = |what: &str| {
        for line in lines.by_ref() {
            said += &format!("{line}\n");
            if line.contains(what) {
                return;
            }
        }
        panic!("never said '{what}': {said}");
    };
    until("watching ");
    edit(&glsl.join("include/sh.glsl"), "const float SH_C0 = 0.28", "const float SH_C0 = 0.18");
    until("largest difference of the pictures: ");
    edit(&glsl.join("sort/sort_upsweep.comp"), "void main() {", "void main( {");
    until("the old kernels stay");
    drop(child);
    assert!(said.contains("changed: ") && said.contains("forward/project"), "{said}");
    let difference = said.lines().find_map(|l| l.strip_prefix("largest difference of the pictures: "));
    assert!(difference.and_then(|d| d.parse().ok()).is_some_and(|d: f32| d > 0.01), "{said}");
    assert!(said.contains("glsl/sort/sort_upsweep.comp:"), "{said}");
}

#[test]
fn profile_takes_edited_shaders_and_what_they_print() {
    let folder = tempdir().expect("a temporary folder");
    let glsl = shaders(folder.path());
    let ranges = glsl.join("forward/ranges.comp");
    edit(&ranges, "#version 460\n", "#version 460\n#extension GL_EXT_debug_printf : enable\n");
    let print = "void main() {\n    if (gl_GlobalInvocationID.x == 0u) debugPrintfEXT(\"first of %u\", 7u);";
    edit(&ranges, "void main() {", print);
    let mut arguments = vec!["--glsl", text(&glsl), "--kernel", "forward/ranges"];
    if ashsplat::vk::validation_available() {
        arguments.push("--printf");
    }
    let run = finish(program().arg("profile").args(arguments).args(SMALL));
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let said = run.stdout;
    assert_eq!(said.contains("printf: first of 7"), ashsplat::vk::validation_available(), "{said}");
    // A changed interface needs another program.
    edit(&ranges, "void main() {", "layout(constant_id = 9) const uint NEW = 1;\nvoid main() {");
    let run = finish(program().args(["profile", "--glsl", text(&glsl)]).args(SMALL));
    assert!(run.code == Some(2) && run.stderr.contains("specialization constants changed"), "{}", run.stderr);
}
