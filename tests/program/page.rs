//! The program as a server, and a client that does what the page does.

use super::running::Running;
pub use crate::common::splats::{ball, camera};
use ashsplat::scene::Camera;
use ashsplat_files::splats::{self, WriteOptions};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

pub const PATIENCE: Duration = Duration::from_secs(120);

pub struct Server {
    child: Running,
    /// Line that names the page.
    pub said: String,
    /// localhost:PORT.
    pub host: String,
}

impl Server {
    /// Starts the program and waits for the line that names the page.
    pub fn start(arguments: &[&str]) -> Server {
        Server::run(program(), arguments)
    }

    /// Same as [`Server::start`], but in this folder and with these environment variables.
    pub fn start_in(folder: &Path, variables: &[(&str, &str)], arguments: &[&str]) -> Server {
        let mut command = program();
        command.current_dir(folder).envs(variables.iter().copied());
        Server::run(command, arguments)
    }

    /// Adds arguments to a command, starts it and waits for the line that names the page.
    pub fn run(mut command: Command, arguments: &[&str]) -> Server {
        command.env_remove("ASHSPLAT_DEVICE").env("ASHSPLAT_PIPELINE_CACHE", "");
        let mut child = Running::start(command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()));
        let mut lines =
            BufReader::new(child.stdout.take().expect("its stdout")).lines().map_while(Result::ok);
        let Some(said) = lines.find(|line| line.starts_with("viewer at ")) else {
            panic!("{arguments:?}: {}", String::from_utf8_lossy(&child.finish().stderr));
        };
        let host = said["viewer at http://".len()..].split('/').next().unwrap_or_default().to_owned();
        // Drain the rest of the output, so that the program never blocks.
        std::thread::spawn(move || lines.for_each(drop));
        Server { child, said, host }
    }

    /// Starts `view` on a free port and waits for the scene, unless the page needs a token.
    pub fn view(path: &Path, more: &[&str]) -> Server {
        let server = Server::start(&[&["view", path.to_str().expect("UTF-8"), "--port", "0"], more].concat());
        server.page_with("").ok();
        server
    }

    /// Interrupts the program and waits. Returns exit code and stderr.
    pub fn end(mut self) -> (Option<i32>, String) {
        self.child.interrupt();
        self.wait()
    }

    pub fn wait(&mut self) -> (Option<i32>, String) {
        let mut stderr = String::new();
        self.child.stderr.take().expect("its stderr").read_to_string(&mut stderr).ok();
        (self.child.wait().expect("it ends").code(), stderr)
    }

    /// Returns status, headers and body of an answer.
    pub fn get(&self, path: &str, headers: &[(&str, &str)]) -> (u16, String, Vec<u8>) {
        self.request("GET", path, headers, &[])
    }

    /// Same as [`Self::get`], but sends a body. Adds the length unless the headers give one.
    pub fn post(&self, path: &str, headers: &[(&str, &str)], body: &[u8]) -> (u16, String, Vec<u8>) {
        let sized = ["Content-Length", "Transfer-Encoding"];
        let length = body.len().to_string();
        let own = headers.iter().any(|(name, _)| sized.contains(name));
        let length = [("Content-Length", length.as_str())];
        self.request("POST", path, &[headers, if own { &[] } else { &length }].concat(), body)
    }

    pub fn request(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &[u8],
    ) -> (u16, String, Vec<u8>) {
        let mut stream = self.connect();
        let own = headers.iter().any(|(name, _)| *name == "Host");
        let host = if own { String::new() } else { format!("Host: {}\r\n", self.host) };
        let more: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
        write!(stream, "{method} {path} HTTP/1.1\r\n{host}{more}Connection: close\r\n\r\n").expect("sent");
        // The server may refuse a request by its headers without reading the body.
        stream.write_all(body).ok();
        let mut answer = Vec::new();
        let read = stream.read_to_end(&mut answer);
        assert!(read.is_ok() || !body.is_empty(), "{read:?}");
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").expect("headers");
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        let code = head.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a status");
        (code, head, answer[end + 4..].to_vec())
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.host.as_str()).expect("connected");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        stream
    }

    /// Opens the page's WebSocket and reads the first message.
    pub fn page(&self) -> Page {
        self.page_with("").expect("a WebSocket")
    }

    pub fn page_with(&self, query: &str) -> Result<Page, String> {
        let url = format!("ws://{}/socket{query}", self.host);
        let (socket, _) = tungstenite::client(url, self.connect()).map_err(|error| error.to_string())?;
        let mut page = Page { socket, greeting: Value::Null };
        page.greeting = page.wait_for("scene");
        Ok(page)
    }
}

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_ashsplat"))
}

/// A client that does what the browser's page does.
pub struct Page {
    pub socket: WebSocket<TcpStream>,
    pub greeting: Value,
}

/// Messages of the server.
pub enum PageMessage {
    Frame(PageFrame),
    Message(Value),
}

/// A frame as received.
pub struct PageFrame {
    pub header: Value,
    pub picture: Vec<u8>,
}

impl PageFrame {
    /// RGB bytes of the picture.
    pub fn rgb(&self) -> Vec<u8> {
        image::load_from_memory(&self.picture).expect("a picture").to_rgb8().into_raw()
    }
}

impl Page {
    pub fn send(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).expect("sent");
    }

    pub fn receive(&mut self) -> PageMessage {
        loop {
            match self.socket.read().expect("a message") {
                Message::Binary(bytes) => {
                    let (length, rest) = bytes.split_at(4);
                    let length = u32::from_le_bytes(length.try_into().expect("4 bytes")) as usize;
                    let header = serde_json::from_slice(&rest[..length]).expect("a header");
                    return PageMessage::Frame(PageFrame { header, picture: rest[length..].to_vec() });
                }
                Message::Text(text) => {
                    return PageMessage::Message(serde_json::from_str(text.as_str()).expect("JSON"));
                }
                _ => {}
            }
        }
    }

    pub fn wait_for(&mut self, kind: &str) -> Value {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            if let PageMessage::Message(message) = self.receive() {
                if message["type"] == kind {
                    return message;
                }
                assert_ne!(message["type"], "problem", "{message}");
            }
        }
        panic!("no {kind}");
    }

    pub fn wait_for_problem(&mut self) -> String {
        self.wait_for("problem")["message"].as_str().expect("words").to_owned()
    }

    pub fn frame(&mut self) -> PageFrame {
        loop {
            match self.receive() {
                PageMessage::Frame(shown) => return shown,
                PageMessage::Message(message) => assert_ne!(message["type"], "problem", "{message}"),
            }
        }
    }

    /// True if nothing arrives for a while.
    pub fn is_silent(&mut self) -> bool {
        let stream = self.socket.get_ref();
        stream.set_read_timeout(Some(Duration::from_millis(700))).expect("a timeout");
        let silent = self.socket.read().is_err();
        self.socket.get_ref().set_read_timeout(Some(PATIENCE)).expect("a timeout");
        silent
    }

    pub fn look(&mut self, camera: &Camera, look: &Value) -> PageFrame {
        self.send(&view(1, camera, look));
        let shown = self.frame();
        self.send(&json!({ "type": "ack" }));
        shown
    }
}

/// Message that requests a frame.
pub fn view(seq: u64, camera: &Camera, look: &Value) -> Value {
    json!({ "type": "view", "seq": seq, "camera": message(camera), "look": look })
}

pub fn message(camera: &Camera) -> Value {
    let rows = [0, 1, 2].map(|row| camera.camera_from_world.row(row).to_array());
    json!({
        "rotation": rows, "translation": camera.translation.to_array(), "fx": camera.fx, "fy": camera.fy,
        "cx": camera.cx, "cy": camera.cy, "width": camera.width, "height": camera.height,
    })
}

pub fn write_ball(folder: &Path, count: usize) -> std::path::PathBuf {
    let path = folder.join("ball.ply");
    splats::write(&path, &ball(count), &WriteOptions::default()).expect("a PLY");
    path
}
