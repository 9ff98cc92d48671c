//! The device that all tests share, with every check on.

use ashsplat::vk::{Context, ContextOptions, SpecOverride, validation_available};
use std::cell::RefCell;
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// Options for tests that open a device of their own: validation (where installed) and hazard checks.
///
/// From now on the calling thread, and so its test, is the only one with such a device, until it ends. The layer looks
/// its devices up in a table without a lock (known to its authors as "Occasional crash in GetLayerDataPtr"): a call of one
/// device crashes now and then while another thread's device comes or goes. The shared device is spared: the first
/// instance and the first device have places of their own in that table, which do not move; hence it comes first.
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

/// Has blending kernels count what they compute.
pub fn count_hits() -> SpecOverride {
    SpecOverride { kernel: String::new(), constant: "COUNT_HITS".to_owned(), bits: 1 }
}

/// Validation, where it is installed, and hazard checks.
fn checked() -> ContextOptions {
    static VALIDATION: OnceLock<bool> = OnceLock::new();
    let validation = *VALIDATION.get_or_init(|| {
        let available = validation_available();
        if !available {
            // Where everything must be checked, a missing layer is no excuse.
            let required = std::env::var_os("ASHSPLAT_REQUIRE_VALIDATION").is_some();
            assert!(!required, "no Khronos validation layer here; run tools/setup");
            eprintln!("NOTE: no Khronos validation layer here: tests run without it");
        }
        available
    });
    ContextOptions { validation, hazard_check: true, ..ContextOptions::default() }
}

/// The device that tests share.
pub fn context() -> &'static Context {
    static CONTEXT: OnceLock<Context> = OnceLock::new();
    CONTEXT.get_or_init(|| Context::new(&checked()).expect("a Vulkan device for the tests"))
}

/// A device for work in bounded memory, the same for all tests: building its kernels anew takes longer than most of that work.
/// Whoever has it is the only one, and has nothing else on it; see [`options`].
pub struct Bounded(&'static Context);

static BOUNDED: AtomicBool = AtomicBool::new(false);

/// That device with this bound.
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
const LEAST_RING_BYTES: u64 = 1 << 18;

/// Bytes that are kept for a card's ring, which it need not have taken.
pub fn kept_for_transfers(context: &Context) -> u64 {
    if context.transfers().reads_directly { 0 } else { LEAST_RING_BYTES }
}

/// The most bytes that were used, with the least that transfers need in place of a card's ring, which makes room: what plans count.
pub fn planned_peak(context: &Context) -> u64 {
    let arenas = context.memory();
    let ring = arenas.iter().find(|arena| arena.name == "staging").map_or(0, |arena| arena.peak_bytes);
    context.memory_total().peak_bytes - ring.saturating_sub(LEAST_RING_BYTES)
}

/// Fails unless all of this memory was used at some time, and no more.
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

/// Fails if the validation layers have said anything.
#[track_caller]
pub fn assert_silent(context: &Context) {
    let messages = context.validation_messages();
    assert!(messages.is_empty(), "validation messages:\n{}", messages.join("\n"));
}
