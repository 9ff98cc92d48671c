//! `train --view`: the viewers of a running training, and their share of its time.

mod curves;
#[cfg(test)]
mod tests;

use super::Run;
use super::allowance::Allowance;
use ashsplat::train::{StepReport, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_files::Gallery;
use ashsplat_program::config::Settings;
use ashsplat_program::measure::Stopwatch;
use ashsplat_program::session::{guarded, locked};
use ashsplat_view::hub::Hub;
use ashsplat_view::protocol::{ToPage, TrainAction};
use ashsplat_view::render_thread::RenderThread;
use ashsplat_view::server::{AppState, ServeArguments, Server};
use ashsplat_view::{LoadedScene, PhotoAppearances, Photos, announce, render_thread, server};
use clap::Args;
use curves::Curves;
use serde_json::json;
use std::net::TcpListener;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Options for watching a training in a browser.
#[derive(Args, Clone, Debug)]
pub struct LiveArguments {
    /// Serve a page that shows the training (see `ashsplat view`), at this port [default port: 8090; 0 takes a free one]
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8090")]
    view: Option<u16>,
    /// Address of that page; another than this machine's own needs --view-token
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1", requires = "view")]
    view_host: String,
    /// Word that the page's address must contain: http://HOST:PORT/?token=WORD
    #[arg(long, value_name = "WORD", requires = "view")]
    view_token: Option<String>,
    /// Address of that page where a proxy shows it: see --allow-origin of `ashsplat view`
    #[arg(long, value_name = "ORIGIN", requires = "view", value_parser = server::origin)]
    view_allow_origin: Option<String>,
    /// Largest share of training's time that all viewers together may take, 0.01 to 0.9
    #[arg(long, value_name = "SHARE", default_value_t = 0.2, value_parser = share)]
    view_share: f64,
}

fn share(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|share| (0.01..=0.9).contains(share));
    number.ok_or_else(|| "expected a number from 0.01 to 0.9".into())
}

impl LiveArguments {
    pub fn wants_photos(&self) -> bool {
        self.view.is_some()
    }

    pub fn open(&self) -> Result<Option<Port>> {
        let Some(port) = self.view else { return Ok(None) };
        let (host, token) = (self.view_host.clone(), self.view_token.clone());
        let allow_origin = self.view_allow_origin.clone();
        let serve = ServeArguments { host, port, token, allow_origin, of_training: true };
        Ok(Some(Port { listener: server::open(&serve)?, serve, share: self.view_share }))
    }
}

/// An open port that is not served yet; early connections wait. It is opened before anything is loaded, so that a port
/// in use is an error at once.
pub struct Port {
    listener: TcpListener,
    serve: ServeArguments,
    share: f64,
}

/// Least time between two new pictures for pages that follow the training.
const RENEWAL: Duration = Duration::from_millis(500);
/// Time between two checks of a paused training.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct TrainRequest {
    save: bool,
    stop: bool,
}

pub struct Live {
    render_thread: RenderThread,
    hub: Arc<Hub>,
    _server: Server,
    curves: Arc<Mutex<Curves>>,
    allowance: Allowance,
    /// Begin of the current time in which training has the device to itself.
    trains_since: Instant,
    renewed: Instant,
    paused: bool,
    /// Number of iterations that a paused training may do.
    steps: u32,
}

impl Live {
    /// Accepts connections at the port. `device`: the device's name.
    fn start(port: Port, scene: LoadedScene, device: &str, settings: &Settings) -> Result<Live> {
        let hub = Arc::new(Hub::default());
        let (data, iterations) = (&settings.data, settings.train.iterations);
        hub.greet_with(&scene.greeting(device, Some(iterations)));
        let curves = Arc::new(Mutex::new(Curves::new(iterations)));
        let status_curves = curves.clone();
        hub.set_status(move |since| locked(&status_curves).status(since).to_string());
        let films = data.model_path.join("films");
        let mut render_thread = RenderThread::new(hub.clone(), scene.base, films.clone());
        render_thread.show(scene.base, scene.appearances, scene.frame);
        let state = AppState::new(hub.clone(), films, port.serve.clone());
        state.show_photos(scene.photos);
        let server = server::start(port.listener, state)?;
        announce(server.address, &port.serve);
        Ok(Live {
            render_thread,
            hub,
            _server: server,
            curves,
            allowance: Allowance::new(port.share),
            trains_since: Instant::now(),
            renewed: Instant::now(),
            paused: false,
            steps: 0,
        })
    }

    /// Notes an iteration and serves the viewers, within the share.
    fn after_step(&mut self, trainer: &mut Trainer, report: &StepReport) -> Result<TrainRequest> {
        self.note(|curves| curves.step(report));
        self.allowance.trained(self.trains_since.elapsed());
        self.trains_since = Instant::now();
        if self.renewed.elapsed() >= RENEWAL {
            self.renewed = Instant::now();
            self.hub.renew();
        }
        if self.allowance.permits() && self.hub.has_work() {
            let start = Instant::now();
            let served = self.render_thread.serve(trainer, Duration::ZERO);
            self.allowance.spent(start.elapsed());
            self.trains_since = Instant::now();
            served?;
        }
        Ok(self.take_requests())
    }

    /// True if training waits after this iteration.
    fn holds(&mut self) -> bool {
        let holds = self.waits();
        self.steps = self.steps.saturating_sub(1);
        holds
    }

    /// Serves viewers while training waits, until a request or `stop`.
    fn hold(&mut self, trainer: &mut Trainer, stop: &AtomicBool) -> Result<TrainRequest> {
        self.hub.renew();
        self.note(|curves| curves.pause(true));
        loop {
            self.render_thread.serve(trainer, POLL_INTERVAL)?;
            let request = self.take_requests();
            let stop = stop.load(Ordering::Relaxed);
            if request != TrainRequest::default() || stop || !self.waits() {
                self.note(|curves| curves.pause(self.paused));
                // After a save, training still waits.
                if !self.waits() {
                    self.steps = self.steps.saturating_sub(1);
                }
                // The time spent waiting does not count as training.
                self.trains_since = Instant::now();
                return Ok(TrainRequest { stop: request.stop || stop, ..request });
            }
        }
    }

    fn waits(&self) -> bool {
        self.paused && self.steps == 0
    }

    /// After training, completes films.
    fn end(&mut self, trainer: &mut Trainer, stop: &AtomicBool) -> Result<()> {
        let message = "training has ended; `ashsplat view MODEL` shows the result";
        self.hub.broadcast(&ToPage::json(&json!({ "type": "ended", "message": message })));
        while self.hub.has_films() && !stop.load(Ordering::Relaxed) {
            // Discards requests: training is over, and pending ones would end each wait at once.
            self.hub.actions();
            self.render_thread.serve(trainer, POLL_INTERVAL)?;
        }
        if !stop.load(Ordering::Relaxed) {
            self.render_thread.finish();
        }
        Ok(())
    }

    fn note(&self, change: impl FnOnce(&mut Curves)) {
        change(&mut locked(&self.curves));
    }

    fn take_requests(&mut self) -> TrainRequest {
        let mut request = TrainRequest::default();
        for action in self.hub.actions() {
            match action {
                TrainAction::Pause => self.paused = true,
                TrainAction::Resume => (self.paused, self.steps) = (false, 0),
                TrainAction::Step => (self.paused, self.steps) = (true, self.steps + 1),
                TrainAction::Save => request.save = true,
                TrainAction::Stop => request.stop = true,
            }
        }
        self.note(|curves| curves.pause(self.paused));
        request
    }
}

impl Run {
    pub fn serve(&mut self, port: Option<Port>, context: &Context, gallery: Option<Gallery>) -> Result<()> {
        let Some(port) = port else { return Ok(()) };
        let (data, train) = (&self.settings.data, &self.settings.train);
        let cameras = gallery.as_ref().map(|gallery| gallery.cameras()).unwrap_or_default();
        let learns = [train.exposure, train.lens_effects];
        let scene = LoadedScene {
            name: data.model_path.display().to_string(),
            gaussians: self.trainer.gaussians()?,
            frame: self.views.frame,
            base: self.trainer.render_settings(),
            appearances: PhotoAppearances::in_training(
                &cameras,
                &self.views.trained,
                &self.views.takers,
                learns,
            ),
            cameras,
            photos: gallery.map(|gallery| Arc::new(Photos::new(gallery))),
            note: Some("in training".into()),
            file: Some(data.model_path.clone()),
            ..LoadedScene::default()
        };
        self.live = Some(Live::start(port, scene, context.device_name(), &self.settings)?);
        Ok(())
    }

    /// Shows an iteration to the viewers and handles their requests. `stop` is set when they request the end. A failure
    /// or panic ends the viewer, not the training; if the device is lost, the next iteration fails.
    pub(super) fn show(&mut self, report: &StepReport, stop: &AtomicBool, watch: &mut Stopwatch) {
        let Some(mut live) = self.live.take() else { return };
        match guarded(|| self.show_to(&mut live, report, stop, watch)) {
            Ok(()) => self.live = Some(live),
            Err(error) => self.warn_of_end(&error),
        }
    }

    fn warn_of_end(&self, error: &Error) {
        self.progress.warn(&format!("warning: the viewer has ended: {error}"));
    }

    fn show_to(
        &mut self,
        live: &mut Live,
        report: &StepReport,
        stop: &AtomicBool,
        watch: &mut Stopwatch,
    ) -> Result<()> {
        let mut request = live.after_step(&mut self.trainer, report)?;
        let mut holds = live.holds();
        loop {
            if request.stop {
                stop.store(true, Ordering::Relaxed);
            }
            if request.save && self.saved != Some(report.iteration) {
                match guarded(|| watch.paused(|| self.save(report.iteration, ""))) {
                    Ok(()) => {
                        let message = format!("saved iteration {}", report.iteration);
                        live.hub.broadcast(&ToPage::json(&json!({ "type": "note", "message": message })));
                    }
                    Err(error) => {
                        self.progress.warn(&format!("warning: not saved: {error}"));
                        self.retries.retry_scene();
                        live.hub.broadcast(&ToPage::problem(&error.to_string()));
                        render_thread::fatal(error)?;
                    }
                }
            }
            if !holds || request.stop {
                return Ok(());
            }
            request = watch.paused(|| live.hold(&mut self.trainer, stop))?;
            holds = request.save && live.waits();
        }
    }

    /// True if a page shows the curves.
    pub(super) fn has_viewers(&self) -> bool {
        self.live.as_ref().is_some_and(|live| live.hub.pages() > 0)
    }

    pub(super) fn show_psnr(&self, iteration: u32, psnr: f64) {
        if let Some(live) = &self.live {
            live.note(|curves| curves.psnr(iteration, psnr));
        }
    }

    /// Tells viewers that training has ended; they stay until the run is dropped.
    pub(super) fn end_show(&mut self, stop: &AtomicBool) {
        let Some(live) = &mut self.live else { return };
        let trainer = &mut self.trainer;
        if let Err(error) = guarded(|| live.end(trainer, stop)) {
            self.warn_of_end(&error);
        }
    }
}
