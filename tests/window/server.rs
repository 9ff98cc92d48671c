//! An X server without a screen, and simulated input.

use crate::running::Running;
use ashsplat_files::Photo;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use x11rb::connection::Connection;
use x11rb::protocol::xproto::{
    AtomEnum, ClientMessageEvent, ConfigureWindowAux, ConnectionExt as _, EventMask, ImageFormat, InputFocus,
    KEY_PRESS_EVENT, KEY_RELEASE_EVENT, MOTION_NOTIFY_EVENT, Window,
};
use x11rb::protocol::xtest::ConnectionExt as _;
use x11rb::rust_connection::RustConnection;

pub const PATIENCE: Duration = Duration::from_secs(120);
pub const PAUSE: Duration = Duration::from_millis(50);

/// A running Xvfb. The drop ends it.
pub struct Server {
    _child: Running,
    /// Value for DISPLAY.
    pub display: String,
}

impl Server {
    pub fn start() -> Server {
        let mut xvfb = Command::new("Xvfb");
        xvfb.args(["-displayfd", "1", "-screen", "0", "1400x900x24", "-nolisten", "tcp", "-noreset"]);
        let mut child = Running::start(xvfb.stdout(Stdio::piped()).stderr(Stdio::null()));
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("its stdout")).read_line(&mut line).expect("a line");
        Server { _child: child, display: format!(":{}", line.trim()) }
    }

    pub fn connect(&self) -> Desk {
        let (connection, screen) = x11rb::connect(Some(&self.display)).expect("a connection");
        let root = connection.setup().roots[screen].root;
        Desk { connection, root }
    }
}

pub struct Desk {
    connection: RustConnection,
    root: Window,
}

impl Desk {
    /// Waits for a window whose title begins with `title`.
    pub fn window(&self, title: &str) -> Window {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            let tree = self.connection.query_tree(self.root).expect("sent").reply().expect("windows");
            for window in tree.children {
                let name = self
                    .connection
                    .get_property(false, window, AtomEnum::WM_NAME, AtomEnum::ANY, 0, 100)
                    .expect("sent")
                    .reply();
                let viewable = self.connection.get_window_attributes(window).expect("sent").reply();
                let viewable = viewable.is_ok_and(|a| u8::from(a.map_state) == 2);
                if viewable && name.is_ok_and(|name| name.value.starts_with(title.as_bytes())) {
                    self.connection
                        .set_input_focus(InputFocus::PARENT, window, x11rb::CURRENT_TIME)
                        .expect("sent");
                    self.connection.flush().expect("sent");
                    return window;
                }
            }
            std::thread::sleep(PAUSE);
        }
        panic!("no window '{title}'");
    }

    fn fake(&self, kind: u8, detail: u8, at: [i16; 2]) {
        self.connection.xtest_fake_input(kind, detail, 0, self.root, at[0], at[1], 0).expect("sent");
        self.connection.flush().expect("sent");
    }

    pub fn key(&self, code: u8) {
        self.hold(code, Duration::ZERO);
    }

    pub fn hold(&self, code: u8, time: Duration) {
        self.fake(KEY_PRESS_EVENT, code, [0; 2]);
        std::thread::sleep(time);
        self.fake(KEY_RELEASE_EVENT, code, [0; 2]);
    }

    pub fn chord(&self, held: u8, code: u8) {
        self.fake(KEY_PRESS_EVENT, held, [0; 2]);
        self.key(code);
        self.fake(KEY_RELEASE_EVENT, held, [0; 2]);
    }

    pub fn drag(&self, from: [i16; 2], to: [i16; 2]) {
        self.fake(MOTION_NOTIFY_EVENT, 0, from);
        self.fake(4, 1, from);
        for step in 1..=8 {
            let at = [0, 1].map(|i| from[i] + (to[i] - from[i]) * step / 8);
            self.fake(MOTION_NOTIFY_EVENT, 0, at);
            std::thread::sleep(PAUSE / 2);
        }
        self.fake(5, 1, to);
    }

    pub fn click(&self, at: [i16; 2]) {
        self.fake(MOTION_NOTIFY_EVENT, 0, at);
        self.fake(4, 1, at);
        self.fake(5, 1, at);
    }

    pub fn resize(&self, window: Window, [width, height]: [u32; 2]) {
        let size = ConfigureWindowAux::new().x(0).y(0).width(width).height(height);
        self.connection.configure_window(window, &size).expect("sent").check().expect("resized");
    }

    /// Sends the message of a window manager when the close button is pressed.
    pub fn close(&self, window: Window) {
        let atom = |name: &[u8]| {
            self.connection.intern_atom(false, name).expect("sent").reply().expect("an atom").atom
        };
        let (protocols, delete) = (atom(b"WM_PROTOCOLS"), atom(b"WM_DELETE_WINDOW"));
        let message = ClientMessageEvent::new(32, window, protocols, [delete, x11rb::CURRENT_TIME, 0, 0, 0]);
        self.connection.send_event(false, window, EventMask::NO_EVENT, message).expect("sent");
        self.connection.flush().expect("sent");
    }

    pub fn screenshot(&self, window: Window) -> Photo {
        let place = self.connection.get_geometry(window).expect("sent").reply().expect("a window");
        let (width, height) = (place.width, place.height);
        let image = self.connection.get_image(ImageFormat::Z_PIXMAP, window, 0, 0, width, height, !0);
        let image = image.expect("sent").reply().expect("an image");
        // Blue, green, red, unused.
        let rgb = image.data.chunks_exact(4).flat_map(|bgrx| [bgrx[2], bgrx[1], bgrx[0]]).collect();
        Photo { width: width.into(), height: height.into(), rgb }
    }
}
