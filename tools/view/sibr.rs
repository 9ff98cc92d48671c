//! The protocol of the reference implementation's network viewer (SIBR's remote viewer, `network_gui.py`), so that it can
//! look at a training.
//!
//! The viewer sends a length (4 bytes, little-endian) and a JSON text of that length. The text has the camera's matrices in
//! OpenGL's form (row vectors, y up, z backward), the picture's size, and whether training may continue. The answer is the
//! picture's RGB bytes, unless the size is 0, then a length and the data set's path.

mod viewers;

use super::hub::{Hub, RemoteRequest};
use super::pace::Pace;
use super::protocol::MOST_PIXELS;
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::{Error, Result};
use glam::{Mat3, Vec3};
use serde::Deserialize;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

pub use viewers::Wishes;

/// Longest accepted message.
const LONGEST_MESSAGE: u32 = 1 << 20;
/// A viewer that is silent this long is given up. SIBR's asks for the next picture as soon as it has one, and reconnects.
const SILENCE: Duration = Duration::from_secs(10);
/// Longest wait for a picture.
const PATIENCE: Duration = Duration::from_secs(60);
/// Pause when no connection can be accepted, for example because there are no free descriptors.
const PAUSE: Duration = Duration::from_millis(100);

/// The viewer's message.
#[derive(Debug, Deserialize)]
struct Message {
    resolution_x: u32,
    resolution_y: u32,
    #[serde(default)]
    fov_x: f32,
    #[serde(default)]
    fov_y: f32,
    #[serde(default = "yes", deserialize_with = "truth")]
    train: bool,
    #[serde(default, deserialize_with = "truth")]
    keep_alive: bool,
    #[serde(default = "one")]
    scaling_modifier: f32,
    #[serde(default)]
    view_matrix: Vec<f32>,
}

fn yes() -> bool {
    true
}

fn one() -> f32 {
    1.0
}

/// Accepts `true`, or a number other than 0: the viewer sends 0 and 1.
fn truth<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    match serde_json::Value::deserialize(deserializer)? {
        serde_json::Value::Bool(value) => Ok(value),
        serde_json::Value::Number(number) => Ok(number.as_f64() != Some(0.0)),
        _ => Err(serde::de::Error::custom("expected true, false, 0 or 1")),
    }
}

impl Message {
    /// The camera in the engine's frame; none if no picture is requested.
    fn camera(&self) -> io::Result<Option<Camera>> {
        let (width, height) = (self.resolution_x, self.resolution_y);
        if width == 0 || height == 0 {
            return Ok(None);
        }
        let m: &[f32; 16] =
            self.view_matrix.as_slice().try_into().map_err(|_| bad("view_matrix: not 16 numbers"))?;
        // Its rows are the engine's columns; y and z point the other way.
        let row = |i: usize, sign: f32| sign * Vec3::new(m[i], m[4 + i], m[8 + i]);
        let rotation = Mat3::from_cols(row(0, 1.0), row(1, -1.0), row(2, -1.0)).transpose();
        let translation = Vec3::new(m[12], -m[13], -m[14]);
        let focal = |size: u32, fov: f32| 0.5 * size as f32 / (0.5 * fov).tan();
        let intrinsics = Intrinsics {
            fx: focal(width, self.fov_x),
            fy: focal(height, self.fov_y),
            cx: 0.5 * width as f32,
            cy: 0.5 * height as f32,
            width,
            height,
        };
        let camera = Camera::with_pose(rotation, translation, intrinsics);
        camera.check().map_err(|error| bad(&error.to_string()))?;
        if u64::from(width) * u64::from(height) > MOST_PIXELS {
            return Err(bad("too many pixels"));
        }
        Ok(Some(camera))
    }
}

fn bad(problem: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, problem)
}

/// Error of a port that cannot be used.
fn refused(problem: impl std::fmt::Display) -> Error {
    Error::argument("--port", problem.to_string())
}

/// Opens the port.
pub fn open(ip: &str, port: u16) -> Result<TcpListener> {
    let listener = TcpListener::bind((ip, port)).map_err(|e| {
        let busy = e.kind() == io::ErrorKind::AddrInUse;
        refused(match busy {
            true => format!("port {port} of {ip} is in use by another program; choose another with --port N"),
            false => format!("cannot listen at {ip}:{port}: {e}"),
        })
    })?;
    let address = listener.local_addr().map_err(refused)?;
    if !address.ip().is_loopback() {
        tell!(
            "warning: the network viewer's protocol has no password: whatever reaches {address} can look at the \
             training and hold it"
        );
    }
    Ok(listener)
}

/// Serves at an open port. Pictures are requested from the hub; the viewers' other requests are returned. `source` is the data
/// set's path that viewers get.
pub fn serve(listener: TcpListener, hub: Arc<Hub>, source: String) -> Result<(SocketAddr, Arc<Wishes>)> {
    let address = listener.local_addr().map_err(refused)?;
    let wishes = Arc::new(Wishes::default());
    let shared = wishes.clone();
    let serve = move || {
        for stream in listener.incoming() {
            let admitted = stream.and_then(|stream| admit(stream, &hub, &source, &shared));
            // Only this connection is lost.
            if admitted.is_err() {
                std::thread::sleep(PAUSE);
            }
        }
    };
    std::thread::Builder::new().name("network viewer".into()).spawn(serve).map_err(refused)?;
    Ok((address, wishes))
}

/// Serves a viewer on its own thread, so that it waits for no other.
fn admit(stream: TcpStream, hub: &Arc<Hub>, source: &str, wishes: &Arc<Wishes>) -> io::Result<()> {
    let stream = Arc::new(stream);
    if !wishes.admit(&stream) {
        return Ok(());
    }
    let (hub, source, shared, own) = (hub.clone(), source.to_owned(), wishes.clone(), stream.clone());
    let serve = move || {
        // A closed or malformed connection ends itself only.
        converse(&own, &hub, &shared, &source).ok();
        shared.leave(&own);
    };
    let started = std::thread::Builder::new().name("network viewer".into()).spawn(serve);
    started.map(drop).inspect_err(|_| wishes.leave(&stream))
}

fn converse(own: &Arc<TcpStream>, hub: &Hub, wishes: &Wishes, source: &str) -> io::Result<()> {
    let mut stream: &TcpStream = own;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(SILENCE))?;
    let mut pace = Pace::new();
    loop {
        let message = read_message(stream)?;
        wishes.speaks(own, message.train, message.keep_alive);
        if let Some(camera) = message.camera()? {
            let (answer, picture) = mpsc::sync_channel(1);
            let scale = message.scaling_modifier.max(0.0);
            if !hub.ask_remotely(RemoteRequest { camera, scale, answer }) {
                return Err(bad("too many ask for pictures"));
            }
            let rgb = picture.recv_timeout(PATIENCE).map_err(|_| bad("no picture"))?;
            stream.write_all(&rgb)?;
        }
        let length = u32::try_from(source.len()).map_err(|_| bad("a path too long"))?;
        stream.write_all(&length.to_le_bytes())?;
        stream.write_all(source.as_bytes())?;
        wishes.is_answered(own);
        pace.spend(source.len());
        std::thread::sleep(pace.wait());
    }
}

/// Reads a message, which must be complete in time.
fn read_message(stream: &TcpStream) -> io::Result<Message> {
    let end = Instant::now() + SILENCE;
    let mut length = [0; 4];
    read_until(stream, &mut length, end)?;
    let length = u32::from_le_bytes(length);
    if length > LONGEST_MESSAGE {
        return Err(bad("a message too long"));
    }
    let mut text = vec![0; length as usize];
    read_until(stream, &mut text, end)?;
    serde_json::from_slice(&text).map_err(io::Error::from)
}

/// Fills a buffer before `end`, also from a peer that sends byte by byte.
fn read_until(mut stream: &TcpStream, mut buffer: &mut [u8], end: Instant) -> io::Result<()> {
    while !buffer.is_empty() {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(buffer)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            read => buffer = &mut buffer[read..],
        }
    }
    Ok(())
}
