//! Hostile or faulty clients harm neither the program nor other pages.

use super::training::Training;
use super::*;
use ashsplat_files::PhotoFileFormat;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

fn silent(server: &Server, count: usize) -> Vec<TcpStream> {
    (0..count).filter_map(|_| TcpStream::connect(server.host.as_str()).ok()).collect()
}

#[test]
fn viewer_leaves_descriptors_to_a_training() {
    let training = Training::start_within(150);
    let mut page = training.server.page();
    let _silent = silent(&training.server, 600);
    page.act("pause");
    let at = page.rest();
    page.act("save");
    let note = page.wait_for("note");
    assert_eq!(note["message"], format!("saved iteration {at}"));
    // Other clients can still connect.
    assert_eq!(training.server.get("/main.js", &[]).0, 200);
    let mut other = training.server.page();
    assert_eq!(other.status(0)["iteration"].as_u64(), Some(at));
    let Training { place, server } = training;
    let (code, stderr) = server.end();
    assert!(code == Some(130) && !stderr.contains("Too many open files"), "{code:?} {stderr}");
    assert!(place.has(format!("model/chkpnt{at}.safetensors")));
}

#[cfg(target_os = "linux")]
#[test]
fn viewer_decodes_few_photos_at_once() {
    let (place, side) = (Place::empty(), 4000);
    let names: Vec<String> = (0..20).map(|index| format!("{index:02}.png")).collect();
    let rgb = vec![99; (3 * side * side) as usize];
    Photo { width: side, height: side, rgb }.write_png(place.at(&names[0])).expect("a PNG");
    for name in &names[1..] {
        std::fs::hard_link(place.at(&names[0]), place.at(name)).expect("a link");
    }
    place.write("transforms.json", crate::cli::transforms(&names, side));
    let server = Server::view(&place.at(""), &[]);
    let (before, shown) = (server.peak_memory(), AtomicU32::new(0));
    std::thread::scope(|scope| {
        for index in 0..40 {
            let (server, shown) = (&server, &shown);
            let path = format!("/{}/{}", ["photo", "thumbnail"][index % 2], index / 2);
            scope.spawn(move || {
                let (code, head, _) = server.get(&path, &[]);
                assert!([200, 503].contains(&code), "{head}");
                shown.fetch_add(u32::from(code == 200), Ordering::Relaxed);
            });
        }
    });
    let (shown, more) = (shown.into_inner(), server.peak_memory() - before);
    // On a busy machine other requests time out.
    assert!(shown >= 2 && more < 600, "{shown} photos, {more} MiB");
    assert_eq!(server.get("/photo/0", &[]).0, 200);
}

/// Sends as fast as possible and reads nothing, until `over` is set.
fn flood(page: &mut Page, over: &AtomicBool, message: &str) {
    page.socket.get_ref().set_write_timeout(Some(Duration::from_millis(50))).expect("a timeout");
    let mut sent = true;
    while !over.load(Ordering::Relaxed) {
        let result =
            if sent { page.socket.send(tungstenite::Message::text(message)) } else { page.socket.flush() };
        sent = result.is_ok();
        match result {
            Err(tungstenite::Error::Io(e)) if e.kind() == std::io::ErrorKind::WouldBlock => {}
            Err(_) => return,
            Ok(()) => {}
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn viewer_pages_that_flood_starve_none() {
    let (_place, server) = view_ball(200, &[]);
    let mut page = server.page();
    page.look(&camera(0.0), &json!({}));
    let (before, over) = (server.peak_memory(), AtomicBool::new(false));
    let view = view(1, &camera(0.3), &json!({})).to_string();
    std::thread::scope(|scope| {
        for message in [view.as_str(), r#"{"type":"nonsense"}"#, r#"{"type":"ack"}"#] {
            let (server, over) = (&server, &over);
            scope.spawn(move || flood(&mut server.page(), over, message));
        }
        let start = Instant::now();
        let mut longest = Duration::ZERO;
        for turn in 0..20 {
            std::thread::sleep(Duration::from_millis(200));
            let asked = Instant::now();
            page.look(&camera(0.1 * turn as f32), &json!({}));
            longest = longest.max(asked.elapsed());
        }
        let seconds = start.elapsed().as_secs_f64();
        over.store(true, Ordering::Relaxed);
        let more = server.peak_memory() - before;
        assert!(longest < Duration::from_secs(3), "{longest:?}");
        assert!(more < 80, "{more} MiB in {seconds:.1} s");
    });
}

#[test]
fn viewer_answers_while_messages_come() {
    let (_place, server) = view_ball(50, &[]);
    let page = server.page();
    let stream = page.socket.get_ref().try_clone().expect("a stream");
    let role = tungstenite::protocol::Role::Client;
    let mut reader = tungstenite::WebSocket::from_raw_socket(stream, role, None);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let over = &over;
        scope.spawn(move || {
            let mut page = page;
            flood(&mut page, over, r#"{"type":"nonsense"}"#);
        });
        let mut answers = 0;
        while answers < 100 {
            let answer = reader.read().expect("an answer");
            // The server also sends pings.
            if answer.is_ping() {
                continue;
            }
            assert!(answer.to_text().is_ok_and(|text| text.contains("not understood")), "{answer:?}");
            answers += 1;
        }
        over.store(true, Ordering::Relaxed);
    });
}
