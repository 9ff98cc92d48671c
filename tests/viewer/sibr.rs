//! The reference implementation's network viewer and the protocol of its `network_gui.py`.

use super::training::Training;
use super::*;

/// SIBR's remote viewer without a window.
struct Remote(TcpStream);

impl Remote {
    fn connect(training: &Training) -> Remote {
        let said = training.server.said.iter().find_map(|line| line.strip_prefix("network viewer at "));
        let stream = TcpStream::connect(said.expect("its address")).expect("connected");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        Remote(stream)
    }

    /// Sends a message. Returns the picture (if requested) and the path.
    fn ask(&mut self, message: &Value) -> (Vec<u8>, String) {
        let text = message.to_string();
        self.0.write_all(&u32::try_from(text.len()).expect("short").to_le_bytes()).expect("sent");
        self.0.write_all(text.as_bytes()).expect("sent");
        let side = |name: &str| message[name].as_u64().expect("a size") as usize;
        let mut rgb = vec![0; 3 * side("resolution_x") * side("resolution_y")];
        self.0.read_exact(&mut rgb).expect("a picture");
        let mut length = [0; 4];
        self.0.read_exact(&mut length).expect("a length");
        let mut path = vec![0; u32::from_le_bytes(length) as usize];
        self.0.read_exact(&mut path).expect("a path");
        (rgb, String::from_utf8(path).expect("text"))
    }
}

/// Camera in the viewer's format: OpenGL's axes, row vectors.
fn of_camera(camera: &Camera, train: bool) -> Value {
    let (r, t) = (camera.camera_from_world, camera.translation);
    let column = |j: usize| [r.col(j).x, -r.col(j).y, -r.col(j).z, 0.0];
    let matrix = [column(0), column(1), column(2), [t.x, -t.y, -t.z, 1.0]].concat();
    let fov = |size: u32, focal: f32| 2.0 * (0.5 * size as f32 / focal).atan();
    json!({
        "resolution_x": camera.width, "resolution_y": camera.height, "train": train,
        "fov_y": fov(camera.height, camera.fy), "fov_x": fov(camera.width, camera.fx), "z_far": 100.0,
        "z_near": 0.01, "shs_python": false, "rot_scale_python": false, "keep_alive": false,
        "scaling_modifier": 1.0, "view_matrix": matrix, "view_projection_matrix": matrix,
    })
}

#[test]
fn viewer_keeps_no_sibr_waiting_for_silent_clients() {
    let training = Training::start("1000000 --view=0 --ip --host 0.0.0.0 --port 0", "network viewer");
    let silent: Vec<Remote> = (0..40).map(|_| Remote::connect(&training)).collect();
    let start = Instant::now();
    let (rgb, _) = Remote::connect(&training).ask(&of_camera(&camera(0.2), true));
    assert!(!rgb.is_empty() && start.elapsed() < PATIENCE / 2, "{:?}", start.elapsed());
    drop(silent);
    // A viewer that others can reach prints a warning.
    let (_, stderr) = training.server.end();
    assert!(stderr.contains("warning: the network viewer's protocol has no password"), "{stderr}");
}

/// `--ip 0.0.0.0`, as scripts for the reference pass it, admits no other machine without --host.
#[test]
fn viewer_of_sibr_listens_to_this_machine_unless_a_host_is_said() {
    let arguments = "1000000 --view=0 --ip 0.0.0.0 --port 0";
    let training = Training::start(arguments, "network viewer at 127.0.0.1:");
    let (rgb, _) = Remote::connect(&training).ask(&of_camera(&camera(0.2), true));
    assert!(!rgb.is_empty());
    let (_, stderr) = training.server.end();
    let note = "note: the network viewer listens at 127.0.0.1: --host 0.0.0.0 lets others in";
    assert!(stderr.contains(note) && !stderr.contains("warning"), "{stderr}");
}

#[test]
fn viewer_speaks_sibrs_protocol() {
    // Without an address it listens to this machine only.
    let training = Training::start("1000000 --view=0 --ip --port 0", "network viewer");
    let said = training.server.said.last().expect("its address");
    assert!(said.starts_with("network viewer at 127.0.0.1:"), "{said}");
    let mut remote = Remote::connect(&training);
    // Without a size, it returns only the path.
    let mut nothing = of_camera(&camera(0.0), true);
    (nothing["resolution_x"], nothing["resolution_y"]) = (json!(0), json!(0));
    let (rgb, path) = remote.ask(&nothing);
    assert!(rgb.is_empty() && path.ends_with("data"), "{path}");
    // The viewer stops training; then its picture equals the page's.
    let view_of = camera(0.2);
    remote.ask(&of_camera(&view_of, false));
    let mut page = training.server.page();
    let at = page.same();
    let (rgb, _) = remote.ask(&of_camera(&view_of, false));
    let shown = page.look(&view_of, &json!({ "quality": 0 })).rgb();
    let worst = rgb.iter().zip(&shown).map(|(a, b)| a.abs_diff(*b)).max().expect("pixels");
    assert!(worst <= 1, "{worst}");
    assert!(rgb.iter().any(|&v| v > 60), "an empty picture proves nothing");
    let mut smaller = of_camera(&view_of, false);
    smaller["scaling_modifier"] = json!(0.3);
    assert!(remote.ask(&smaller).0 != rgb);
    assert_eq!(page.same(), at);
    // When the viewer disconnects, training continues. An invalid message ends only its connection.
    remote.0.write_all(&[0xFF; 64]).expect("sent");
    assert!(matches!(remote.0.read(&mut [0; 1]), Ok(0) | Err(_)));
    page.pass(at);
    let (again, _) = Remote::connect(&training).ask(&of_camera(&view_of, true));
    assert_eq!(again.len(), rgb.len());
}
