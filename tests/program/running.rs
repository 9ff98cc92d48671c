//! Programs that run beside a test.

use std::ops::{Deref, DerefMut};
use std::process::{Child, Command, Output};

/// A program that the drop ends, so that a failed test leaves no process behind.
pub struct Running(Option<Child>);

impl Running {
    pub fn start(command: &mut Command) -> Running {
        // Windows interrupts a group of processes, which must not be the test's own.
        #[cfg(windows)]
        {
            use windows_sys::Win32::System::Threading::CREATE_NEW_PROCESS_GROUP;
            std::os::windows::process::CommandExt::creation_flags(command, CREATE_NEW_PROCESS_GROUP);
        }
        Running(Some(command.spawn().expect("the program starts")))
    }

    /// Interrupts it as Ctrl-C does. On Windows as Ctrl-Break, because Ctrl-C reaches all programs of a console.
    pub fn interrupt(&self) {
        #[cfg(unix)]
        self.signal(nix::sys::signal::Signal::SIGINT);
        #[cfg(windows)]
        {
            use windows_sys::Win32::System::Console::{CTRL_BREAK_EVENT, GenerateConsoleCtrlEvent};
            // SAFETY: both arguments are numbers.
            #[allow(unsafe_code)]
            let sent = unsafe { GenerateConsoleCtrlEvent(CTRL_BREAK_EVENT, self.id()) };
            assert_ne!(sent, 0, "{}", std::io::Error::last_os_error());
        }
    }

    #[cfg(unix)]
    pub fn signal(&self, signal: nix::sys::signal::Signal) {
        let pid = self.id().try_into().expect("a process");
        nix::sys::signal::kill(nix::unistd::Pid::from_raw(pid), signal).expect("a signal");
    }

    pub fn finish(mut self) -> Output {
        self.0.take().expect("a program").wait_with_output().expect("it ends")
    }
}

impl Deref for Running {
    type Target = Child;

    fn deref(&self) -> &Child {
        self.0.as_ref().expect("a program")
    }
}

impl DerefMut for Running {
    fn deref_mut(&mut self) -> &mut Child {
        self.0.as_mut().expect("a program")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            child.kill().ok();
            child.wait().ok();
        }
    }
}
