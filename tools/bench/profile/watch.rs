//! `--watch`: compiles edited shaders again and prints the changes.

#[cfg(feature = "hot-reload")]
pub use reloading::{run, take_over};

#[cfg(not(feature = "hot-reload"))]
mod missing {
    use super::super::Arguments;
    use crate::frames::Plan;
    use ashsplat::vk::Context;
    use ashsplat::{Error, Result};
    use std::path::Path;

    const PROBLEM: &str =
        "this program was built without it: cargo run --release --features hot-reload -- profile …";

    /// Refuses: this build cannot watch shaders.
    pub fn run(_: &Arguments, _: &Context, _: &Plan) -> Result<()> {
        Err(Error::argument("--watch", PROBLEM))
    }

    /// Refuses: this build cannot compile shaders.
    pub fn take_over(_: &Context, _: &Path) -> Result<()> {
        Err(Error::argument("--glsl", PROBLEM))
    }
}
#[cfg(not(feature = "hot-reload"))]
pub use missing::{run, take_over};

#[cfg(feature = "hot-reload")]
mod reloading {
    use super::super::{Arguments, largest_difference, print_messages, silent_profile, spec};
    use crate::compare::{self, Row};
    use crate::frames::{Plan, PlannedWork};
    use crate::kernels;
    use crate::measure::Measured;
    use crate::schema::KernelResult;
    use crate::traffic::Traffic;
    use ashsplat::kernels::reload;
    use ashsplat::vk::Context;
    use ashsplat::{Error, Result};
    use std::collections::HashMap;
    use std::path::{Path, PathBuf};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::{Duration, Instant, SystemTime};

    const INTERVAL: Duration = Duration::from_millis(100);
    /// Number of iterations of each measurement: few, so that the answer comes at once.
    const FRAMES: u32 = 7;
    const WARMUP: u32 = 1;

    /// Folder of the shaders that the program was built from.
    const OWN_GLSL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../glsl");

    /// Compiles the kernels of a folder and uses those that differ from the program's own.
    pub fn take_over(context: &Context, glsl: &Path) -> Result<()> {
        for own in kernels::all() {
            let spirv = reload::compile(glsl, own.name, context.limits())?;
            if own.spirv_for(context.limits()) != spirv {
                errln!("{}: taken from {}", own.name, glsl.display());
                context.replace_shader(own.name, Some(spirv));
            }
        }
        Ok(())
    }

    /// The files of each kernel with their modification times.
    struct Watched {
        glsl: PathBuf,
        times: HashMap<PathBuf, SystemTime>,
    }

    impl Watched {
        fn new(glsl: PathBuf) -> Self {
            let mut watched = Self { glsl, times: HashMap::new() };
            watched.changed();
            watched
        }

        /// The kernels whose files have changed since the last call.
        fn changed(&mut self) -> Vec<&'static str> {
            let mut newer = Vec::new();
            let mut changed = Vec::new();
            for kernel in spec::kernel_names() {
                for file in reload::files(&self.glsl, kernel) {
                    let Ok(time) = std::fs::metadata(&file).and_then(|m| m.modified()) else { continue };
                    if self.times.get(&file) != Some(&time) {
                        if !changed.contains(&kernel) {
                            changed.push(kernel);
                        }
                        newer.push((file, time));
                    }
                }
            }
            self.times.extend(newer);
            changed
        }
    }

    struct State {
        kernels: Vec<KernelResult>,
        measured: Measured,
        picture: Vec<[f32; 3]>,
    }

    fn measure(arguments: &Arguments, context: &Context, plan: &Plan) -> Result<State> {
        let mut planned = PlannedWork::new(context, plan)?;
        let profile = silent_profile(context);
        planned.warm_up(arguments.warmup.unwrap_or(WARMUP))?;
        let picture = planned.picture()?;
        let timed = (0..arguments.frames.unwrap_or(FRAMES)).map(|_| planned.timed(&profile));
        let measured = Measured { iterations: timed.collect::<Result<_>>()?, ..Measured::default() };
        Ok(State { kernels: measured.kernels(&Traffic::bound(), None), measured, picture })
    }

    /// Runs until Ctrl-C.
    pub fn run(arguments: &Arguments, context: &Context, plan: &Plan) -> Result<()> {
        let glsl = arguments.glsl.clone().unwrap_or_else(|| OWN_GLSL.into());
        if !glsl.is_dir() {
            return Err(Error::input(&glsl, "is no folder of shaders", "give it with --glsl"));
        }
        let interrupted = Arc::new(AtomicBool::new(false));
        let flag = interrupted.clone();
        ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
            .map_err(|e| Error::argument("--watch", format!("cannot listen for Ctrl-C: {e}")))?;
        let mut watched = Watched::new(glsl);
        let mut state = measure(arguments, context, plan)?;
        print_messages(context);
        arguments.device.report_validation(context);
        let wall = state.measured.wall_ms().median;
        outln!(
            "watching {}: {} takes {wall:.2} ms; Ctrl-C ends",
            watched.glsl.display(),
            arguments.what().name()
        );
        let start = Instant::now();
        let over = || arguments.watch_for.is_some_and(|limit| start.elapsed().as_secs_f64() > limit);
        // Edited kernels that are not yet in use. After an edit that did not compile, they wait for the next one.
        let mut changed: Vec<&str> = Vec::new();
        while !interrupted.load(Ordering::Relaxed) && !over() {
            std::thread::sleep(INTERVAL);
            let newer = watched.changed();
            if newer.is_empty() {
                continue;
            }
            changed.retain(|kernel| !newer.contains(kernel));
            changed.extend(newer);
            let seen = Instant::now();
            match recompile(context, &watched.glsl, &changed) {
                Err(error) => outln!("{error}\nthe old kernels stay"),
                Ok(()) => {
                    let new = measure(arguments, context, plan)?;
                    report(arguments, &changed, &state, &new);
                    print_messages(context);
                    arguments.device.report_validation(context);
                    outln!("shown {:.2} s after the edit was seen", seen.elapsed().as_secs_f64());
                    state = new;
                    changed.clear();
                }
            }
        }
        Ok(())
    }

    /// Replaces all kernels or none: with one broken shader, every kernel stays.
    fn recompile(context: &Context, glsl: &Path, kernels: &[&str]) -> Result<(), String> {
        let mut compiled = Vec::new();
        let mut errors = Vec::new();
        for kernel in kernels {
            match reload::compile(glsl, kernel, context.limits()) {
                Ok(spirv) => compiled.push((kernel, spirv)),
                Err(Error::Input { path, problem, .. }) if !problem.contains(':') => {
                    errors.push(format!("{}: {problem}", path.display()));
                }
                Err(Error::Input { problem, .. }) => errors.push(problem),
                Err(error) => errors.push(error.to_string()),
            }
        }
        if !errors.is_empty() {
            errors.dedup();
            return Err(errors.join("\n"));
        }
        for (kernel, spirv) in compiled {
            context.replace_shader(kernel, Some(spirv));
        }
        Ok(())
    }

    fn report(arguments: &Arguments, changed: &[&str], old: &State, new: &State) {
        let mut lines = vec![Row::whole(
            arguments.what().name(),
            "wall",
            old.measured.wall_ms().times(1e3),
            new.measured.wall_ms().times(1e3),
        )];
        let all = compare::kernels(arguments.what().name(), &old.kernels, &new.kernels);
        lines.extend(all.into_iter().filter(|line| changed.contains(&line.kernel.as_str())));
        outln!("\nchanged: {}", changed.join(", "));
        outln!("{}", compare::table(&lines).trim_end());
        let difference = largest_difference(&old.picture, &new.picture);
        outln!("largest difference of the pictures: {difference}");
    }
}
