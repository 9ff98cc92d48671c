//! For tests: Vulkan calls that fail on demand.
//!
//! [`super::ContextOptions::faults`] counts the calls that may fail ([`super::failing_calls`]). A call is either passed on or
//! answered with an error, like a driver's. Code above cannot tell the difference. The validation layer is below and sees a
//! program that handles the error.

use super::lock::lock;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// A function that fails, and its result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// vkAllocateMemory: out of device memory.
    Allocation,
    /// vkQueueSubmit2: the device is lost and stays lost.
    SubmitLost,
    /// vkWaitForFences: the device is lost and stays lost.
    WaitLost,
    /// vkWaitForFences: timeout.
    Timeout,
    /// vkWaitForFences: out of host memory.
    WaitMemory,
    /// vkQueueSubmit2: a panic instead of an error, for callers that catch panics.
    Panic,
    /// Any other call that may fail (creation, binding, mapping, resetting, recording, submission): out of host memory.
    Object,
}

/// Number of calls of one kind, and which of them fail.
#[derive(Clone, Copy, Debug, Default)]
struct Counter {
    calls: u64,
    /// Index of the first failing call, and the number of failing calls from there.
    fails: Option<(u64, u64)>,
}

#[derive(Default)]
struct State {
    counters: HashMap<Fault, Counter>,
    /// Functions of [`Fault::Object`] in the order of their calls.
    objects: Vec<&'static str>,
    injected: u64,
    lost: bool,
}

/// Which calls of a device fail. Clones share their state.
#[derive(Clone, Default)]
pub struct Faults(Arc<Mutex<State>>);

impl std::fmt::Debug for Faults {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Faults({} injected)", self.injected())
    }
}

impl Faults {
    /// Creates faults that do not fail any call yet.
    pub fn new() -> Self {
        Self::default()
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        f(&mut lock(&self.0))
    }

    /// Makes only the `index`-th call from now on fail, counted from 0.
    pub fn arm(&self, fault: Fault, index: u64) {
        self.arm_many(fault, index, 1);
    }

    /// Same as [`Faults::arm`], but for `count` calls from there on.
    pub fn arm_many(&self, fault: Fault, index: u64, count: u64) {
        self.with(|state| {
            state.objects.clear();
            state.counters.insert(fault, Counter { calls: 0, fails: Some((index, count)) })
        });
    }

    /// Turns all faults off, and restarts the count.
    pub fn disarm(&self) {
        self.with(|state| {
            state.objects.clear();
            state.counters.clear();
        });
    }

    /// Returns the number of calls of a kind since [`Faults::arm`] or [`Faults::disarm`].
    pub fn calls(&self, fault: Fault) -> u64 {
        self.with(|state| state.counters.get(&fault).map_or(0, |counter| counter.calls))
    }

    /// Returns the functions that [`Fault::Object`] counts, in call order, since [`Faults::arm`] or [`Faults::disarm`].
    pub fn objects(&self) -> Vec<&'static str> {
        self.with(|state| state.objects.clone())
    }

    /// Returns the number of failed calls, except those on a lost device.
    pub fn injected(&self) -> u64 {
        self.with(|state| state.injected)
    }

    pub(super) fn strikes(&self, fault: Fault) -> bool {
        self.with(|state| {
            let counter = state.counters.entry(fault).or_default();
            let strikes = counter.fails.is_some_and(|(first, count)| {
                counter.calls.checked_sub(first).is_some_and(|since| since < count)
            });
            counter.calls += 1;
            state.injected += u64::from(strikes);
            state.lost |= strikes && matches!(fault, Fault::SubmitLost | Fault::WaitLost);
            strikes
        })
    }

    /// Counts a call for [`Fault::Object`]. Returns true if it fails.
    pub(super) fn strikes_object(&self, function: &'static str) -> bool {
        self.with(|state| state.objects.push(function));
        self.strikes(Fault::Object)
    }

    pub(super) fn lost(&self) -> bool {
        self.with(|state| state.lost)
    }
}
