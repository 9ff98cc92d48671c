//! The default bound of host memory under a control group's limit, as containers and schedulers set it.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

use crate::absent;
use libtest_mimic::Trial;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const LIMIT: u64 = 512 << 20;

/// One trial, if this process may create a group within its own.
pub fn trials() -> Vec<Trial> {
    let name = "control_groups_limit_what_is_read";
    vec![match Group::new() {
        Ok(group) => Trial::test(name, move || {
            files_beyond_the_limit_are_refused(&group);
            Ok(())
        }),
        Err(error) => absent(name, format!("no control group can be made here: {error}")),
    }]
}

/// A control group below this process's own; removed by the drop.
struct Group(PathBuf);

impl Group {
    fn new() -> io::Result<Group> {
        let groups = fs::read_to_string("/proc/self/cgroup")?;
        let of = |line: &str| {
            let (kinds, path) = line.split_once(':')?.1.split_once(':')?;
            let (root, limit) = match kinds {
                "memory" => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
                "" if Path::new("/sys/fs/cgroup/cgroup.controllers").exists() => {
                    ("/sys/fs/cgroup", "memory.max")
                }
                _ => return None,
            };
            Some((PathBuf::from(format!("{root}{}", path.trim_end_matches('/'))), limit))
        };
        let (above, limit) = groups.lines().find_map(of).ok_or(io::ErrorKind::NotFound)?;
        let folder = above.join(format!("ashsplat-{}", std::process::id()));
        fs::create_dir(&folder)?;
        let group = Group(folder);
        fs::write(group.0.join(limit), LIMIT.to_string())?;
        // Only an attempt shows whether processes may move.
        match group.command("true").output()?.status.success() {
            true => Ok(group),
            false => Err(io::ErrorKind::PermissionDenied.into()),
        }
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", "echo $$ > \"$0/cgroup.procs\" && exec \"$@\""]).arg(&self.0).arg(program);
        command.stdin(Stdio::null());
        command
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        fs::remove_dir(&self.0).ok();
    }
}

/// Gaussians of 1.1 GB in a sparse file: refused with the group's limit, instead of being killed by the system.
fn files_beyond_the_limit_are_refused(group: &Group) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let (count, row) = (20_000_000, 56);
    let header =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n");
    fs::write(&path, &header).unwrap();
    File::options().write(true).open(&path).unwrap().set_len(header.len() as u64 + count * row).unwrap();
    let run = group.command(env!("CARGO_BIN_EXE_ashsplat")).arg("info").arg(&path).output().unwrap();
    let said = String::from_utf8_lossy(&run.stderr);
    let numbers: Vec<u64> = said.split(' ').filter_map(|word| word.parse().ok()).collect();
    assert_eq!(run.status.code(), Some(2), "{said}");
    assert!(said.contains("bytes of host memory"), "{said}");
    assert!(numbers.len() == 2 && numbers[0] >= count * row, "{said}");
    assert!((LIMIT / 4..=LIMIT / 4 * 3).contains(&numbers[1]), "{said}");
}
