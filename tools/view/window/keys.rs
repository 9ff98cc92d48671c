//! The keys of the window: the same as on the page. Their names are those of the web standard, which winit shares.

use super::super::protocol::Mode;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// While it is held, moves along the camera's axes: right, down, forward.
    Fly([f64; 3]),
    /// While it is held, turns around the pivot: yaw, pitch.
    Turn([f64; 2]),
    /// While it is held, goes closer (-1) or farther (1).
    Zoom(f64),
    Mode(Mode),
    /// Dragging looks around instead of orbiting.
    FlyMode,
    /// Switches inspection: a click then lists the Gaussians of a pixel.
    Inspect,
    /// Shows or hides the text.
    Panel,
    Screenshot,
    /// Turns to the scene's pivot.
    Face,
    Home,
    /// Previous (-1) or next (1) photo.
    Photo(isize),
    /// Switches a photo's exposure and lens effects on or off in its view.
    PhotoAppearance,
    /// Closes what is open; if nothing is, the window.
    Close,
}

/// The keys that the page has too.
pub const KEYS: [(&str, Action); 36] = [
    ("KeyW", Action::Fly([0.0, 0.0, 1.0])),
    ("KeyS", Action::Fly([0.0, 0.0, -1.0])),
    ("KeyA", Action::Fly([-1.0, 0.0, 0.0])),
    ("KeyD", Action::Fly([1.0, 0.0, 0.0])),
    ("KeyQ", Action::Fly([0.0, 1.0, 0.0])),
    ("KeyE", Action::Fly([0.0, -1.0, 0.0])),
    ("ArrowLeft", Action::Turn([-1.0, 0.0])),
    ("ArrowRight", Action::Turn([1.0, 0.0])),
    ("ArrowUp", Action::Turn([0.0, -1.0])),
    ("ArrowDown", Action::Turn([0.0, 1.0])),
    ("Equal", Action::Zoom(-1.0)),
    ("NumpadAdd", Action::Zoom(-1.0)),
    ("Minus", Action::Zoom(1.0)),
    ("NumpadSubtract", Action::Zoom(1.0)),
    ("Digit1", Action::Mode(Mode::Splats)),
    ("Digit2", Action::Mode(Mode::Centres)),
    ("Digit3", Action::Mode(Mode::Ellipsoids)),
    ("Digit4", Action::Mode(Mode::Depth)),
    ("Digit5", Action::Mode(Mode::Tiles)),
    ("Digit6", Action::Mode(Mode::Normals)),
    ("Numpad1", Action::Mode(Mode::Splats)),
    ("Numpad2", Action::Mode(Mode::Centres)),
    ("Numpad3", Action::Mode(Mode::Ellipsoids)),
    ("Numpad4", Action::Mode(Mode::Depth)),
    ("Numpad5", Action::Mode(Mode::Tiles)),
    ("Numpad6", Action::Mode(Mode::Normals)),
    ("KeyV", Action::FlyMode),
    ("KeyI", Action::Inspect),
    ("KeyH", Action::Panel),
    ("KeyP", Action::Screenshot),
    ("KeyF", Action::Face),
    ("Home", Action::Home),
    ("BracketLeft", Action::Photo(-1)),
    ("BracketRight", Action::Photo(1)),
    ("KeyL", Action::PhotoAppearance),
    ("Escape", Action::Close),
];

/// The list of keys, in the page's words where both have the key; "?" shows it.
pub const HELP: [(&str, &str); 20] = [
    ("left or middle drag", "orbit (look around in fly mode)"),
    ("right, Shift or Shift-middle drag", "pan"),
    ("wheel, Ctrl drag", "closer, farther"),
    ("double click", "turn around what is there"),
    ("Alt click", "inspect a pixel"),
    ("W A S D, Q E", "fly; Shift faster, Alt slower"),
    ("arrows", "orbit"),
    ("+ −", "closer, farther"),
    ("1 … 6", "splats, centres, ellipsoids, depth, tiles, normals"),
    ("V, I", "fly, inspect"),
    ("F, Home", "face the pivot, first view"),
    ("Shift F", "whole screen"),
    ("[ ]", "photo before, after"),
    ("L", "as photographed: the photo's exposure and lens"),
    ("P", "screenshot"),
    ("H", "this text"),
    ("?", "these lines"),
    ("Esc", "close what is open, then the window"),
    ("Ctrl Q", "close the window"),
    ("on the page only", "cameras, films, cuts, edits, the tape, opening files"),
];

pub fn action(code: &str) -> Option<Action> {
    KEYS.iter().find(|(name, _)| *name == code).map(|(_, action)| *action)
}
