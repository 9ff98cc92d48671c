//! The names that messages have in C.

use ashsplat::Error;

/// Calls that messages advise, and what these are called here.
#[doc(hidden)]
pub const CALLS: [(&str, &str); 8] = [
    ("Context::new", "ashsplat_context_new"),
    ("DeviceScene::in_context", "ashsplat_scene_in_context"),
    ("DeviceScene::plan_for", "ashsplat_scene_plan"),
    ("HostView::camera", "ashsplat_camera_from_matrices"),
    ("Renderer::reserve", "ashsplat_reserve"),
    ("Trainer::maintain", "ashsplat_trainer_maintain"),
    ("Trainer::reserve_steps", "ashsplat_trainer_reserve"),
    ("Trainer::settle", "ashsplat_trainer_maintain"),
];

/// A message with the names that a caller in C knows.
pub(super) fn said_in_c(error: Error) -> String {
    let error = match error {
        Error::Argument { what, problem } if what == "training steps" => Error::argument("trainer", problem),
        other => other,
    };
    // A field of a reservation.
    let said = error.to_string().replace("Reservation::", "AshsplatReservation.");
    CALLS.iter().fold(said, |said, (rust, c)| said.replace(rust, c))
}
