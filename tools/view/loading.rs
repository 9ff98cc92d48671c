//! Scenes are read on their own thread. Meanwhile pages are served, and get a message that something is read.

use super::hub::Hub;
use super::loaded_scene::LoadedScene;
use super::openings::OpenRequest;
use super::protocol::ToPage;
use ashsplat::{Error, Result};
use serde_json::{Value, json};
use std::thread::{Scope, ScopedJoinHandle};

pub struct Loading<'scope> {
    request: OpenRequest,
    thread: ScopedJoinHandle<'scope, Result<LoadedScene>>,
}

impl<'scope> Loading<'scope> {
    pub fn begin(
        threads: &'scope Scope<'scope, '_>,
        hub: &Hub,
        request: OpenRequest,
        read: impl FnOnce() -> Result<LoadedScene> + Send + 'scope,
    ) -> Result<Loading<'scope>> {
        hub.broadcast(&ToPage::json(&message(&request.name)));
        let thread = std::thread::Builder::new().name("reader".into()).spawn_scoped(threads, read);
        let thread = thread.map_err(|e| Error::argument("viewer", format!("no thread to read with: {e}")))?;
        Ok(Loading { request, thread })
    }

    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// Returns the request, which holds the files until it is dropped.
    pub fn finish(self) -> (OpenRequest, Result<LoadedScene>) {
        let Self { request, thread } = self;
        let failed = |_| Err(Error::argument("viewer", format!("reading {} has failed", request.name)));
        let read = thread.join().unwrap_or_else(failed);
        (request, read)
    }
}

/// Message to pages while a scene is read.
pub fn message(name: &str) -> Value {
    json!({ "type": "loading", "name": name })
}

/// Message to pages when reading has failed, without the path of the uploaded file's folder.
pub fn failure(name: &str, error: &Error, prefix: Option<&str>) -> ToPage {
    let text = error.to_string();
    let text = prefix.map_or(text.clone(), |prefix| text.replace(prefix, ""));
    ToPage::json(&json!({ "type": "loading", "name": name, "failed": text }))
}
