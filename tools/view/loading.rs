//! Scenes are read on their own thread. Meanwhile pages are served, and get a message that something is read.

use super::hub::Hub;
use super::openings::Turn;
use super::protocol::ToPage;
use super::subject::Subject;
use ashsplat::{Error, Result};
use serde_json::{Value, json};
use std::thread::{Scope, ScopedJoinHandle};
use tempfile::TempDir;

pub struct Loading<'scope> {
    name: String,
    thread: ScopedJoinHandle<'scope, Result<Subject>>,
    /// A page's right to open a scene, and the file that it sent: kept until the scene is read.
    opened: Option<(Turn, Option<TempDir>)>,
}

impl<'scope> Loading<'scope> {
    pub fn begin(
        threads: &'scope Scope<'scope, '_>,
        hub: &Hub,
        name: String,
        read: impl FnOnce() -> Result<Subject> + Send + 'scope,
    ) -> Result<Loading<'scope>> {
        hub.broadcast(&ToPage::json(&message(&name)));
        let thread = std::thread::Builder::new().name("reader".into()).spawn_scoped(threads, read);
        let thread = thread.map_err(|e| Error::argument("viewer", format!("no thread to read with: {e}")))?;
        Ok(Loading { name, thread, opened: None })
    }

    /// Keeps a page's right and its file until the scene is read.
    pub fn keeping(self, turn: Turn, upload: Option<TempDir>) -> Loading<'scope> {
        Loading { opened: Some((turn, upload)), ..self }
    }

    /// Name of the scene.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// True if [`Loading::finish`] would not wait.
    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    pub fn finish(self) -> Result<Subject> {
        let read = self.thread.join();
        read.unwrap_or_else(|_| Err(Error::argument("viewer", format!("reading {} has failed", self.name))))
    }

    /// Folder of a file that a page has sent: its path means nothing to people.
    pub fn room(&self) -> Option<String> {
        let (_, upload) = self.opened.as_ref()?;
        Some(format!("{}{}", upload.as_ref()?.path().display(), std::path::MAIN_SEPARATOR))
    }
}

/// Message to pages while a scene is read.
pub fn message(name: &str) -> Value {
    json!({ "type": "loading", "name": name })
}

/// Message to pages when reading has failed, without the path of the uploaded file's folder.
pub fn failure(name: &str, error: &Error, room: Option<&str>) -> ToPage {
    let said = error.to_string();
    let said = room.map_or(said.clone(), |room| said.replace(room, ""));
    ToPage::json(&json!({ "type": "loading", "name": name, "failed": said }))
}
