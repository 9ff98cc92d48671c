//! Data sets in a ZIP: they are unpacked, and the temporary files are removed.

use super::*;
use crate::program::running::Running;
use std::io::{BufRead, BufReader, Write};
use std::process::Stdio;
use std::time::{Duration, Instant};
use tempfile::tempdir;
use zip::write::SimpleFileOptions;

pub(super) fn pack<'a>(archive: &Path, files: impl IntoIterator<Item = (String, &'a [u8])>) {
    let mut zip = zip::ZipWriter::new(std::fs::File::create(archive).expect("a file"));
    for (name, bytes) in files {
        zip.start_file(name, SimpleFileOptions::default()).expect("an entry");
        zip.write_all(bytes).expect("packed");
    }
    zip.finish().expect("an archive");
}

/// The program with its own folder for temporary files.
struct Unpacking {
    program: Running,
    temporary: PathBuf,
}

impl Unpacking {
    fn start(arguments: &[&str], temporary: &Path) -> Unpacking {
        std::fs::create_dir_all(temporary).expect("a folder");
        let mut command = program();
        command.args(arguments).env("TMPDIR", temporary).stdout(Stdio::piped()).stderr(Stdio::piped());
        Unpacking { program: Running::start(&mut command), temporary: temporary.to_owned() }
    }

    /// Number of unpacked archives in the folder.
    fn unpacked(&self) -> usize {
        let entries = std::fs::read_dir(&self.temporary).expect("a folder").flatten();
        entries.filter(|entry| entry.path().is_dir()).count()
    }

    /// Interrupts the program and waits. Returns its exit code.
    fn interrupt(mut self) -> Option<i32> {
        self.program.interrupt();
        let code = self.program.wait().expect("it ends").code();
        assert_eq!(self.unpacked(), 0, "something is left");
        code
    }
}

/// A page shows the photos that training has unpacked, and all unpacked files are removed at the end.
#[test]
fn archives_are_unpacked_once_and_removed() {
    let folder = tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    write_dataset(&path("data"));
    let files: Vec<(String, Vec<u8>)> = files_below(&path("data"))
        .into_iter()
        .map(|file| {
            (format!("scene/{}", text(&file)), std::fs::read(path("data").join(file)).expect("a file"))
        })
        .collect();
    pack(&path("data.zip"), files.iter().map(|(name, bytes)| (name.clone(), bytes.as_slice())));
    let (archive, model) = (path("data.zip"), path("model"));
    let train = ["train", "-s", text(&archive), "-m", text(&model), "--iterations", "1000000", "--quiet"];
    for (arguments, code) in
        [(&[&train[..], &["--view=0"]].concat()[..], 130), (&["view", text(&archive), "--port", "0"], 0)]
    {
        let mut running = Unpacking::start(arguments, &path("temporary"));
        let stdout = BufReader::new(running.program.stdout.take().expect("its stdout"));
        let mut lines = stdout.lines().map_while(Result::ok);
        let host = lines
            .find_map(|line| Some(line.strip_prefix("viewer at http://")?.trim_end_matches('/').to_owned()));
        // The page exists before the scene.
        wait_for_scene(&host.unwrap_or_else(|| panic!("{arguments:?}")));
        assert_eq!(running.unpacked(), 1, "{arguments:?}");
        std::thread::spawn(move || lines.for_each(drop));
        assert_eq!(running.interrupt(), Some(code), "{arguments:?}");
    }
}

/// Waits until a viewer's page has a scene to show.
fn wait_for_scene(host: &str) {
    let stream = std::net::TcpStream::connect(host).expect("connected");
    let mut socket = tungstenite::client(format!("ws://{host}/socket"), stream).expect("a WebSocket").0;
    while !socket.read().expect("a message").to_text().is_ok_and(|text| text.contains("\"type\":\"scene\"")) {
    }
}

#[test]
fn archives_are_removed_when_loading_is_interrupted() {
    let folder = tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    // Photos that are slow to decode.
    let (width, height) = (6000, 4000);
    let mut photo = Vec::new();
    let grey = image::GrayImage::new(width, height);
    image::codecs::jpeg::JpegEncoder::new(&mut photo).encode_image(&grey).expect("a JPEG");
    let names: Vec<String> = (0..30).map(|index| format!("{index}.jpg")).collect();
    let frames: Vec<_> = names.iter().enumerate().map(|(index, name)| {
        serde_json::json!({ "file_path": name, "transform_matrix": [[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]] })
    }).collect();
    let transforms =
        serde_json::json!({ "fl_x": 5000, "w": width, "h": height, "frames": frames }).to_string();
    let photos = names.into_iter().map(|name| (name, photo.as_slice()));
    pack(&path("data.zip"), photos.chain([("transforms.json".into(), transforms.as_bytes())]));
    let (archive, model) = (path("data.zip"), path("model"));
    let running = Unpacking::start(
        &["train", "-s", text(&archive), "-m", text(&model), "--iterations", "1000000", "--quiet"],
        &path("temporary"),
    );
    let start = Instant::now();
    while running.unpacked() == 0 {
        assert!(start.elapsed() < Duration::from_secs(120));
        std::thread::sleep(Duration::from_millis(2));
    }
    assert_eq!(running.interrupt(), Some(130));
    assert!(!path("model").exists(), "training had begun");
}
