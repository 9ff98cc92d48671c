//! On Windows, a double-click opens a console that closes with the program. It explains itself there.

use std::io::stdin;
use sysinfo::{Pid, ProcessesToUpdate, System};

/// Explains how to use the program, and waits for Enter, if Explorer started it. Returns true if it did.
pub fn explain() -> bool {
    if !is_from_explorer().unwrap_or(false) {
        return false;
    }
    outln!(
        "ashsplat runs in a terminal. Open one in this folder: right-click beside the files, \"Open in Terminal\". Then type\n\n\
         .\\ashsplat demo      to make a small data set, train on it and see the result\n\
         .\\ashsplat --help    for all commands\n\nPress Enter to close this window."
    );
    stdin().read_line(&mut String::new()).ok();
    true
}

fn is_from_explorer() -> Option<bool> {
    let mut system = System::new();
    let mut find = |pid: Pid| {
        system.refresh_processes(ProcessesToUpdate::Some(&[pid]), false);
        system
            .process(pid)
            .map(|process| (process.parent(), process.name().eq_ignore_ascii_case("explorer.exe")))
    };
    let (parent, _) = find(sysinfo::get_current_pid().ok()?)?;
    Some(find(parent?)?.1)
}
