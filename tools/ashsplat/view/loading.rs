//! Scenes are read on a thread of their own: pages are served meanwhile, and told what is going on.

use super::hub::Hub;
use super::openings::Turn;
use super::protocol::ToPage;
use super::subject::Subject;
use ashsplat::{Error, Result};
use serde_json::{Value, json};
use std::thread::{Scope, ScopedJoinHandle};
use tempfile::TempDir;

/// A scene that is being read.
pub struct Loading<'scope> {
    name: String,
    thread: ScopedJoinHandle<'scope, Result<Subject>>,
    /// Of what a page opened: kept until it is read.
    opened: Option<(Turn, Option<TempDir>)>,
}

impl<'scope> Loading<'scope> {
    /// Begins to read.
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

    /// Keeps what belongs to a page's wish until the end.
    pub fn keeping(self, turn: Turn, upload: Option<TempDir>) -> Loading<'scope> {
        Loading { opened: Some((turn, upload)), ..self }
    }

    /// What is read.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether [`Loading::finish`] waits no more.
    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// What was read.
    pub fn finish(self) -> Result<Subject> {
        let read = self.thread.join();
        read.unwrap_or_else(|_| Err(Error::argument("viewer", format!("reading {} has failed", self.name))))
    }

    /// The folder of a file that a page has sent, which says nothing to people.
    pub fn room(&self) -> Option<String> {
        let (_, upload) = self.opened.as_ref()?;
        Some(format!("{}{}", upload.as_ref()?.path().display(), std::path::MAIN_SEPARATOR))
    }
}

/// What a page is told while something is read.
pub fn message(name: &str) -> Value {
    json!({ "type": "loading", "name": name })
}

/// What it is told when that has failed. Of a file that it has sent, not in which folder that was.
pub fn failure(name: &str, error: &Error, room: Option<&str>) -> ToPage {
    let said = error.to_string();
    let said = room.map_or(said.clone(), |room| said.replace(room, ""));
    ToPage::json(&json!({ "type": "loading", "name": name, "failed": said }))
}
