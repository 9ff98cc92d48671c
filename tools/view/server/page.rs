//! A page's WebSocket. Replies go out before more is read, and reading is rate-limited: a page that floods delays only itself,
//! and takes no memory or time from the others.

use super::open_connections::OpenConnection;
use super::{AppState, refusal};
use crate::hub::Hub;
use crate::pace::Pace;
use crate::protocol::{FromPage, ToPage};
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::Response;
use serde_json::json;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A page that does not take a message within this time is given up.
const PATIENCE: Duration = Duration::from_secs(30);
const PING: Duration = if cfg!(test) { Duration::from_millis(100) } else { Duration::from_secs(15) };
/// Silence after which a page is given up: a laptop that falls asleep never says that it leaves.
pub(super) const SILENCE: Duration = PING.saturating_mul(3);
const LONGEST_MESSAGE: usize = 256 * 1024;
/// Nothing more is read while this many replies wait.
const MAX_REPLIES: usize = 16;

const TOO_MANY: &str = "too many pages look on already";

pub async fn socket(
    State(state): State<Arc<AppState>>,
    Extension(connection): Extension<Arc<OpenConnection>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !state.hub.accepts_pages() {
        return refusal(StatusCode::SERVICE_UNAVAILABLE, TOO_MANY);
    }
    let upgrade = upgrade.max_message_size(LONGEST_MESSAGE).max_frame_size(LONGEST_MESSAGE);
    upgrade.on_upgrade(move |socket| {
        connection.becomes_page();
        serve_page(socket, state.hub.clone())
    })
}

/// Says why a page's WebSocket does not open: browsers hide the handshake's answer from the page.
pub async fn explain(State(state): State<Arc<AppState>>) -> Response {
    if !state.hub.accepts_pages() {
        return refusal(StatusCode::SERVICE_UNAVAILABLE, TOO_MANY);
    }
    let problem = "WebSockets do not arrive here: a proxy must pass on the headers Upgrade and Connection";
    refusal(StatusCode::UPGRADE_REQUIRED, problem)
}

/// A connected page. It leaves the hub when this is dropped, also by a panic.
struct PageGuard {
    hub: Arc<Hub>,
    client: u64,
}

impl Drop for PageGuard {
    fn drop(&mut self) {
        self.hub.leave(self.client);
    }
}

async fn serve_page(mut socket: WebSocket, hub: Arc<Hub>) {
    let Some((client, outbox)) = hub.join() else { return };
    let _guard = PageGuard { hub: hub.clone(), client };
    let mut clock = tokio::time::interval(PING);
    let mut last_message = Instant::now();
    let mut pace = Pace::new();
    loop {
        let wait = pace.wait();
        let listens = wait.is_zero() && outbox.texts() < MAX_REPLIES;
        let message = tokio::select! {
            // Replies first; received messages count before the clock.
            biased;
            message = outbox.take() => match message {
                Some(ToPage::Text(text)) => {
                    pace.spend(text.len());
                    Message::Text(text.into())
                }
                Some(ToPage::Binary(bytes)) => Message::Binary(bytes.into()),
                None => break,
            },
            message = socket.recv(), if listens => {
                last_message = Instant::now();
                match message {
                    Some(Ok(Message::Text(text))) => {
                        pace.spend(text.len());
                        handle_message(&hub, client, text.as_str());
                    }
                    Some(Ok(Message::Close(_)) | Err(_)) | None => break,
                    Some(Ok(other)) => pace.spend(other.into_data().len()),
                }
                continue;
            },
            _ = clock.tick() => {
                if last_message.elapsed() > SILENCE {
                    break;
                }
                Message::Ping(Default::default())
            }
            () = tokio::time::sleep(wait), if !wait.is_zero() => {
                // The page was not read during this wait, so its silence does not count.
                last_message = Instant::now();
                continue;
            }
        };
        if !matches!(tokio::time::timeout(PATIENCE, socket.send(message)).await, Ok(Ok(()))) {
            break;
        }
    }
}

/// Handles a page's message, or queues it for the rendering thread.
fn handle_message(hub: &Hub, client: u64, text: &str) {
    let refuse = |message: &str| hub.send(client, ToPage::problem(message));
    match serde_json::from_str(text) {
        Ok(FromPage::View(view)) => hub.set_view(client, view),
        Ok(FromPage::Ack {}) => hub.acknowledge(client),
        Ok(FromPage::Pick(pick)) => {
            if !hub.pick(client, pick) {
                refuse("too many pixels asked for at once");
            }
        }
        Ok(FromPage::Status { since }) => {
            if let Some(status) = hub.status(since) {
                hub.send(client, ToPage::Text(status));
            }
        }
        Ok(FromPage::Train { action }) => {
            if !hub.act(action) {
                refuse("nothing is trained here, or it has been told too much at once");
            }
        }
        Ok(FromPage::Film(request)) => match hub.film(client, request) {
            Some(before) => hub.send(client, ToPage::json(&json!({ "type": "film", "waiting": before }))),
            None => refuse("this page's film is being made: cancel it first"),
        },
        Ok(FromPage::Cancel) => {
            if hub.cancel_film(client) {
                hub.send(client, ToPage::film_is_cancelled());
            }
        }
        Ok(FromPage::Edit(edit)) => {
            if let Err(problem) = hub.edit(client, edit) {
                refuse(problem);
            }
        }
        Err(error) => refuse(&format!("not understood: {error}")),
    }
}
