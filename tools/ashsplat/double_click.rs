//! On Windows, a double-click opens a console that closes with the program. It explains itself there.

use std::io::{IsTerminal, stdin, stdout};
use windows_sys::Win32::System::Console::GetConsoleProcessList;

/// Explains how to use the program, and waits for Enter, if the console has no other process: no shell started it.
/// Returns true if it did.
pub fn explain() -> bool {
    let mut others = [0; 2];
    // SAFETY: the array has the length that is passed.
    let processes = unsafe { GetConsoleProcessList(others.as_mut_ptr(), others.len() as u32) };
    if processes != 1 || !stdin().is_terminal() || !stdout().is_terminal() {
        return false;
    }
    say!(
        "ashsplat runs in a terminal. Open one in this folder: right-click beside the files, \"Open in Terminal\". Then type\n\n\
         .\\ashsplat demo      to make a small data set, train on it and see the result\n\
         .\\ashsplat --help    for all commands\n\nPress Enter to close this window."
    );
    stdin().read_line(&mut String::new()).ok();
    true
}
