//! The protocol of the reference implementation's network viewer (SIBR's remote viewer, `network_gui.py`), so that it can
//! look at a training.
//!
//! The viewer sends a length (4 bytes, little-endian) and so much JSON: the camera's matrices as OpenGL has them (row
//! vectors, y up, z backward), the size of the picture, whether training is to go on. It gets the picture's RGB bytes, if
//! the size is not 0, then a length and so many bytes with the data set's path.

use super::hub::{Hub, RemoteRequest};
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::{Error, Result};
use glam::{Mat3, Vec3};
use serde::Deserialize;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;

/// Longest message that is taken for one.
const LONGEST_MESSAGE: u32 = 1 << 20;
/// A viewer that says nothing for so long is gone: SIBR's asks for the next picture as soon as it has one. Only one is served
/// at a time, and one that is not there could hold the training for ever.
const SILENCE: Duration = if cfg!(test) { Duration::from_millis(200) } else { Duration::from_secs(60) };
/// Most pixels of a picture.
const MOST_PIXELS: u64 = 3840 * 2400;

/// What the viewer wants of the training.
#[derive(Debug)]
pub struct Wishes {
    /// Whether it is there.
    connected: AtomicBool,
    train: AtomicBool,
    keep_alive: AtomicBool,
}

impl Wishes {
    /// Whether training may go on.
    pub fn may_train(&self) -> bool {
        !self.connected.load(Ordering::Relaxed) || self.train.load(Ordering::Relaxed)
    }

    /// Whether it wants to look on when training is over.
    pub fn wants_to_stay(&self) -> bool {
        self.connected.load(Ordering::Relaxed) && self.keep_alive.load(Ordering::Relaxed)
    }
}

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

/// `true`, or a number that is not 0: the viewer sends 0 and 1.
fn truth<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    match serde_json::Value::deserialize(deserializer)? {
        serde_json::Value::Bool(value) => Ok(value),
        serde_json::Value::Number(number) => Ok(number.as_f64() != Some(0.0)),
        _ => Err(serde::de::Error::custom("expected true, false, 0 or 1")),
    }
}

impl Message {
    /// The camera, in our frame; none where no picture is asked for.
    fn camera(&self) -> io::Result<Option<Camera>> {
        let (width, height) = (self.resolution_x, self.resolution_y);
        if width == 0 || height == 0 {
            return Ok(None);
        }
        let m: &[f32; 16] =
            self.view_matrix.as_slice().try_into().map_err(|_| bad("view_matrix: not 16 numbers"))?;
        // Its rows are our columns; y and z point the other way.
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

/// Listens; pictures are asked of the hub, and what else the viewer wants is in the answer. `source` is the data set's
/// path as the viewer is told it.
pub fn listen(ip: &str, port: u16, hub: Arc<Hub>, source: String) -> Result<(SocketAddr, Arc<Wishes>)> {
    let failed = |e: io::Error| {
        let busy = e.kind() == io::ErrorKind::AddrInUse;
        let problem = match busy {
            true => format!("port {port} of {ip} is in use by another program; choose another with --port N"),
            false => format!("cannot listen at {ip}:{port}: {e}"),
        };
        Error::argument("--port", problem)
    };
    let listener = TcpListener::bind((ip, port)).map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    let wishes = Arc::new(Wishes {
        connected: AtomicBool::new(false),
        train: AtomicBool::new(true),
        keep_alive: AtomicBool::new(false),
    });
    let shared = wishes.clone();
    let serve = move || {
        // One viewer at a time, as the reference has it.
        for stream in listener.incoming().flatten() {
            shared.train.store(true, Ordering::Relaxed);
            shared.connected.store(true, Ordering::Relaxed);
            // Its going, and nonsense, end the connection and nothing else.
            converse(stream, &hub, &source, &shared).ok();
            shared.connected.store(false, Ordering::Relaxed);
        }
    };
    std::thread::Builder::new().name("network viewer".into()).spawn(serve).map_err(failed)?;
    Ok((address, wishes))
}

fn converse(mut stream: TcpStream, hub: &Hub, source: &str, wishes: &Wishes) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(SILENCE))?;
    stream.set_write_timeout(Some(SILENCE))?;
    loop {
        let message = read_message(&mut stream)?;
        wishes.train.store(message.train, Ordering::Relaxed);
        wishes.keep_alive.store(message.keep_alive, Ordering::Relaxed);
        if let Some(camera) = message.camera()? {
            let (answer, picture) = mpsc::channel();
            hub.ask_remotely(RemoteRequest { camera, scale: message.scaling_modifier.max(0.0), answer });
            let rgb = picture.recv().map_err(|_| bad("no picture"))?;
            stream.write_all(&rgb)?;
        }
        let length = u32::try_from(source.len()).map_err(|_| bad("a path too long"))?;
        stream.write_all(&length.to_le_bytes())?;
        stream.write_all(source.as_bytes())?;
    }
}

fn read_message(stream: &mut TcpStream) -> io::Result<Message> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length);
    if length > LONGEST_MESSAGE {
        return Err(bad("a message too long"));
    }
    let mut text = vec![0; length as usize];
    stream.read_exact(&mut text)?;
    serde_json::from_slice(&text).map_err(io::Error::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What SIBR's viewer sends of a camera is that camera again.
    #[test]
    fn cameras_arrive() {
        let intrinsics = Intrinsics::from_fov_x(0.9, 64, 48);
        let camera = Camera::look_at(Vec3::new(1.0, -2.0, -3.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
        let r = camera.camera_from_world;
        let t = camera.translation;
        let column = |j: usize| [r.col(j).x, -r.col(j).y, -r.col(j).z, 0.0];
        let matrix = [column(0), column(1), column(2), [t.x, -t.y, -t.z, 1.0]].concat();
        let fov_y = 2.0 * (0.5 * 48.0 / camera.fy).atan();
        let text = serde_json::json!({
            "resolution_x": 64, "resolution_y": 48, "fov_x": 0.9, "fov_y": fov_y, "z_near": 0.01, "z_far": 100.0,
            "train": 1, "shs_python": false, "rot_scale_python": false, "keep_alive": 0, "scaling_modifier": 1.0,
            "view_matrix": matrix, "view_projection_matrix": vec![0.0; 16],
        });
        let message: Message = serde_json::from_value(text).expect("a message");
        assert!(message.train && !message.keep_alive);
        let arrived = message.camera().expect("sound").expect("a camera");
        assert!(arrived.camera_from_world.abs_diff_eq(r, 1e-6) && arrived.translation.abs_diff_eq(t, 1e-6));
        assert!((arrived.fx - camera.fx).abs() < 1e-3 && (arrived.fy - camera.fy).abs() < 1e-3);
    }

    /// One that holds the training and is there no more lets it go on, and the next one in.
    #[test]
    fn silent_viewers_are_given_up() {
        let (address, wishes) =
            listen("127.0.0.1", 0, Arc::new(Hub::default()), "data".into()).expect("a port");
        let wait_for = |what: &dyn Fn() -> bool| {
            let start = std::time::Instant::now();
            while !what() {
                assert!(start.elapsed() < Duration::from_secs(60), "{wishes:?}");
                std::thread::sleep(Duration::from_millis(2));
            }
        };
        let connect = || {
            let mut stream = TcpStream::connect(address).expect("connected");
            let text = br#"{"resolution_x": 0, "resolution_y": 0, "train": false}"#;
            stream.write_all(&(text.len() as u32).to_le_bytes()).expect("sent");
            stream.write_all(text).expect("sent");
            let mut answer = [0; 8];
            stream.read_exact(&mut answer).expect("an answer");
            assert_eq!(&answer[4..], b"data");
            stream
        };
        let asleep = connect();
        assert!(!wishes.may_train());
        wait_for(&|| wishes.may_train());
        drop((connect(), asleep));
    }
}
