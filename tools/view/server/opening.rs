//! Files that pages send, and paths that they name: see [`openings`].

use super::access::query_value;
use super::{AppState, busy, json_answer, refusal};
use crate::openings::{self, OpenRequest, Openings};
use ashsplat_files::splats::Format;
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{Path as UrlPath, Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::body::{Body as _, Frame};
use serde_json::Value;
use std::fs::File;
use std::future::poll_fn;
use std::io::Write;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest message that names a path, bytes.
const LONGEST_MESSAGE: usize = 64 << 10;
/// Basic time for an upload.
const GRACE: Duration = Duration::from_secs(60);
/// Received bytes that add one second to that time. A slower sender would keep others from sending.
const BYTES_PER_SECOND: u64 = 256 << 10;
/// Most bytes of a refused upload that are still read.
const MAX_DRAINED: usize = 16 << 20;
/// Longest time for reading them.
const LINGER: Duration = Duration::from_secs(1);
/// Most letters of a file's name on disk.
const LONGEST_STEM: usize = 60;
/// Most letters of a file's name on the page.
const LONGEST_NAME: usize = 200;

/// `POST /upload/NAME.ply` with the file's bytes; `?add=1` opens it beside the scenes that are open.
pub async fn upload(
    State(state): State<Arc<AppState>>,
    UrlPath(name): UrlPath<String>,
    request: Request,
) -> Response {
    let (head, mut body) = request.into_parts();
    let add = query_value(&head.uri, "add").is_some();
    match take_in(&state, (&name, add), &head.headers, &mut body).await {
        Ok(()) => StatusCode::ACCEPTED.into_response(),
        Err(refused) => {
            drain(&mut body).await;
            refused
        }
    }
}

/// On refusal, part of the body may be left unread.
async fn take_in(
    state: &AppState,
    (name, add): (&str, bool),
    headers: &HeaderMap,
    body: &mut Body,
) -> Result<(), Response> {
    let openings = state.openings.as_ref().ok_or_else(not_here)?;
    // Foreign pages cannot send this content type without a preflight request.
    if !is_kind(headers, "application/octet-stream") {
        let problem = "send a file as application/octet-stream";
        return Err(refusal(StatusCode::UNSUPPORTED_MEDIA_TYPE, problem));
    }
    let format = openings::format_of(name).ok_or_else(|| {
        let known = openings.described()["formats"].to_string();
        refusal(StatusCode::UNSUPPORTED_MEDIA_TYPE, &format!("{name}: give a file of one of {known}"))
    })?;
    let length = headers.get(header::CONTENT_LENGTH).and_then(|text| text.to_str().ok()?.parse().ok());
    let length =
        length.ok_or_else(|| refusal(StatusCode::LENGTH_REQUIRED, "the file's length is missing"))?;
    let max_bytes = openings.max_bytes;
    if length > max_bytes {
        let problem = format!("{name}: has {length} bytes; reading may take {max_bytes} (--max-host-memory)");
        return Err(refusal(StatusCode::PAYLOAD_TOO_LARGE, &problem));
    }
    let permit = Some(openings.permit().ok_or_else(occupied)?);
    let folder = tempfile::tempdir().map_err(no_room)?;
    let path = folder.path().join(plain(name, format));
    receive(body, &path, length).await?;
    let name = name.chars().filter(|c| !c.is_control()).take(LONGEST_NAME).collect();
    openings.submit(OpenRequest { path, name, add, within: None, upload: Some(folder), permit });
    Ok(())
}

/// A file name that is valid in any folder: letters and digits of the page's name, and the ending.
fn plain(name: &str, format: Format) -> String {
    let stem = &name[..name.len() - format.extension().len()];
    let letter = |c: char| if c.is_ascii_alphanumeric() || "-_".contains(c) { c } else { '_' };
    format!("{}{}", stem.chars().map(letter).take(LONGEST_STEM).collect::<String>(), format.extension())
}

/// `POST /open` with `{"path": "…"}`.
pub async fn open(State(state): State<Arc<AppState>>, request: Request) -> Result<StatusCode, Response> {
    let (openings, name) = named(&state, request).await?;
    let name = name.trim();
    let found = openings.find(name);
    let (path, folder) = found.map_err(|problem| refusal(StatusCode::NOT_FOUND, &problem))?;
    let within = Some(folder.to_owned());
    let permit = openings.permit().ok_or_else(occupied)?;
    let (name, permit) = (name.to_owned(), Some(permit));
    openings.submit(OpenRequest { path, name, within, permit, ..OpenRequest::default() });
    Ok(StatusCode::ACCEPTED)
}

/// The path that a request has, and the bounds of what pages may open.
async fn named(state: &AppState, request: Request) -> Result<(&Arc<Openings>, String), Response> {
    let openings = state.openings.as_ref().ok_or_else(not_here)?;
    if !is_kind(request.headers(), "application/json") {
        return Err(refusal(StatusCode::UNSUPPORTED_MEDIA_TYPE, "send a path as application/json"));
    }
    let message = tokio::time::timeout(GRACE, to_bytes(request.into_body(), LONGEST_MESSAGE)).await;
    let message =
        message.ok().and_then(Result::ok).and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
    let name = message.as_ref().and_then(|message| message["path"].as_str());
    let name = name.ok_or_else(|| refusal(StatusCode::BAD_REQUEST, "expected {\"path\": \"…\"}"))?;
    Ok((openings, name.to_owned()))
}

/// `POST /paths` with `{"path": "…"}`: answers with the paths that start with it, `{"paths": ["…"], "more": false}`.
pub async fn paths(State(state): State<Arc<AppState>>, request: Request) -> Result<Response, Response> {
    let (openings, begin) = named(&state, request).await?;
    let openings = openings.clone();
    let failed = || StatusCode::INTERNAL_SERVER_ERROR.into_response();
    let permit = openings.listing.clone().acquire_owned().await.map_err(|_| failed())?;
    let work = move || {
        let _turn = permit;
        openings.list(&begin).to_string()
    };
    let list = tokio::task::spawn_blocking(work).await.map_err(|_| failed())?;
    Ok(json_answer(list))
}

/// Waits for the next piece of an upload.
async fn next(body: &mut Body) -> Option<Result<Frame<Bytes>, axum::Error>> {
    poll_fn(|context| Pin::new(&mut *body).poll_frame(context)).await
}

/// Writes the received bytes, at most `length`. Time grows with bytes received, not with bytes announced.
async fn receive(body: &mut Body, path: &Path, length: u64) -> Result<(), Response> {
    let incomplete = || refusal(StatusCode::BAD_REQUEST, "the file has not come whole");
    let slow = || refusal(StatusCode::REQUEST_TIMEOUT, "the file has come too slowly");
    let mut file = File::create(path).map_err(no_room)?;
    let begun = Instant::now();
    let mut left = length;
    loop {
        let time = GRACE + Duration::from_secs((length - left) / BYTES_PER_SECOND);
        let time = time.checked_sub(begun.elapsed()).ok_or_else(slow)?;
        let come = tokio::time::timeout(time, next(body)).await.map_err(|_| slow())?;
        let Some(frame) = come else { break };
        let Ok(bytes) = frame.map_err(|_| incomplete())?.into_data() else { continue };
        left = left.checked_sub(bytes.len() as u64).ok_or_else(incomplete)?;
        file.write_all(&bytes).map_err(no_room)?;
    }
    if left == 0 { Ok(()) } else { Err(incomplete()) }
}

/// Reads some of what is still sent: a browser that is cut off while sending may not show the refusal.
async fn drain(body: &mut Body) {
    let rest = async {
        let mut left = MAX_DRAINED;
        while let Some(Ok(frame)) = next(body).await {
            let bytes = frame.data_ref().map_or(0, Bytes::len);
            let Some(rest) = left.checked_sub(bytes) else { return };
            left = rest;
        }
    };
    tokio::time::timeout(LINGER, rest).await.ok();
}

fn is_kind(headers: &HeaderMap, kind: &str) -> bool {
    headers.get(header::CONTENT_TYPE).is_some_and(|value| value == kind)
}

fn not_here() -> Response {
    let problem =
        "this viewer shows what it was started with; start `ashsplat view` without a path to open others";
    refusal(StatusCode::FORBIDDEN, problem)
}

fn occupied() -> Response {
    busy("another scene is being opened")
}

fn no_room(error: std::io::Error) -> Response {
    let place = std::env::temp_dir();
    let problem = format!("{}: cannot write a temporary file: {error}", place.display());
    refusal(StatusCode::INSUFFICIENT_STORAGE, &problem)
}
