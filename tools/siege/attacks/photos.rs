//! Requests for photos, which take memory to decode.

use crate::data;
use crate::page::{self, PATIENCE};
use crate::program::Program;
use crate::siege::{Result, Siege, ensure, text};
use std::time::{Duration, Instant};

const REQUESTS: u32 = 40;
/// Most additional memory of these requests, MiB.
const MAX_MEMORY: u64 = 800;
/// Most additional memory of refusals, MiB.
const LITTLE_MEMORY: u64 = 100;

struct Gallery {
    program: Program,
    host: String,
    /// Its memory before the attack, MiB.
    before: u64,
}

/// Size of a photo, pixels.
fn size(siege: &Siege) -> u32 {
    siege.choose(2500, 5000)
}

impl Gallery {
    fn open(siege: &Siege) -> Result<Gallery> {
        let folder = siege.place("large");
        if !folder.exists() {
            data::write_large(&folder, REQUESTS, size(siege))?;
        }
        let mut program = Program::start(siege, &["view", text(&folder)?, "--port", "0"])?;
        let host = program.host()?;
        // The page is served before the photos are.
        drop(page::Page::open(&host)?);
        let before = program.memory();
        Ok(Gallery { program, host, before })
    }

    /// Requests all photos at the same time. Returns the number of answers with each of two codes.
    fn ask_for_all(&self, headers: &str, codes: [u16; 2]) -> Result<[usize; 2]> {
        let host = &self.host;
        let ask = |index: u32| -> Option<u16> {
            page::get(host, &format!("/photo/{index}"), headers, 6 * PATIENCE).ok()
        };
        let (answers, longest) = std::thread::scope(|scope| {
            let asked: Vec<_> = (0..REQUESTS).map(|index| scope.spawn(move || ask(index))).collect();
            // Another page's requests meanwhile.
            let mut longest = Duration::ZERO;
            for _ in 0..5 {
                let start = Instant::now();
                let code = page::get(host, "/main.js", "", PATIENCE)?;
                ensure!(code == 200, "another page is answered with {code}");
                longest = longest.max(start.elapsed());
                std::thread::sleep(Duration::from_millis(100));
            }
            let answers: Vec<_> = asked.into_iter().map(|thread| thread.join().ok().flatten()).collect();
            Result::Ok((answers, longest))
        })?;
        ensure!(longest < PATIENCE, "another page waited for {longest:?}");
        let others = answers.iter().filter(|answer| answer.is_none_or(|code| !codes.contains(&code))).count();
        ensure!(others == 0, "{others} of {REQUESTS} requests have neither of the answers {codes:?}");
        Ok(codes.map(|code| answers.iter().filter(|answer| **answer == Some(code)).count()))
    }

    /// Checks the additional memory, and that a photo is still served.
    fn check(&self, limit: u64) -> Result<u64> {
        let code = page::get(&self.host, "/photo/0", "", 3 * PATIENCE)?;
        ensure!(code == 200, "a photo is answered with {code} afterwards");
        let more = self.program.memory().saturating_sub(self.before);
        ensure!(more <= limit, "takes {more} MiB more, {limit} would be enough");
        Ok(more)
    }
}

pub fn at_once(siege: &Siege) -> Result<String> {
    let gallery = Gallery::open(siege)?;
    let [shown, refused] = gallery.ask_for_all("", [200, 503])?;
    ensure!(shown > 0, "none of the photos is shown");
    let (more, size) = (gallery.check(MAX_MEMORY)?, size(siege));
    Ok(format!(
        "{REQUESTS} of {size}×{size}: {shown} shown, {refused} told to come again, {more} MiB more, another page answered"
    ))
}

/// Requests that any web page can make a browser send.
pub fn foreign(siege: &Siege) -> Result<String> {
    let gallery = Gallery::open(siege)?;
    let headers =
        "Origin: http://elsewhere.example\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Dest: image\r\n";
    let [refused, _] = gallery.ask_for_all(headers, [403, 403])?;
    let more = gallery.program.memory().saturating_sub(gallery.before);
    ensure!(more <= LITTLE_MEMORY, "takes {more} MiB to refuse them");
    gallery.check(MAX_MEMORY)?;
    Ok(format!("{refused} refused, {more} MiB more"))
}
