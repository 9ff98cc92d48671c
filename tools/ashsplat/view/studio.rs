//! The one thread that renders: does the hub's tasks one by one.

use super::draw::{self, Painter};
use super::film::Film;
use super::hub::{Hub, RemoteRequest, Task};
use super::protocol::{self, ToPage};
use crate::output;
use ashsplat::{Error, RenderSettings, Result};
use serde_json::json;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Serves pages with pictures of whatever is given to it.
pub struct Studio {
    hub: Arc<Hub>,
    /// How the scene looks as it was trained.
    base: RenderSettings,
    /// Where films are put.
    films: PathBuf,
    film: Option<Film>,
}

impl Studio {
    pub fn new(hub: Arc<Hub>, base: RenderSettings, films: PathBuf) -> Studio {
        Studio { hub, base, films, film: None }
    }

    /// Whether there is anything to do.
    pub fn is_wanted(&self) -> bool {
        self.film.is_some() || self.hub.is_wanted()
    }

    /// Does one task, if one comes in time; a frame of a film where nobody else waits. Whether anything was done.
    ///
    /// # Errors
    /// When the device is lost; whatever else fails is told to the page that asked for it.
    pub fn serve(&mut self, painter: &mut dyn Painter, longest: Duration) -> Result<bool> {
        let patience = if self.film.is_some() { Duration::ZERO } else { longest };
        let Some(task) = self.hub.next(patience) else { return self.go_on_filming(painter) };
        match task {
            Task::Frame { client, request } => {
                let answer = draw::answer(painter, &self.base, &request);
                let failed = answer.is_err();
                self.reply(client, answer.map(|(header, bytes)| ToPage::frame(&header, &bytes)))?;
                if failed {
                    // No frame, and so no word that it has come.
                    self.hub.acknowledge(client);
                }
            }
            Task::Pick { client, pick } => {
                let settings = draw::settings(&self.base, &pick.look);
                let report = pick.camera.camera().and_then(|c| painter.inspect(&c, &settings, pick.pixel));
                let answer = report.map(|r| ToPage::json(&protocol::picked(pick.id, pick.pixel, &r)));
                self.reply(client, answer)?;
            }
            Task::Remote(request) => self.answer_remotely(painter, &request)?,
        }
        Ok(true)
    }

    /// Sends an answer, or why there is none.
    fn reply(&self, client: u64, answer: Result<ToPage>) -> Result<()> {
        match answer {
            Ok(message) => self.hub.send(client, message),
            Err(error) => {
                self.hub.send(client, ToPage::problem(&error.to_string()));
                fatal(error)?;
            }
        }
        Ok(())
    }

    fn answer_remotely(&self, painter: &mut dyn Painter, request: &RemoteRequest) -> Result<()> {
        let settings = RenderSettings { scale_modifier: request.scale, ..self.base };
        let frame = painter.render(&request.camera, &settings).and_then(|frame| output::to_photo(&frame));
        match frame {
            Ok(photo) => {
                request.answer.send(photo.rgb).ok();
                Ok(())
            }
            // Without an answer the connection is closed.
            Err(error) => fatal(error),
        }
    }

    /// One frame of the film that is being made, or of the next.
    fn go_on_filming(&mut self, painter: &mut dyn Painter) -> Result<bool> {
        if self.film.is_none() {
            let Some((client, request)) = self.hub.take_film() else { return Ok(false) };
            match Film::begin(client, request, &self.films) {
                Ok(film) => self.film = Some(film),
                Err(error) => self.hub.send(client, ToPage::problem(&error.to_string())),
            }
            return Ok(true);
        }
        let Some(mut film) = self.film.take() else { return Ok(false) };
        if self.hub.film_cancelled() || !self.hub.has(film.client()) {
            self.hub.send(film.client(), ToPage::json(&json!({ "type": "film", "cancelled": true })));
            return Ok(true);
        }
        match film.advance(painter, &self.base) {
            Ok(progress) => {
                self.hub.send(film.client(), ToPage::json(&progress));
                self.film = (!film.is_done()).then_some(film);
            }
            Err(error) => self.reply(film.client(), Err(error))?,
        }
        Ok(true)
    }
}

/// What must end the program.
fn fatal(error: Error) -> Result<()> {
    match error {
        Error::DeviceLost { .. } | Error::Timeout { .. } => Err(error),
        _ => Ok(()),
    }
}
