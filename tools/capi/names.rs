//! Names of calls and arguments in C, for messages.

use ashsplat::Error;

/// Calls that messages advise, and their names in C.
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

/// Arguments with other names in C.
const ARGUMENTS: [(&str, &str); 6] = [
    ("reservation", "wanted"),
    ("buffer 'frame slots'", "block"),
    ("scene extent", "scene_extent"),
    ("initial Gaussians", "point_count"),
    ("inverse-depth gradient", "inverse_depth_gradient"),
    ("picture for LPIPS", "width, height"),
];

/// Rewrites a message with C names.
pub(super) fn said_in_c(error: Error) -> String {
    let error = match error {
        Error::Argument { what, problem } if what == "training steps" => {
            let of_all = problem.starts_with("are ");
            Error::argument("trainer", if of_all { format!("its training steps {problem}") } else { problem })
        }
        Error::Argument { what, problem } => {
            let named = ARGUMENTS.iter().find(|(rust, _)| *rust == what);
            Error::argument(named.map_or(what.as_str(), |(_, c)| c), problem)
        }
        other => other,
    };
    // A field of a reservation.
    let said = error.to_string().replace("Reservation::", "AshsplatReservation.");
    CALLS.iter().fold(said, |said, (rust, c)| said.replace(rust, c))
}
