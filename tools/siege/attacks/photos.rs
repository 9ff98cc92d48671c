//! Requests for photos, which take memory to decode.

use crate::data;
use crate::page::{self, PATIENCE};
use crate::program::Program;
use crate::siege::{Result, Siege, ensure, text};
use std::time::{Duration, Instant};

const REQUESTS: u32 = 40;
/// Most additional memory of these requests, MiB.
const MAX_MEMORY: u64 = 800;

/// Requests all photos at the same time. Each is shown, or told to come again, and another page is answered meanwhile.
pub fn at_once(siege: &Siege) -> Result<String> {
    let side_px = siege.choose(2500, 5000);
    let folder = siege.place("large");
    data::write_large(&folder, REQUESTS, side_px)?;
    let mut program = Program::start(siege, &["view", text(&folder)?, "--port", "0"])?;
    let host = &program.host()?;
    // The page is served before the photos are.
    drop(page::Page::open(host)?);
    let before = program.memory();
    let ask = |index: u32| page::get(host, &format!("/photo/{index}"), 6 * PATIENCE).ok();
    let (answers, longest) = std::thread::scope(|scope| {
        let asked: Vec<_> = (0..REQUESTS).map(|index| scope.spawn(move || ask(index))).collect();
        let mut longest = Duration::ZERO;
        for _ in 0..5 {
            let start = Instant::now();
            let code = page::get(host, "/main.js", PATIENCE)?;
            ensure!(code == 200, "another page is answered with {code}");
            longest = longest.max(start.elapsed());
            std::thread::sleep(Duration::from_millis(100));
        }
        let answers: Vec<_> = asked.into_iter().map(|thread| thread.join().ok().flatten()).collect();
        Result::Ok((answers, longest))
    })?;
    ensure!(longest < PATIENCE, "another page waited for {longest:?}");
    let [shown, refused] = [200, 503].map(|code| answers.iter().filter(|&&own| own == Some(code)).count());
    let others = answers.len() - shown - refused;
    ensure!(others == 0, "{others} of {REQUESTS} photos are neither shown nor told to come again");
    ensure!(shown > 0, "none of the photos is shown");
    let code = page::get(host, "/photo/0", 3 * PATIENCE)?;
    ensure!(code == 200, "a photo is answered with {code} afterwards");
    let more = program.memory().saturating_sub(before);
    ensure!(more <= MAX_MEMORY, "takes {more} MiB more, {MAX_MEMORY} would be enough");
    Ok(format!(
        "{REQUESTS} of {side_px}×{side_px}: {shown} shown, {refused} told to come again, {more} MiB more, another page answered"
    ))
}
