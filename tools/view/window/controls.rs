//! Mouse and held keys: the same as `web/controls.js` on the page. Lengths are logical pixels.

use super::keys::Action;
use super::navigation::Navigation;
use glam::{DVec2, DVec3};
use std::time::{Duration, Instant};

/// Radians per pixel.
const TURN: f64 = 0.006;
/// Share of that while looking around.
const LOOK: f64 = 0.6;
/// Movement below this is a click, pixels.
const CLICK: f64 = 4.0;
/// A second click is a double click within this time and distance (pixels).
const DOUBLE: Duration = Duration::from_millis(400);
const DOUBLE_DISTANCE: f64 = 12.0;
/// Pixels of a wheel's notch, as in browsers, and the most that counts at once.
pub const NOTCH: f64 = 100.0;
const MAX_WHEEL: f64 = 240.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Button {
    Left,
    Middle,
    Right,
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Modifiers {
    pub shift: bool,
    pub control: bool,
    pub alt: bool,
}

/// A press and release without movement in between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Click {
    Single([f64; 2]),
    Double([f64; 2]),
}

#[derive(Default)]
pub struct Controls {
    pub flying: bool,
    pub modifiers: Modifiers,
    /// Held keys that steer.
    held: Vec<Action>,
    /// Time when they last steered.
    steered: Option<Instant>,
    pressed: Vec<Button>,
    /// Position of the pointer.
    pub at: [f64; 2],
    moved: f64,
    clicked: Option<(Instant, [f64; 2])>,
}

impl Controls {
    /// Moves the pointer without any effect.
    pub fn place(&mut self, at: [f64; 2]) {
        self.at = at;
    }

    /// True while the view is moved.
    pub fn is_busy(&self) -> bool {
        !self.held.is_empty() || !self.pressed.is_empty() && self.moved >= CLICK
    }

    /// Releases everything: the window has lost the keyboard.
    pub fn forget(&mut self) {
        self.held.clear();
        self.pressed.clear();
    }

    pub fn press(&mut self, button: Button) {
        if self.pressed.is_empty() {
            self.moved = 0.0;
        }
        self.pressed.push(button);
    }

    /// Releases a button. Returns the click, if it was one.
    pub fn release(&mut self, button: Button, now: Instant) -> Option<Click> {
        let was_pressed = self.pressed.contains(&button);
        self.pressed.retain(|pressed| *pressed != button);
        if !was_pressed || self.moved >= CLICK || button != Button::Left {
            return None;
        }
        let near = |at: [f64; 2]| DVec2::from(at).distance(self.at.into()) < DOUBLE_DISTANCE;
        match self.clicked.take() {
            Some((time, at)) if now.duration_since(time) < DOUBLE && near(at) => Some(Click::Double(self.at)),
            _ => {
                self.clicked = Some((now, self.at));
                Some(Click::Single(self.at))
            }
        }
    }

    /// Moves the pointer over a picture of this height. True if that moved the view.
    pub fn drag(&mut self, to: [f64; 2], height: f64, view: &mut Navigation) -> bool {
        let [dx, dy] = [to[0] - self.at[0], to[1] - self.at[1]];
        self.at = to;
        if self.pressed.is_empty() {
            return false;
        }
        self.moved += dx.abs() + dy.abs();
        if self.moved < CLICK {
            return false;
        }
        if self.pressed.contains(&Button::Right) || self.modifiers.shift {
            view.pan(dx, dy, height);
        } else if self.modifiers.control {
            view.dolly((dy * 0.008).exp());
        } else if self.flying {
            view.look(-dx * TURN * LOOK, -dy * TURN * LOOK);
        } else {
            view.orbit(-dx * TURN, -dy * TURN);
        }
        true
    }

    /// Turns the wheel by pixels; down is positive.
    pub fn wheel(&self, pixels: f64, view: &mut Navigation) {
        let amount = pixels.clamp(-MAX_WHEEL, MAX_WHEEL);
        match self.flying {
            true => view.fly(DVec3::Z * (-amount * 0.001 * view.radius)),
            false => view.dolly((amount * 0.0012).exp()),
        }
    }

    /// Presses a key that steers. Even a short press counts.
    pub fn hold(&mut self, action: Action, now: Instant, view: &mut Navigation) {
        if self.held.contains(&action) {
            return;
        }
        if self.held.is_empty() {
            self.steered = Some(now);
        }
        self.held.push(action);
        self.steer(1.0 / 60.0, view);
    }

    pub fn let_go(&mut self, action: Action) {
        self.held.retain(|held| *held != action);
    }

    /// Steers by the held keys, once per frame. True if any key is held.
    pub fn tick(&mut self, now: Instant, view: &mut Navigation) -> bool {
        let seconds = self.steered.map_or(0.0, |then| now.duration_since(then).as_secs_f64());
        self.steered = Some(now);
        if self.held.is_empty() {
            return false;
        }
        self.steer(seconds.min(0.1), view);
        true
    }

    fn steer(&self, seconds: f64, view: &mut Navigation) {
        let speed = match self.modifiers {
            Modifiers { shift: true, .. } => 4.0,
            Modifiers { alt: true, .. } => 0.2,
            _ => 1.0,
        };
        let stride = seconds * speed * 0.6 * view.radius;
        let mut moved = DVec3::ZERO;
        for action in &self.held {
            match *action {
                Action::Fly(along) => moved += DVec3::from_array(along) * stride,
                Action::Turn([yaw, pitch]) => view.orbit(yaw * seconds * speed, pitch * seconds * speed),
                Action::Zoom(sign) => view.dolly((sign * seconds * speed).exp()),
                _ => {}
            }
        }
        if moved != DVec3::ZERO {
            view.fly(moved);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> Navigation {
        Navigation::new(DVec3::ZERO, DVec3::NEG_Y, 2.0)
    }

    #[test]
    fn clicks_are_no_drags() {
        let (mut controls, mut view, start) = (Controls::default(), view(), Instant::now());
        controls.drag([10.0, 10.0], 100.0, &mut view);
        let click = |controls: &mut Controls, after| {
            controls.press(Button::Left);
            controls.release(Button::Left, start + Duration::from_millis(after))
        };
        assert_eq!(click(&mut controls, 0), Some(Click::Single([10.0; 2])));
        assert_eq!(click(&mut controls, 200), Some(Click::Double([10.0; 2])));
        assert_eq!(click(&mut controls, 300), Some(Click::Single([10.0; 2])), "a third one is a first");
        assert_eq!(click(&mut controls, 900), Some(Click::Single([10.0; 2])), "too late");
        let before = view.position;
        controls.press(Button::Left);
        assert!(!controls.drag([12.0, 10.0], 100.0, &mut view) && !controls.is_busy());
        assert!(controls.drag([30.0, 10.0], 100.0, &mut view) && controls.is_busy());
        assert_eq!(controls.release(Button::Left, start), None);
        assert!(before != view.position && (view.position.length() - 2.0).abs() < 1e-9, "an orbit");
    }

    #[test]
    fn keys_steer_while_they_are_held() {
        let (mut controls, mut view, start) = (Controls::default(), view(), Instant::now());
        let forward = Action::Fly([0.0, 0.0, 1.0]);
        controls.hold(forward, start, &mut view);
        assert!((view.position.z + 2.0 - 1.2 / 60.0).abs() < 1e-9, "at once");
        controls.modifiers.shift = true;
        assert!(controls.tick(start + Duration::from_millis(50), &mut view));
        assert!((view.position.z + 2.0 - 1.2 / 60.0 - 0.05 * 4.0 * 1.2).abs() < 1e-9);
        controls.let_go(forward);
        assert!(!controls.tick(start + Duration::from_millis(90), &mut view) && !controls.is_busy());
        controls.wheel(-NOTCH, &mut view);
        let near = (view.position - view.pivot).length();
        controls.wheel(NOTCH, &mut view);
        assert!((view.position - view.pivot).length() > near);
    }
}
