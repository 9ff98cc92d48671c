//! Names of calls and arguments in C, for messages.

use ashsplat::Error;

/// Calls that messages advise, and their names in C.
const CALLS: [(&str, &str); 8] = [
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

/// Fields with other names in C.
const FIELDS: [(&str, &str); 5] = [
    ("target.encoding.exposure", "target.exposure"),
    ("target.behind", "target.background"),
    (".selection.mask (buffer 'selection')", ".selection"),
    (".selection.color", ".selection_color"),
    (".selection.share", ".selection_share"),
];

/// Rewrites a message with C names.
pub(super) fn message_in_c(error: Error) -> String {
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
    let message = error.to_string().replace("Reservation::", "AshsplatReservation.");
    CALLS.iter().fold(message, |message, (rust, c)| message.replace(rust, c))
}

/// Rewrites an error of a frame with the parameters' names in C. Most fields have the same name in both languages. In C a pose
/// is no single field, and a selection has several.
pub(super) fn frame_in_c(error: Error) -> Error {
    let named = |what: &str| {
        let what = match what.strip_prefix("views") {
            Some(rest) if rest.is_empty() || rest.starts_with('[') => format!("frames{rest}"),
            _ => what.to_owned(),
        };
        let what = what.strip_suffix(".pose").map(str::to_owned).unwrap_or(what);
        FIELDS.iter().fold(what, |what, (rust, c)| what.replace(rust, c))
    };
    match error {
        Error::Argument { what, problem } => {
            let what = match what.strip_suffix(".volume") {
                Some(cut_out) if problem.starts_with("an offset") => format!("{cut_out}.offset"),
                Some(cut_out) if problem.starts_with("a ") => format!("{cut_out}.size"),
                _ => what,
            };
            // The problem may name other views.
            let problem = problem.replace("views[", "frames[");
            let problem = ["adopted for ", ", not for "]
                .into_iter()
                .fold(problem, |message, words| message.replace(words, &format!("{words}AshsplatImageUse_")));
            Error::argument(named(&what), problem)
        }
        Error::TooLarge { what, needed, unit, limit, limit_name } => {
            Error::TooLarge { what: named(&what), needed, unit, limit, limit_name }
        }
        other => other,
    }
}
