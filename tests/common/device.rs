//! The device that all tests share, with every check on.

use ashsplat::vk::{Context, ContextOptions, validation_available};
use std::sync::OnceLock;

/// Options for tests: validation (where installed) and hazard checks.
pub fn options() -> ContextOptions {
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
    CONTEXT.get_or_init(|| Context::new(&options()).expect("a Vulkan device for the tests"))
}

/// Fails if the validation layers have said anything.
#[track_caller]
pub fn assert_silent(context: &Context) {
    let messages = context.validation_messages();
    assert!(messages.is_empty(), "validation messages:\n{}", messages.join("\n"));
}
