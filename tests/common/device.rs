//! The device that all tests share, with all checks on.

use ashsplat::vk::{Context, ContextOptions, LimitsOverride, SpecOverride, validation_available};
use std::cell::RefCell;
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// Options for tests that open their own device: validation (if installed) and hazard checks.
///
/// Until it ends, the calling thread is the only one with such a device. The validation layer looks its devices up
/// in a table without a lock ("Occasional crash in GetLayerDataPtr"). A call of one device may crash while another
/// thread creates or destroys a device. The shared device is safe, because the table never moves the first instance
/// and the first device. Hence it is created first.
pub fn options() -> ContextOptions {
    static TURN: Mutex<()> = Mutex::new(());
    thread_local! {
        static MINE: RefCell<Option<MutexGuard<'static, ()>>> = const { RefCell::new(None) };
    }
    context();
    MINE.with_borrow_mut(|mine| {
        mine.get_or_insert_with(|| TURN.lock().unwrap_or_else(PoisonError::into_inner));
    });
    checked()
}

pub fn count_hits() -> SpecOverride {
    SpecOverride { kernel: String::new(), constant: "COUNT_HITS".to_owned(), bits: 1 }
}

fn checked() -> ContextOptions {
    static VALIDATION: OnceLock<bool> = OnceLock::new();
    let validation = *VALIDATION.get_or_init(|| {
        let available = validation_available();
        if !available {
            // If the environment requires validation, a missing layer is an error.
            let required = std::env::var_os("ASHSPLAT_REQUIRE_VALIDATION").is_some();
            assert!(!required, "no Khronos validation layer here; run tools/setup");
            eprintln!("NOTE: no Khronos validation layer here: tests run without it");
        }
        available
    });
    ContextOptions { validation, hazard_check: true, ..ContextOptions::default() }
}

pub fn limited(limits: LimitsOverride) -> Context {
    Context::new(&ContextOptions { limits_override: Some(limits), ..options() }).expect("a device")
}

/// A separate device whose bindings hold no more than these bytes.
pub fn with_range(bytes: u64) -> Context {
    limited(LimitsOverride { max_storage_buffer_range: Some(bytes), ..LimitsOverride::default() })
}

/// Peak bytes of an arena; 0 without it.
pub fn arena_peak(context: &Context, name: &str) -> u64 {
    context.memory().iter().find(|arena| arena.name == name).map_or(0, |arena| arena.peak_bytes)
}

pub fn context() -> &'static Context {
    static CONTEXT: OnceLock<Context> = OnceLock::new();
    CONTEXT.get_or_init(|| Context::new(&checked()).expect("a Vulkan device for the tests"))
}

/// One device for all tests in bounded memory, because building its kernels takes longer than most of the tests.
/// Only one test at a time may use it; see [`options`].
pub struct Bounded(&'static Context);

static BOUNDED: AtomicBool = AtomicBool::new(false);

pub fn bounded(max_memory: Option<u64>) -> Bounded {
    static CONTEXT: OnceLock<Context> = OnceLock::new();
    let options = options();
    let context = CONTEXT.get_or_init(|| Context::new(&options).expect("a device"));
    assert!(!BOUNDED.swap(true, Relaxed), "drop the one before");
    context.free_staging();
    assert_eq!(context.memory_total().bytes, 0, "left by the work before");
    context.reset_memory_peaks();
    context.set_max_memory(max_memory);
    context.set_offload(None);
    Bounded(context)
}

/// The smallest ring for transfers.
const MIN_RING_BYTES: u64 = 1 << 18;

/// Bytes that the budget reserves for the staging ring of a discrete GPU. The ring may be unallocated.
pub fn kept_for_transfers(context: &Context) -> u64 {
    if context.transfers().reads_directly { 0 } else { MIN_RING_BYTES }
}

/// Peak of bytes in use, with a discrete GPU's staging ring counted at its minimum: the number that plans predict.
pub fn planned_peak(context: &Context) -> u64 {
    let arenas = context.memory();
    let ring = arenas.iter().find(|arena| arena.name == "staging").map_or(0, |arena| arena.peak_bytes);
    context.memory_total().peak_bytes - ring.saturating_sub(MIN_RING_BYTES)
}

/// Fails unless the peak reached all of `bytes` and no more.
pub fn assert_uses_all(context: &Context, bytes: u64) {
    let (peak, kept) = (context.memory_total().peak_bytes, kept_for_transfers(context));
    assert!(peak <= bytes && peak + kept >= bytes, "all of {bytes}, and no more: {peak}");
}

impl Deref for Bounded {
    type Target = Context;

    fn deref(&self) -> &Context {
        self.0
    }
}

impl Drop for Bounded {
    fn drop(&mut self) {
        BOUNDED.store(false, Relaxed);
        if !std::thread::panicking() {
            assert_silent(self.0);
        }
    }
}

#[track_caller]
pub fn assert_silent(context: &Context) {
    let messages = context.validation_messages();
    assert!(messages.is_empty(), "validation messages:\n{}", messages.join("\n"));
}
