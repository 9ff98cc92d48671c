//! Connections that each cost a descriptor and do nothing. None of them needs the viewer's token.

use crate::page::{self, Page};
use crate::program::Limits;
use crate::siege::{Result, Siege, ensure};
use crate::training::Training;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

pub fn silent(siege: &Siege) -> Result<String> {
    besiege(siege, b"", b"")
}

/// Headers without end, one at a time.
pub fn unfinished(siege: &Siege) -> Result<String> {
    let begin = b"GET /socket HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n";
    besiege(siege, begin, b"X: y\r\n")
}

/// A training with too few descriptors for all connections. Meanwhile it answers its page, saves and finishes.
fn besiege(siege: &Siege, begin: &[u8], more: &[u8]) -> Result<String> {
    let (descriptors, count) = siege.choose((150, 300), (1024, 1060));
    let limits = Limits { descriptors: Some(descriptors), ..Limits::default() };
    let mut training = Training::start(siege, &limits)?;
    let mut page = training.held()?;
    let (mut connections, mut missing) = (Vec::new(), 0);
    for _ in 0..count {
        // Once connections are not accepted any more, further ones change nothing.
        if missing > 10 {
            break;
        }
        let Ok(mut stream) = page::connect(&training.host, Duration::from_millis(300)) else {
            missing += 1;
            continue;
        };
        stream.set_nonblocking(true)?;
        stream.write_all(begin).ok();
        connections.push(stream);
    }
    ensure!(connections.len() > count / 2, "only {} connections came about", connections.len());
    let (stop, count) = (AtomicBool::new(false), connections.len());
    let longest = std::thread::scope(|scope| {
        let stop = &stop;
        scope.spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                connections.iter_mut().for_each(|stream| drop(stream.write_all(more)));
                std::thread::sleep(Duration::from_millis(300));
            }
        });
        let answered = visit(&training.host, &mut page);
        let ended = training.explain(answered).and_then(|longest| {
            page.act("resume")?;
            training.check_end(siege).map(|()| longest)
        });
        stop.store(true, Ordering::Relaxed);
        ended
    })?;
    let longest = longest.as_millis();
    Ok(format!(
        "{count} with {descriptors} descriptors: pages answered within {longest} ms, saved, same bits at the end"
    ))
}

/// The connected page, a new one and a request must be answered. Returns the longest time.
fn visit(host: &str, page: &mut Page) -> Result<Duration> {
    let mut longest = Duration::ZERO;
    let mut timed = |visit: &mut dyn FnMut() -> Result<()>| -> Result<()> {
        let start = Instant::now();
        visit()?;
        longest = longest.max(start.elapsed());
        Ok(())
    };
    timed(&mut || page.look().map(drop))?;
    timed(&mut || {
        page.act("save")?;
        page.wait_for("note").map(drop)
    })?;
    timed(&mut || Page::open(host)?.look().map(drop))?;
    timed(&mut || {
        let code = page::get(host, "/main.js", page::PATIENCE)?;
        ensure!(code == 200, "a page's script is answered with {code}");
        Ok(())
    })?;
    Ok(longest)
}
