//! A page's messages, well-behaved or not, without a browser.

use crate::siege::{Result, ensure};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// Longest wait of a page for an answer, whatever other clients do.
pub const PATIENCE: Duration = Duration::from_secs(10);

pub struct Page {
    socket: WebSocket<TcpStream>,
}

/// Connects within a time limit, which also holds for reading and writing: without one, an attempt that is not accepted waits for
/// minutes.
pub fn connect(host: &str, longest: Duration) -> Result<TcpStream> {
    let mut refused = format!("{host} has no address").into();
    for address in host.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, longest) {
            Ok(stream) => {
                stream.set_read_timeout(Some(longest))?;
                stream.set_write_timeout(Some(longest))?;
                return Ok(stream);
            }
            Err(error) => refused = error.into(),
        }
    }
    Err(refused)
}

/// Status of an answer.
pub fn get(host: &str, path: &str, longest: Duration) -> Result<u16> {
    request(host, &format!("GET {path}"), "", &[], longest)
}

/// Sends a file, which must be accepted.
pub fn post(host: &str, path: &str, bytes: &[u8], longest: Duration) -> Result<()> {
    let headers = format!("Content-Type: application/octet-stream\r\nContent-Length: {}\r\n", bytes.len());
    let code = request(host, &format!("POST {path}"), &headers, bytes, longest)?;
    ensure!(code == 202, "{path} is not taken: {code}");
    Ok(())
}

fn request(host: &str, begin: &str, headers: &str, body: &[u8], longest: Duration) -> Result<u16> {
    let mut stream = connect(host, longest)?;
    write!(stream, "{begin} HTTP/1.1\r\nHost: {host}\r\n{headers}Connection: close\r\n\r\n")?;
    stream.write_all(body)?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    let head = String::from_utf8_lossy(&answer);
    let code = head.split(' ').nth(1).and_then(|code| code.parse().ok());
    code.ok_or_else(|| "the answer has no status".into())
}

impl Page {
    pub fn open(host: &str) -> Result<Page> {
        let (socket, _) = tungstenite::client(format!("ws://{host}/socket"), connect(host, PATIENCE)?)
            .map_err(|error| format!("no page: {error}"))?;
        let mut page = Page { socket };
        page.wait_for("scene")?;
        Ok(page)
    }

    /// The connection, for messages that no page would send.
    pub fn stream(&self) -> Result<TcpStream> {
        Ok(self.socket.get_ref().try_clone()?)
    }

    pub fn send(&mut self, message: &Value) -> Result<()> {
        self.socket
            .send(Message::text(message.to_string()))
            .map_err(|error| format!("a page is cut off: {error}"))?;
        Ok(())
    }

    /// The next relevant message; pictures are null.
    fn next(&mut self, kind: &str, start: Instant) -> Result<Value> {
        loop {
            ensure!(start.elapsed() < PATIENCE, "a page got no '{kind}' within {PATIENCE:?}");
            let message = self.socket.read();
            let message = message.map_err(|error| format!("a page got no '{kind}': {error}"))?;
            match message {
                Message::Text(text) => return Ok(serde_json::from_str(text.as_str())?),
                Message::Binary(_) => return Ok(Value::Null),
                _ => {}
            }
        }
    }

    pub fn wait_for(&mut self, kind: &str) -> Result<Value> {
        self.until_message(kind, |_| true)
    }

    /// The next message of a type that satisfies a condition.
    pub fn until_message(&mut self, kind: &str, holds: impl Fn(&Value) -> bool) -> Result<Value> {
        let start = Instant::now();
        loop {
            let message = self.next(kind, start)?;
            if message["type"] == kind && holds(&message) {
                return Ok(message);
            }
        }
    }

    /// Requests a frame; returns the time it took.
    pub fn look(&mut self) -> Result<Duration> {
        let start = Instant::now();
        self.send(&view())?;
        while !self.next("frame", start)?.is_null() {}
        self.send(&json!({ "type": "ack" }))?;
        Ok(start.elapsed())
    }

    pub fn act(&mut self, action: &str) -> Result<()> {
        self.send(&json!({ "type": "train", "action": action }))
    }

    pub fn status(&mut self) -> Result<Value> {
        self.send(&json!({ "type": "status", "since": 0 }))?;
        self.wait_for("status")
    }

    /// Pauses the training; returns the iteration at which it waits.
    pub fn hold(&mut self) -> Result<u64> {
        self.act("pause")?;
        // The first iteration may take long.
        self.until(|status| status["paused"] == true && status["iteration"] != 0)
    }

    /// Waits until the status satisfies a condition; returns the iteration.
    pub fn until(&mut self, stands: impl Fn(&Value) -> bool) -> Result<u64> {
        let start = Instant::now();
        loop {
            let status = self.status()?;
            if stands(&status) {
                return status["iteration"].as_u64().ok_or_else(|| "a status without an iteration".into());
            }
            ensure!(start.elapsed() < 6 * PATIENCE, "training stands still: {status:.200}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

pub fn view() -> Value {
    json!({ "type": "view", "seq": 1, "look": {}, "camera": {
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [0, 0, 2.5], "fx": 100, "fy": 100, "cx": 48,
        "cy": 32, "width": 96, "height": 64,
    } })
}

/// A message in a page's framing, masked with zeros.
pub fn frame(text: &str) -> Vec<u8> {
    let mut frame = vec![0x81];
    match u8::try_from(text.len()) {
        Ok(length) if length < 126 => frame.push(0x80 | length),
        _ => {
            frame.push(0x80 | 126);
            // The attacks' messages are short.
            frame.extend((text.len() as u16).to_be_bytes());
        }
    }
    frame.extend([0; 4]);
    frame.extend(text.as_bytes());
    frame
}
