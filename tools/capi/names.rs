//! The names that messages have in C.

use ashsplat::Error;

/// What messages call arguments, and what these are called here.
const ARGUMENTS: [(&str, &str); 4] = [
    ("command buffer", "commands"),
    ("frame slot", "slot"),
    ("step slot", "slot"),
    ("training steps", "trainer"),
];

/// Calls that messages advise, and what these are called here.
#[doc(hidden)]
pub const CALLS: [(&str, &str); 6] = [
    ("Context::new", "ashsplat_context_new"),
    ("DeviceScene::plan_for", "ashsplat_scene_plan"),
    ("Renderer::reserve", "ashsplat_reserve"),
    ("Trainer::maintain", "ashsplat_trainer_maintain"),
    ("Trainer::reserve_steps", "ashsplat_trainer_reserve"),
    ("Trainer::settle", "ashsplat_trainer_maintain"),
];

/// A message with the names that a caller in C knows.
pub(super) fn said_in_c(error: Error) -> String {
    let error = match error {
        Error::Argument { what, problem } => {
            let own = ARGUMENTS.iter().find(|(rust, _)| *rust == what).map(|(_, c)| (*c).to_owned());
            Error::argument(own.unwrap_or(what), problem)
        }
        other => other,
    };
    // Longer names first: one may begin another.
    let mut calls = CALLS;
    calls.sort_by_key(|(rust, _)| std::cmp::Reverse(rust.len()));
    calls.iter().fold(error.to_string(), |said, (rust, c)| said.replace(rust, c))
}
