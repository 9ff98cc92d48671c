//! Messages as fast as possible, by clients that read no answers.

use crate::page::{self, PATIENCE, Page};
use crate::program::Limits;
use crate::siege::{Result, Siege, ensure};
use crate::training::Training;
use serde_json::json;
use std::io::{ErrorKind, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Most memory that a flood may take, MiB.
const MAX_MEMORY: u64 = 80;

/// Sends a message repeatedly, as fast as possible, until stopped or cut off.
fn flood(mut stream: &TcpStream, message: &[u8], over: &AtomicBool, sent: &AtomicU64) {
    // About as much as a socket takes at once.
    let messages = message.repeat(1 + (64 << 10) / message.len());
    if stream.set_write_timeout(Some(Duration::from_millis(50))).is_err() {
        return;
    }
    let mut rest = messages.as_slice();
    while !over.load(Ordering::Relaxed) {
        match stream.write(rest) {
            Ok(0) => return,
            Ok(bytes) => {
                sent.fetch_add(bytes as u64, Ordering::Relaxed);
                rest = &rest[bytes..];
                if rest.is_empty() {
                    rest = &messages;
                }
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return,
        }
    }
}

/// Pages flood a training, each with one of the messages. Meanwhile, another page gets its pictures; then training runs to its end.
pub fn pages(siege: &Siege) -> Result<String> {
    let messages = [
        json!({ "type": "nonsense" }),
        json!({ "type": "status", "since": 0 }),
        json!({ "type": "ack" }),
        page::view(),
        json!({ "type": "train", "action": "pause" }),
    ];
    let messages = messages.map(|message| page::frame(&message.to_string()));
    let seconds = Duration::from_secs(siege.choose(2, 30));
    let mut training = Training::start(siege, &Limits::default())?;
    let host = training.host.clone();
    let mut page = training.held()?;
    page.look()?;
    let before = training.program.memory();
    let (over, sent) = (AtomicBool::new(false), AtomicU64::new(0));
    let looked = std::thread::scope(|scope| {
        for message in &messages {
            let (host, over, sent) = (&host, &over, &sent);
            scope.spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    if let Ok(stream) = Page::open(host).and_then(|page| page.stream()) {
                        flood(&stream, message, over, sent);
                    }
                    std::thread::sleep(Duration::from_millis(10));
                }
            });
        }
        let looked = look_on(&mut page, seconds);
        // Training must finish during the attack. Flooding pages may pause it again, so resume is sent repeatedly.
        let ended = training.explain(looked).and_then(|looked| {
            let start = Instant::now();
            while training.program.runs() && page.act("resume").is_ok() {
                ensure!(start.elapsed() < 6 * PATIENCE, "training does not go on");
                if start.elapsed() > PATIENCE / 5 {
                    over.store(true, Ordering::Relaxed);
                }
                std::thread::sleep(Duration::from_millis(50));
            }
            training.check_end(siege).map(|()| looked)
        });
        over.store(true, Ordering::Relaxed);
        ended
    })?;
    let more = siege.peak_mib().saturating_sub(before);
    let (frames, longest) = (looked.0, looked.1.as_millis());
    ensure!(more <= MAX_MEMORY, "takes {more} MiB more, {MAX_MEMORY} would be enough");
    let sent = sent.into_inner() >> 20;
    Ok(format!(
        "{seconds:?}, {sent} MiB heard, {more} MiB more; another page got {frames} pictures, each within {longest} ms; \
         same bits at the end"
    ))
}

/// Another page's pictures: their number, and the longest time.
fn look_on(page: &mut Page, seconds: Duration) -> Result<(u32, Duration)> {
    let (start, mut frames, mut longest) = (Instant::now(), 0, Duration::ZERO);
    while start.elapsed() < seconds {
        longest = longest.max(page.look()?);
        frames += 1;
        std::thread::sleep(Duration::from_millis(100));
    }
    Ok((frames, longest))
}
