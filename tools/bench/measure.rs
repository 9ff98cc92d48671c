//! Runs a workload repeatedly and splits its time.

use super::schema::{Arena, ArithmeticRate, CopyBandwidth, KernelResult, Run, Split, Spread, Workload};
use super::traffic::Traffic;
use ashsplat::Result;
use ashsplat::passes::arithmetic::Arithmetic;
use ashsplat::vk::{Context, MemoryKind, Profile, Submission};
use ashsplat_program::measure::process_seconds;
use std::time::{Duration, Instant};

#[derive(Clone, Copy)]
pub struct Iterations {
    pub measured: u32,
    pub warmup: u32,
    /// True if every second iteration is timed command by command.
    pub timed: bool,
}

pub struct Iteration {
    pub begun: Instant,
    pub wall: Duration,
    pub submissions: Vec<Submission>,
}

impl Iteration {
    pub fn timed(
        context: &Context,
        profile: &Profile,
        iterate: impl FnOnce() -> Result<()>,
    ) -> Result<Iteration> {
        context.set_profile(Some(profile));
        profile.take();
        let begun = Instant::now();
        iterate()?;
        let wall = begun.elapsed();
        context.set_profile(None);
        Ok(Iteration { begun, wall, submissions: profile.take() })
    }
}

#[derive(Default)]
pub struct Measured {
    /// Iterations with every command timed.
    pub iterations: Vec<Iteration>,
    /// Wall time of untimed iterations.
    pub untimed_ms: Option<Spread>,
    /// Processor seconds of untimed iterations.
    pub cpu_seconds: Option<Spread>,
}

/// Runs `iterate` with and without timestamps in turn, each after an uncounted `prepare`. Memory peaks start anew, so
/// [`Measured::run`] reports this workload's own.
pub fn measure(
    context: &Context,
    iterations: Iterations,
    mut prepare: impl FnMut() -> Result<()>,
    mut iterate: impl FnMut() -> Result<()>,
) -> Result<Measured> {
    context.reset_memory_peaks();
    for _ in 0..iterations.warmup {
        prepare()?;
        iterate()?;
    }
    let profile = context.profile();
    // The profile's own memory is allocated here, so that it is not measured.
    prepare()?;
    iterate()?;
    context.set_profile(None);
    let (mut timed, mut untimed_ms, mut cpu) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..iterations.measured.max(1) {
        context.set_timestamps(false);
        prepare()?;
        let (begun, cpu_begun) = (Instant::now(), process_seconds());
        iterate()?;
        untimed_ms.push(begun.elapsed().as_secs_f64() * 1e3);
        cpu.push(cpu_begun.zip(process_seconds()).map(|(before, now)| now - before));
        context.set_timestamps(iterations.timed);
        prepare()?;
        timed.push(Iteration::timed(context, &profile, &mut iterate)?);
        context.set_timestamps(true);
    }
    Ok(Measured {
        iterations: timed,
        untimed_ms: Spread::of(untimed_ms),
        cpu_seconds: cpu.into_iter().collect::<Option<Vec<_>>>().and_then(Spread::of),
    })
}

impl Measured {
    pub fn run(
        &self,
        context: &Context,
        name: &str,
        workload: Workload,
        (traffic, copy): (&Traffic, Option<&CopyBandwidth>),
    ) -> Run {
        Run {
            name: name.to_owned(),
            workload,
            iterations: self.iterations.len() as u32,
            wall_ms: self.wall_ms(),
            device_ms: self.device_ms(),
            split: self.split(),
            between_submissions_ms: self.between_submissions_ms(),
            untimed_ms: self.untimed_ms,
            cpu_seconds: self.cpu_seconds,
            kernels: self.kernels(traffic, copy),
            memory: memory(context),
        }
    }

    /// Wall time per iteration.
    pub fn wall_ms(&self) -> Spread {
        self.spread(|iteration| Some(iteration.wall.as_secs_f64() * 1e3)).unwrap_or_default()
    }

    pub fn device_ms(&self) -> Option<Spread> {
        self.spread(|iteration| {
            iteration.submissions.iter().map(|s| s.nanoseconds.map(|ns| ns * 1e-6)).sum::<Option<f64>>()
        })
    }

    /// Host time between the submissions of an iteration; none if there is only one.
    pub fn between_submissions_ms(&self) -> Option<Spread> {
        self.spread(|iteration| {
            let pairs = iteration.submissions.windows(2);
            let gaps = pairs.map(|pair| (pair[1].submitted - pair[0].done).as_secs_f64() * 1e3);
            (iteration.submissions.len() > 1).then(|| gaps.sum())
        })
    }

    fn spread(&self, of: impl Fn(&Iteration) -> Option<f64>) -> Option<Spread> {
        Spread::of(self.iterations.iter().map(of).collect::<Option<Vec<_>>>()?)
    }

    /// Means of the parts of an iteration's wall time.
    pub fn split(&self) -> Split {
        let n = self.iterations.len().max(1) as f64;
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3 / n;
        let mut split = Split { kernels_ms: Some(0.0), ..Split::default() };
        let mut in_submissions = 0.0;
        for iteration in &self.iterations {
            split.wall_ms += ms(iteration.wall);
            for s in &iteration.submissions {
                let device: Option<f64> = s.commands.iter().map(|c| c.nanoseconds).sum();
                let device = device.map(|ns| ns * 1e-6 / n);
                split.kernels_ms = split.kernels_ms.zip(device).map(|(sum, device)| sum + device);
                split.recording_ms += ms(s.submitting - s.begun);
                // Work that a driver executes while it takes a submission counts as the device's time.
                let taking = ms(s.submitted - s.submitting);
                let waiting = ms(s.done - s.submitted) - device.unwrap_or(0.0);
                split.submitting_ms += taking + waiting.min(0.0);
                split.waiting_ms += waiting.max(0.0);
                in_submissions += ms(s.done - s.begun);
            }
        }
        split.host_ms = split.wall_ms - in_submissions;
        split
    }

    /// Every kernel of every scope, in the order of the first iteration.
    pub fn kernels(&self, traffic: &Traffic, copy: Option<&CopyBandwidth>) -> Vec<KernelResult> {
        let mut found: Vec<KernelResult> = Vec::new();
        for command in self.iterations.first().into_iter().flat_map(commands) {
            let place = found.iter().position(|k| (k.scope.as_str(), k.kernel.as_str()) == key(command));
            let (read, written) = traffic.of(command, place.is_none());
            let groups = command.workgroups.map(|g| g.iter().map(|&n| u64::from(n)).product::<u64>());
            match place {
                Some(place) => {
                    let kernel = &mut found[place];
                    kernel.calls += 1;
                    kernel.workgroups = kernel.workgroups.zip(groups).map(|(sum, groups)| sum + groups);
                    kernel.bytes_read += read;
                    kernel.bytes_written += written;
                }
                None => found.push(KernelResult {
                    scope: command.scope.to_owned(),
                    kernel: command.name.to_owned(),
                    calls: 1,
                    workgroups: groups,
                    bytes_read: read,
                    bytes_written: written,
                    ..KernelResult::default()
                }),
            }
        }
        for kernel in &mut found {
            let time = |iteration: &Iteration| {
                let own = commands(iteration).filter(|c| key(c) == (&kernel.scope, &kernel.kernel));
                own.map(|c| c.nanoseconds.map(|ns| ns * 1e-3)).sum::<Option<f64>>()
            };
            kernel.time_us = self.spread(time);
            let bytes = (kernel.bytes_read + kernel.bytes_written) as f64;
            let positive = kernel.time_us.filter(|time| time.median > 0.0);
            kernel.gigabytes_per_second = positive.map(|time| bytes / time.median * 1e-3);
            kernel.share_of_copy_bandwidth =
                kernel.gigabytes_per_second.zip(copy).map(|(rate, copy)| rate / copy.gigabytes_per_second);
        }
        found
    }
}

pub fn commands(iteration: &Iteration) -> impl Iterator<Item = &ashsplat::vk::CommandRecord> {
    iteration.submissions.iter().flat_map(|submission| &submission.commands)
}

fn key(command: &ashsplat::vk::CommandRecord) -> (&str, &str) {
    (command.scope, command.name)
}

/// Best rates of the device, measured in the same run.
pub struct Yardsticks {
    pub copy: Option<CopyBandwidth>,
    pub arithmetic: Option<ArithmeticRate>,
}

impl Yardsticks {
    pub fn measure(context: &Context) -> Result<Self> {
        Ok(Self { copy: copy_bandwidth(context)?, arithmetic: arithmetic_rate(context)? })
    }
}

/// Size of the copied buffers, if the device allows it: larger than any cache.
const COPY_BYTES: u64 = 64 << 20;
const COPIES: u32 = 9;

/// Times of submissions with one command each, and their clock. That is the device's if it has timestamps, otherwise the
/// host's, from submission until the host knows that all is done.
fn single_commands(submissions: &[Submission]) -> Option<(Spread, String)> {
    let device = |s: &Submission| Some(s.commands.first()?.nanoseconds? * 1e-6);
    let host = |s: &Submission| (s.done - s.submitting).as_secs_f64() * 1e3;
    let of_device = submissions.iter().map(device).collect::<Option<Vec<f64>>>();
    let (times, clock) = match of_device {
        Some(times) => (times, "timestamps"),
        None => (submissions.iter().map(host).collect(), "host"),
    };
    Spread::of(times).filter(|time| time.min > 0.0).map(|time| (time, clock.to_owned()))
}

/// Measures `vkCmdCopyBuffer`; none if the clock did not move.
pub fn copy_bandwidth(context: &Context) -> Result<Option<CopyBandwidth>> {
    let limits = context.limits();
    let bytes = COPY_BYTES.min(limits.max_storage_buffer_range).min(limits.max_allocation_bytes) / 256 * 256;
    let requests = [("copy_source", bytes), ("copy_destination", bytes)];
    let buffers = context.allocate("copy", &requests, MemoryKind::Device)?;
    let copy = || context.run("copy", |r| r.copy(&buffers[0], &buffers[1]));
    context.run("fill", |r| buffers.iter().for_each(|buffer| r.fill(buffer, 1)))?;
    copy()?;
    let profile = context.profile();
    for _ in 0..COPIES {
        copy()?;
    }
    Ok(single_commands(&profile.take()).map(|(time_ms, clock)| CopyBandwidth {
        bytes,
        gigabytes_per_second: 2.0 * bytes as f64 / time_ms.median * 1e-6,
        time_ms,
        clock,
    }))
}

const ARITHMETIC_RUNS: u32 = 3;

/// Measures multiply-adds on registers; none if the clock did not move.
fn arithmetic_rate(context: &Context) -> Result<Option<ArithmeticRate>> {
    let arithmetic = Arithmetic::new(context)?;
    // Many times a large device's lanes, or about 30 ms on a processor.
    let count = if context.limits().tuning.is_slow { 1 << 15 } else { 1 << 20 };
    let results = context.allocate("arithmetic", &[("results", 4 * count)], MemoryKind::Device)?;
    let run = || context.run("arithmetic", |r| arithmetic.record(r, &results[0]));
    run()?;
    let profile = context.profile();
    for _ in 0..ARITHMETIC_RUNS {
        run()?;
    }
    let operations = arithmetic.operations(count);
    Ok(single_commands(&profile.take()).map(|(time_ms, clock)| ArithmeticRate {
        operations,
        gigaoperations_per_second: operations as f64 / time_ms.min * 1e-6,
        time_ms,
        clock,
    }))
}

/// The arenas of a context, with the peak of each since the measurement began.
fn memory(context: &Context) -> Vec<Arena> {
    let arenas =
        context.memory().into_iter().filter(|arena| !["copy", "arithmetic", "profile"].contains(&arena.name));
    arenas.map(|arena| Arena { name: arena.name.to_owned(), peak_bytes: arena.peak_bytes }).collect()
}
