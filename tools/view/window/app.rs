//! The window's events.

use super::controls::{Button, Click, Controls, Modifiers, NOTCH};
use super::keys::{self, Action};
use super::pace::NextFrame;
use super::present::{Present, unfit};
use super::viewer::WindowViewer;
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{ElementState, KeyEvent, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::keyboard::{Key, PhysicalKey};
use winit::window::{Fullscreen, Window, WindowId};

/// First size of the window, logical pixels.
const SIZE: LogicalSize<u32> = LogicalSize::new(1280, 720);
const MIN_SIZE: LogicalSize<u32> = LogicalSize::new(64, 64);
/// Sleep times: when idle, until Ctrl-C is checked; while the device works; while the window is not ready.
const IDLE: Duration = Duration::from_millis(100);
const WORKING: Duration = Duration::from_millis(2);
const NOT_READY: Duration = Duration::from_millis(30);
/// Distance at which the pointer grasps the line between photo and render, logical pixels.
const GRASP: f64 = 8.0;

/// The window. Fields drop in this order: the viewer before the objects that present it.
pub struct App {
    viewer: Option<WindowViewer>,
    present: Option<Present>,
    window: Option<Arc<Window>>,
    context: Option<Context>,
    controls: Controls,
    /// True while the line between photo and render is dragged.
    wiping: bool,
    vsync: bool,
    stop: Arc<AtomicBool>,
    /// No frame before this moment.
    not_before: Option<Instant>,
    failed: Option<Error>,
}

impl App {
    pub fn new(viewer: WindowViewer, context: Context, stop: Arc<AtomicBool>, vsync: bool) -> App {
        App {
            viewer: Some(viewer),
            present: None,
            window: None,
            context: Some(context),
            controls: Controls::default(),
            wiping: false,
            vsync,
            stop,
            not_before: None,
            failed: None,
        }
    }

    /// Destroys everything on the device. Returns the error that ended the window, if any.
    pub fn close(&mut self) -> Option<Error> {
        if let Some(present) = &self.present {
            // It fails only if the device is lost, which is already reported.
            present.idle().ok();
        }
        (self.viewer, self.present, self.window, self.context) = (None, None, None, None);
        self.failed.take()
    }

    fn open(&mut self, events: &ActiveEventLoop) -> Result<()> {
        let (Some(viewer), Some(context)) = (&mut self.viewer, &self.context) else { return Ok(()) };
        let title = format!("{} · ashsplat", viewer.title());
        let attributes = Window::default_attributes().with_title(title);
        let attributes = attributes.with_inner_size(SIZE).with_min_inner_size(MIN_SIZE);
        let window = events.create_window(attributes).map_err(|error| unfit(&error.to_string()))?;
        let window = Arc::new(window);
        viewer.scale_factor = window.scale_factor();
        self.present = Some(Present::new(context, window.clone(), self.vsync)?);
        self.window = Some(window);
        Ok(())
    }

    fn event(&mut self, events: &ActiveEventLoop, event: WindowEvent) -> Result<()> {
        let (Some(viewer), Some(present)) = (&mut self.viewer, &mut self.present) else { return Ok(()) };
        let (now, factor) = (Instant::now(), viewer.scale_factor);
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => events.exit(),
            WindowEvent::RedrawRequested => {
                let frame = viewer.next_frame(now, self.controls.is_busy());
                // The system also asks when the window's contents are lost.
                let frame = if frame == NextFrame::Nothing { NextFrame::Still } else { frame };
                let shown = viewer.draw(present, frame)?;
                self.not_before = (!shown).then(|| now + NOT_READY);
            }
            WindowEvent::Resized(_) | WindowEvent::Occluded(false) => viewer.pace.leap(),
            WindowEvent::ScaleFactorChanged { scale_factor, .. } => {
                viewer.scale_factor = scale_factor;
                viewer.pace.leap();
            }
            WindowEvent::Focused(false) => self.controls.forget(),
            WindowEvent::ModifiersChanged(modifiers) => {
                let state = modifiers.state();
                self.controls.modifiers = Modifiers {
                    shift: state.shift_key(),
                    control: state.control_key(),
                    alt: state.alt_key(),
                };
            }
            WindowEvent::KeyboardInput { event, .. } => {
                let closes = self.key(&event)?;
                if closes {
                    events.exit();
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                let at = [position.x / factor, position.y / factor];
                if self.wiping {
                    viewer.move_wipe(position.x);
                    self.controls.place(at);
                } else if self.controls.drag(at, f64::from(viewer.size[1]) / factor, &mut viewer.view) {
                    viewer.pace.touch(now);
                }
            }
            WindowEvent::MouseInput { state, button, .. } => self.button(state, button)?,
            WindowEvent::MouseWheel { delta, .. } => {
                let pixels = match delta {
                    MouseScrollDelta::LineDelta(_, lines) => -f64::from(lines) * NOTCH,
                    MouseScrollDelta::PixelDelta(position) => -position.y / factor,
                };
                self.controls.wheel(pixels, &mut viewer.view);
                viewer.pace.touch(now);
            }
            _ => {}
        }
        Ok(())
    }

    /// Handles a pressed or released key. True if the window should close.
    fn key(&mut self, event: &KeyEvent) -> Result<bool> {
        let Some(viewer) = &mut self.viewer else { return Ok(false) };
        let PhysicalKey::Code(code) = event.physical_key else { return Ok(false) };
        let code = format!("{code:?}");
        let action = keys::action(&code);
        let steers = matches!(action, Some(Action::Fly(_) | Action::Turn(_) | Action::Zoom(_)));
        if event.state == ElementState::Released {
            if let Some(action) = action.filter(|_| steers) {
                self.controls.let_go(action);
            }
            return Ok(false);
        }
        if self.controls.modifiers.control {
            return Ok(code == "KeyQ" || code == "KeyW");
        }
        if event.repeat {
            return Ok(false);
        }
        if matches!(&event.logical_key, Key::Character(text) if text == "?") {
            viewer.help = !viewer.help;
            viewer.pace.leap();
            return Ok(false);
        }
        if code == "KeyF"
            && self.controls.modifiers.shift
            && let Some(window) = &self.window
        {
            let whole = window.fullscreen().is_none().then_some(Fullscreen::Borderless(None));
            window.set_fullscreen(whole);
            return Ok(false);
        }
        let Some(action) = action else { return Ok(false) };
        if steers {
            let now = Instant::now();
            self.controls.hold(action, now, &mut viewer.view);
            viewer.pace.touch(now);
            return Ok(false);
        }
        if action == Action::FlyMode {
            self.controls.flying = !self.controls.flying;
            viewer.say(format!("flying: {}", if self.controls.flying { "on" } else { "off" }));
        }
        viewer.act(action)
    }

    fn button(&mut self, state: ElementState, button: MouseButton) -> Result<()> {
        let Some(viewer) = &mut self.viewer else { return Ok(()) };
        let button = match button {
            MouseButton::Left => Button::Left,
            MouseButton::Middle => Button::Middle,
            MouseButton::Right => Button::Right,
            _ => return Ok(()),
        };
        let factor = viewer.scale_factor;
        if state == ElementState::Pressed {
            let at = self.controls.at[0] * factor;
            let near = viewer.wipe().is_some_and(|wipe| (wipe - at).abs() < GRASP * factor);
            self.wiping = near && button == Button::Left;
            if !self.wiping {
                self.controls.press(button);
            }
            return Ok(());
        }
        if std::mem::take(&mut self.wiping) {
            return Ok(());
        }
        // The view rests again: draw a sharp frame.
        let moved = self.controls.is_busy();
        let click = self.controls.release(button, Instant::now());
        if moved {
            viewer.pace.touch(Instant::now());
        }
        match click {
            Some(Click::Single(at)) if viewer.inspecting || self.controls.modifiers.alt => {
                viewer.pick(at.map(|v| v * factor))
            }
            Some(Click::Double(at)) => viewer.set_pivot(at.map(|v| v * factor)),
            _ => Ok(()),
        }
    }

    /// Runs before the loop sleeps: steers, requests a frame, sets the sleep time.
    fn rest(&mut self, events: &ActiveEventLoop) -> Result<()> {
        let (Some(viewer), Some(present), Some(window)) = (&mut self.viewer, &self.present, &self.window)
        else {
            return Ok(());
        };
        let now = Instant::now();
        if self.controls.tick(now, &mut viewer.view) {
            viewer.pace.touch(now);
        }
        viewer.poll(present)?;
        let is_due = viewer.next_frame(now, self.controls.is_busy()) != NextFrame::Nothing;
        let early = self.not_before.filter(|then| *then > now);
        let mut wake = now + IDLE;
        match (is_due, early) {
            (true, None) => window.request_redraw(),
            (true, Some(then)) => wake = then,
            _ => {}
        }
        if viewer.is_waiting() {
            wake = wake.min(now + WORKING);
        }
        if let Some(then) = viewer.pace.wakes() {
            wake = wake.min(then.max(now + WORKING));
        }
        events.set_control_flow(ControlFlow::WaitUntil(wake));
        Ok(())
    }

    fn end_if_failed(&mut self, events: &ActiveEventLoop, done: Result<()>) {
        if let Err(error) = done {
            self.failed.get_or_insert(error);
            events.exit();
        }
    }
}

impl ApplicationHandler<Option<String>> for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_none() {
            let opened = self.open(events);
            self.end_if_failed(events, opened);
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        if self.failed.is_none() {
            let done = self.event(events, event);
            self.end_if_failed(events, done);
        }
    }

    /// A tile of a tree has arrived, or there is a message.
    fn user_event(&mut self, _: &ActiveEventLoop, problem: Option<String>) {
        let Some(viewer) = &mut self.viewer else { return };
        if let Some(problem) = problem {
            viewer.say(problem);
        }
        viewer.pace.renew(self.controls.is_busy());
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if self.stop.load(Ordering::Relaxed) {
            events.exit();
        } else if self.failed.is_none() {
            let done = self.rest(events);
            self.end_if_failed(events, done);
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        // Here the connection to the display is still open.
        self.failed = self.close();
    }
}
