//! State of the window: view, mode, photo, text.

use super::super::draw::{self, ViewedScene};
use super::super::loaded_scene::LoadedScene;
use super::super::protocol::{self, Mode, ViewSettings};
use super::super::render_thread::fatal;
use super::comparison::Comparison;
use super::keys::Action;
use super::navigation::Navigation;
use super::pace::{NextFrame, Pace};
use super::picture::{Content, Picture};
use super::present::Present;
use super::text::{Overlay, Text, text};
use super::words::{self, Measurements};
use ashsplat::scene::Camera;
use ashsplat::{Error, FrameStats, Gaussians, PixelReport, RenderSettings, Result};
use ashsplat_files::Photo;
use ashsplat_program::appearance::Appearance;
use ashsplat_program::output;
use glam::DVec3;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime};

const MESSAGE_TIME: Duration = Duration::from_secs(6);
/// Window rows per unit of text scale.
const ROWS_PER_DOT: u32 = 540;
/// Distance of the text from the corner, pixels.
const CORNER: u32 = 8;

/// A frame that the device still works on.
struct Pending {
    slot: u32,
    frame: NextFrame,
    begun: Instant,
    /// Time that the processor took for the picture before submission, ms.
    before: f64,
    splats: bool,
    /// True if it was drawn only to show the previous frame's figures.
    settled: bool,
}

pub struct WindowViewer {
    picture: Picture,
    pub view: Navigation,
    pub pace: Pace,
    mode: Mode,
    /// The scene, without its Gaussians.
    scene: LoadedScene,
    /// True if photos' views are drawn with their exposure and lens effects.
    shows_appearance: bool,
    device: String,
    start: Option<Camera>,
    center: DVec3,
    /// Source units of a world unit.
    unit: f32,
    out: PathBuf,
    /// Size of the window, pixels.
    pub size: [u32; 2],
    /// Pixels per logical pixel.
    pub scale_factor: f64,
    measured: Measurements,
    pending: VecDeque<Pending>,
    ended: Option<Instant>,
    settle: bool,
    current: Option<usize>,
    comparison: Option<Comparison>,
    /// Border between photo and render, share of the photo's width.
    share: f64,
    pub inspecting: bool,
    panel: bool,
    pub help: bool,
    picked: Vec<String>,
    message: Option<(String, Instant)>,
}

impl WindowViewer {
    pub fn new(scene: LoadedScene, picture: Picture, device: &str, out: PathBuf) -> WindowViewer {
        let (orbit, start) = scene.first_view();
        let center = orbit.center.as_dvec3();
        let view = Navigation::new(center, orbit.up.as_dvec3(), f64::from(orbit.radius));
        let mut viewer = WindowViewer {
            picture,
            view,
            pace: Pace::new(),
            mode: Mode::Splats,
            shows_appearance: false,
            device: device.to_owned(),
            start,
            center,
            unit: scene.frame.unit as f32,
            scene: LoadedScene { gaussians: Gaussians::default(), ..scene },
            out,
            size: [1, 1],
            scale_factor: 1.0,
            measured: Measurements::default(),
            pending: VecDeque::new(),
            ended: None,
            settle: false,
            current: None,
            comparison: None,
            share: 0.5,
            inspecting: false,
            panel: true,
            help: false,
            picked: Vec::new(),
            message: None,
        };
        viewer.home();
        viewer
    }

    /// The last part of the scene's name.
    pub fn title(&self) -> &str {
        self.scene.name.split('/').rfind(|part| !part.is_empty()).unwrap_or(&self.scene.name)
    }

    fn home(&mut self) {
        let Some(start) = self.start else { return };
        self.view.pivot = self.center;
        self.view.take(&start, false);
        self.view.touch();
        self.pace.leap();
    }

    fn look(&self) -> ViewSettings {
        ViewSettings { mode: self.mode, quality: 0, ..ViewSettings::default() }
    }

    pub fn say(&mut self, text: String) {
        self.message = Some((text, Instant::now()));
        self.pace.leap();
    }

    /// Shows an error. Returns it if it must end the program.
    fn show_error(&mut self, error: Error) -> Result<()> {
        self.say(error.to_string());
        fatal(error)
    }

    /// Performs a key's action that does not steer. True if the window should close.
    pub fn act(&mut self, action: Action) -> Result<bool> {
        match action {
            Action::Mode(mode) => (self.mode, self.measured.legend) = (mode, None),
            Action::Inspect => {
                self.inspecting = !self.inspecting;
                self.say(format!("inspecting pixels: {}", if self.inspecting { "on" } else { "off" }));
            }
            Action::Panel => self.panel = !self.panel,
            Action::Screenshot => self.screenshot()?,
            Action::Face => self.view.face(self.center),
            Action::Home => self.home(),
            Action::Photo(step) => self.step(step),
            Action::PhotoAppearance => {
                self.shows_appearance = !self.shows_appearance;
                self.say(words::photo_appearance(self.shows_appearance, self.has_appearances()).into());
            }
            Action::Close => return Ok(!self.close_something()),
            Action::Fly(_) | Action::Turn(_) | Action::Zoom(_) | Action::FlyMode => {}
        }
        self.pace.leap();
        Ok(false)
    }

    fn has_appearances(&self) -> bool {
        (0..self.scene.cameras.len()).any(|photo| self.scene.appearances.has(photo))
    }

    /// Exposure and lens effects for the picture, if the view is exactly a photo's.
    fn photo_appearance(&self) -> Result<Option<(Camera, Appearance)>> {
        let shows_appearance = self.shows_appearance && self.mode == Mode::Splats && self.view.is_photo();
        let photo = self.current.filter(|photo| shows_appearance && self.scene.appearances.has(*photo));
        photo.map(|photo| self.scene.appearances.of(photo, None)).transpose()
    }

    /// Closes help, photo and list of Gaussians. True if any was open.
    fn close_something(&mut self) -> bool {
        let compares = self.comparison.take().is_some() && self.view.is_photo();
        let open = self.help || compares || !self.picked.is_empty();
        (self.help, self.current) = (false, None);
        self.picked.clear();
        open
    }

    /// Goes to the next or the previous photo.
    fn step(&mut self, by: isize) {
        let count = self.scene.cameras.len() as isize;
        if count == 0 {
            return;
        }
        let from = self.current.map_or(if by > 0 { -1 } else { 0 }, |current| current as isize);
        let index = (from + by).rem_euclid(count) as usize;
        self.current = Some(index);
        let named = &self.scene.cameras[index];
        self.view.take(&named.camera, true);
        let name = named.name.clone();
        let photo = self.scene.photos.as_ref().map(|photos| photos.decoded_now(index)).transpose();
        let (photo, message) = photo.map_or_else(|error| (None, error.to_string()), |photo| (photo, name));
        self.comparison = photo.map(Comparison::new);
        self.say(message);
    }

    /// Border between photo and render, pixels from the left; none if no photo is shown.
    pub fn wipe(&self) -> Option<f64> {
        let lens = self.view.lens.as_ref().filter(|_| self.comparison.is_some())?;
        let (scale, [x, _]) = Navigation::frame(lens, self.size);
        Some(x + self.share * f64::from(lens.width) * scale)
    }

    /// Moves the border between photo and render.
    pub fn move_wipe(&mut self, x: f64) {
        let Some(lens) = self.view.lens.as_ref() else { return };
        let (scale, [left, _]) = Navigation::frame(lens, self.size);
        self.share = ((x - left) / (f64::from(lens.width) * scale)).clamp(0.0, 1.0);
        self.pace.leap();
    }

    fn report(&mut self, [x, y]: [f64; 2]) -> Result<Option<([u32; 2], PixelReport)>> {
        let pixel = [x, y].map(|v| v.max(0.0) as u32);
        let camera = self.view.camera(self.size);
        let settings = draw::settings(&self.scene.base, &ViewSettings::default());
        if !self.picture.has_scene() {
            return Ok(None);
        }
        match self.picture.scene.inspect(&camera, &settings, pixel) {
            Ok(report) => Ok(Some((pixel, report))),
            Err(error) => self.show_error(error).map(|()| None),
        }
    }

    /// Lists the Gaussians blended at a pixel.
    pub fn pick(&mut self, at: [f64; 2]) -> Result<()> {
        if let Some((pixel, mut report)) = self.report(at)? {
            report.samples.iter_mut().for_each(|sample| sample.depth *= self.unit);
            self.picked = words::picked(pixel, &report);
            self.pace.leap();
        }
        Ok(())
    }

    pub fn set_pivot(&mut self, at: [f64; 2]) -> Result<()> {
        let found = self.report(at)?;
        let found = found.and_then(|(pixel, report)| Some((pixel, protocol::pivot_depth(&report)?)));
        if let Some((pixel, depth)) = found {
            self.view.pivot = protocol::place(&self.view.camera(self.size), pixel, depth).as_dvec3();
            self.say("turning around this point".into());
        }
        Ok(())
    }

    fn screenshot(&mut self) -> Result<()> {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let path = self.out.join(format!("ashsplat-{}.png", now.as_millis()));
        let (camera, look) = (self.view.camera(self.size), self.look());
        if !self.picture.has_scene() {
            return Ok(());
        }
        let drawn = (self.photo_appearance()).and_then(|appearance| {
            draw::draw(&mut self.picture.scene, &camera, &self.scene.base, &look, appearance)
        });
        match drawn.and_then(|drawn| output::write_png(&path, &drawn.photo)) {
            Ok(()) => self.say(format!("saved {}", path.display())),
            Err(error) => self.show_error(error)?,
        }
        Ok(())
    }

    pub fn next_frame(&mut self, now: Instant, busy: bool) -> NextFrame {
        if self.message.as_ref().is_some_and(|(_, since)| now.duration_since(*since) > MESSAGE_TIME) {
            self.message = None;
            self.pace.leap();
        }
        match self.pace.next(now, busy) {
            NextFrame::Nothing if self.settle => NextFrame::Still,
            frame => frame,
        }
    }

    /// True if the device works on a frame.
    pub fn is_waiting(&self) -> bool {
        !self.pending.is_empty()
    }

    pub fn poll(&mut self, present: &Present) -> Result<()> {
        while let Some(first) = self.pending.front() {
            if !present.is_done(first.slot)? {
                break;
            }
            let Some(done) = self.pending.pop_front() else { break };
            let (now, from) = (Instant::now(), self.ended.map_or(done.begun, |ended| ended.max(done.begun)));
            self.ended = Some(now);
            let milliseconds = done.before + now.duration_since(from).as_secs_f64() * 1e3;
            self.measured.milliseconds = milliseconds;
            if let NextFrame::Moving(scale) = done.frame {
                self.pace.adapt(milliseconds, scale);
            }
            if !done.splats {
                continue;
            }
            self.settle |= done.frame == NextFrame::Still && !done.settled && self.panel;
            match self.picture.report(present, done.slot) {
                Ok(Some(report)) => {
                    if report.overflow {
                        self.pace.leap();
                    }
                    self.measured.stats = FrameStats {
                        gaussians: report.gaussians,
                        visible: report.visible,
                        instances: report.instances_needed,
                        scopes: report.scopes,
                        ..FrameStats::default()
                    };
                }
                Ok(None) => {}
                Err(error) => self.show_error(error)?,
            }
        }
        Ok(())
    }

    /// Draws and shows a frame. False if the window is not ready.
    pub fn draw(&mut self, present: &mut Present, frame: NextFrame) -> Result<bool> {
        let Some(size) = present.size()? else { return Ok(false) };
        self.size = size;
        present.wait()?;
        self.poll(present)?;
        let small = frame.sides(size);
        let settled = std::mem::take(&mut self.settle) && frame == NextFrame::Still;
        let (camera, start) = (self.view.camera(small), Instant::now());
        let settings = draw::settings(&self.scene.base, &self.look());
        let prepared = self.prepare(present, &camera, &settings);
        let before = start.elapsed().as_secs_f64() * 1e3;
        let background = self.scene.base.background;
        let content = match &prepared {
            Ok(_) if !self.picture.has_scene() => Content::Nothing(background),
            Ok(Some(photo)) => Content::Photo(photo),
            Ok(None) if !self.picture.is_in_view() => Content::Nothing(background),
            Ok(None) => Content::Splats(&settings),
            Err(error) => {
                self.message = Some((error.to_string(), Instant::now()));
                Content::Nothing(background)
            }
        };
        self.measured.size = small;
        let text = self.text();
        if let (Some(lens), Some(comparison)) = (self.view.lens.as_ref(), &mut self.comparison) {
            comparison.fit(lens, size, self.share);
        }
        let mut overlays = Vec::new();
        if let Some(comparison) = self.comparison.as_ref().filter(|_| self.view.is_photo()) {
            overlays.push(comparison.overlay());
        }
        overlays.push(Overlay { picture: &text, corner: [CORNER; 2] });
        let splats = matches!(content, Content::Splats(_));
        let drawn = self.picture.draw(present, size, &camera, &content, &overlays)?;
        if let Err(error) = prepared {
            fatal(error)?;
        }
        let Some((slot, begun)) = drawn else { return Ok(false) };
        let before = if splats { 0.0 } else { before };
        self.pending.push_back(Pending { slot, frame, begun, before, splats, settled });
        self.pace.drawn(frame, Instant::now());
        Ok(true)
    }

    /// Allocates what the frame needs. Returns the picture in a mode that the processor colours.
    fn prepare(
        &mut self,
        present: &Present,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Option<Photo>> {
        camera.check()?;
        if !self.picture.has_scene() {
            return Ok(None);
        }
        let appearance = self.photo_appearance()?;
        if appearance.is_none() && matches!(self.mode, Mode::Splats | Mode::Centres) {
            let whole = self.view.camera(self.size);
            self.picture.prepare(present, &whole, settings)?;
            return Ok(None);
        }
        let look = self.look();
        let drawn = draw::draw(&mut self.picture.scene, camera, &self.scene.base, &look, appearance)?;
        let unit = if self.mode == Mode::Depth { self.unit } else { 1.0 };
        let legend = drawn.legend.map(|ends| ends.map(|end| end * unit));
        let milliseconds = self.measured.milliseconds;
        let stats = FrameStats { scopes: Vec::new(), ..drawn.stats };
        self.measured = Measurements { milliseconds, legend, stats, ..Measurements::default() };
        Ok(Some(drawn.photo))
    }

    fn text(&self) -> Text {
        let mut lines = Vec::new();
        if self.panel {
            let rate = self.pace.frames_per_second();
            lines = words::status(&self.scene.name, &self.device, self.mode, rate, &self.measured);
            lines.extend(self.picture.scene.tree().and_then(words::tree));
            lines.extend(self.scene.note.iter().flat_map(|note| words::wrapped(note)));
        }
        lines.extend(self.message.iter().flat_map(|(message, _)| words::wrapped(message)));
        lines.extend(self.picked.iter().cloned());
        if self.help {
            lines.extend(words::help());
        }
        let dots = (self.size[1] / ROWS_PER_DOT).max(self.scale_factor.round() as u32).clamp(1, 8);
        text(&lines, dots, self.size.map(|side| side.saturating_sub(2 * CORNER)))
    }
}
