//! The page and its WebSocket over HTTP, on their own threads. They never use the device.

mod access;
mod connections;
mod export;
mod files;
mod open_connections;
mod opening;
mod page;

use super::assets;
use super::hub::Hub;
use super::openings::Openings;
use super::photos::{Client, Photos, Refusal, Size};
use ashsplat::{Error, Result};
use ashsplat_program::session::locked;
use axum::extract::{Path as UrlPath, State};
use axum::http::{StatusCode, Uri, header};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Router};
use clap::Args;
use open_connections::{Limits, OpenConnection};
use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, Once};
use std::thread::JoinHandle;
use tokio::sync::{Semaphore, oneshot};

/// Where the page is served.
#[derive(Args, Clone, Debug)]
pub struct ServeArguments {
    /// Address to listen at; another than this machine's own needs --token
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub host: String,
    /// Port of the page; 0 takes a free one
    #[arg(long, value_name = "N", default_value_t = 8090)]
    pub port: u16,
    /// Word that the page's address must contain: http://HOST:PORT/?token=WORD
    #[arg(long, value_name = "WORD")]
    pub token: Option<String>,
    /// Address at which a proxy shows the page, if it changes the header Host or no token is wanted there:
    /// https://HOST[:PORT]
    #[arg(long, value_name = "ORIGIN", value_parser = origin)]
    pub allow_origin: Option<String>,
    /// True for the options of `train --view`, which have other names.
    #[arg(skip)]
    pub of_training: bool,
}

impl ServeArguments {
    /// Names of --host, --port, --token and --allow-origin, and the option that chooses another port.
    fn names(&self) -> [&'static str; 5] {
        match self.of_training {
            true => ["--view-host", "--view", "--view-token", "--view-allow-origin", "--view=PORT"],
            false => ["--host", "--port", "--token", "--allow-origin", "--port N"],
        }
    }
}

/// Parses an origin in the browsers' form: without the scheme's default port.
pub fn origin(text: &str) -> std::result::Result<String, String> {
    let origin = text.trim_end_matches('/').to_ascii_lowercase();
    let host = |scheme: &str, port: &str| {
        let host = origin.strip_prefix(scheme)?;
        let host = host.strip_suffix(port).unwrap_or(host);
        let is_name = !host.is_empty() && !host.contains(['/', '?', '#', '@', ' ']);
        is_name.then(|| format!("{scheme}{host}"))
    };
    let origin = host("https://", ":443").or_else(|| host("http://", ":80"));
    origin.ok_or_else(|| "expected http://HOST[:PORT] or https://HOST[:PORT]".into())
}

/// Threads for photos; exports have their own.
const WORKERS: usize = 2;

pub struct AppState {
    hub: Arc<Hub>,
    photos: Mutex<Option<Arc<Photos>>>,
    films: PathBuf,
    serve: ServeArguments,
    /// Limits the message about refused foreign pages to one.
    refused: Once,
    /// None if pages may open nothing.
    pub openings: Option<Arc<Openings>>,
    exports: Arc<Semaphore>,
}

impl AppState {
    pub fn new(hub: Arc<Hub>, films: PathBuf, serve: ServeArguments) -> AppState {
        let exports = Arc::new(Semaphore::new(export::MAX_EXPORTS));
        Self { hub, photos: Mutex::default(), films, serve, refused: Once::new(), openings: None, exports }
    }

    pub fn show_photos(&self, photos: Option<Arc<Photos>>) {
        *locked(&self.photos) = photos;
    }

    fn photos(&self) -> Option<Arc<Photos>> {
        locked(&self.photos).clone()
    }
}

/// True if only this machine reaches the open port, also through a proxy.
pub fn is_for_this_machine(listener: &TcpListener, arguments: &ServeArguments) -> bool {
    let is_loopback = listener.local_addr().is_ok_and(|address| address.ip().is_loopback());
    is_loopback && arguments.allow_origin.is_none()
}

/// The running server. Dropping it also drops what its state holds, such as an unpacked data set.
pub struct Server {
    pub address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

pub fn start(listener: TcpListener, state: impl Into<Arc<AppState>>) -> Result<Server> {
    let state = state.into();
    let failed = |e: std::io::Error| Error::argument("viewer", format!("cannot listen: {e}"));
    let address = listener.local_addr().map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        // One more thread lists paths.
        .max_blocking_threads(WORKERS + export::MAX_EXPORTS + 1)
        .enable_all()
        .build()
        .map_err(failed)?;
    let (stop, stopped) = oneshot::channel();
    let serve = async move {
        let listener = tokio::net::TcpListener::from_std(listener)?;
        tokio::select! {
            () = connections::serve(listener, router(state), Limits::of_process()) => Ok(()),
            _ = stopped => Ok(()),
        }
    };
    let thread = std::thread::Builder::new().name("viewer".into());
    let run = move || {
        let ended: std::io::Result<()> = runtime.block_on(serve);
        if let Err(error) = ended {
            errln!("warning: the viewer's server has ended: {error}");
        }
    };
    let thread = thread.spawn(run).map_err(failed)?;
    Ok(Server { address, stop: Some(stop), thread: Some(thread) })
}

/// Opens the port. An address that other machines can reach requires a token.
pub fn open(arguments: &ServeArguments) -> Result<TcpListener> {
    let ServeArguments { host, port, token, .. } = arguments;
    let [host_option, port_option, token_option, _, other_port] = arguments.names();
    let plain = |word: &str| word.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
    if token.as_ref().is_some_and(|token| token.is_empty() || !plain(token)) {
        let problem = "must be of letters, digits, '-', '_' and '.', since it stands in the page's address";
        return Err(Error::argument(token_option, problem));
    }
    let addresses = (host.as_str(), *port).to_socket_addrs();
    let addresses: Vec<SocketAddr> = addresses
        .map_err(|e| Error::argument(host_option, format!("'{host}' is no address of this machine: {e}")))?
        .collect();
    let to_others = addresses.iter().any(|address| !address.ip().is_loopback());
    if to_others && token.is_none() {
        let problem =
            format!("'{host}' can be reached by others: give a secret word with {token_option} WORD");
        return Err(Error::argument(host_option, problem));
    }
    TcpListener::bind(addresses.as_slice()).map_err(|e| {
        let problem = match e.kind() {
            std::io::ErrorKind::AddrInUse => {
                format!(
                    "port {port} of {host} is in use by another program; choose another with {other_port}"
                )
            }
            _ => format!("cannot listen at {host}:{port}: {e}"),
        };
        Error::argument(port_option, problem)
    })
}

fn router(state: Arc<AppState>) -> Router {
    Router::new()
        .route("/socket", get(page::socket).post(page::explain))
        .route(
            "/photo/{index}",
            get(|state, connection, index, uri| photo(Size::Full, state, connection, index, uri)),
        )
        .route(
            "/thumbnail/{index}",
            get(|state, connection, index, uri| photo(Size::Thumbnail, state, connection, index, uri)),
        )
        .route("/film/{name}", get(film))
        .route("/export/{name}", get(export::export))
        .route("/count", get(export::count))
        .route("/upload/{name}", post(opening::upload))
        .route("/open", post(opening::open))
        .route("/paths", post(opening::paths))
        .fallback(asset)
        .layer(middleware::from_fn_with_state(state.clone(), access::guard))
        .with_state(state)
}

async fn asset(uri: Uri) -> Response {
    match assets::find(uri.path()) {
        Some((kind, text)) => {
            ([(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-cache")], text).into_response()
        }
        None => refusal(
            StatusCode::NOT_FOUND,
            "there is nothing of this name; a proxy must take its own path off",
        ),
    }
}

fn refusal(code: StatusCode, problem: &str) -> Response {
    (code, format!("{}: {problem}\n", code.as_u16())).into_response()
}

/// Answers with JSON that no cache keeps.
fn json_answer(text: String) -> Response {
    let kind = [(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-store")];
    (kind, text).into_response()
}

/// Asks the page to try again soon.
fn busy(problem: &str) -> Response {
    ([(header::RETRY_AFTER, "1")], refusal(StatusCode::SERVICE_UNAVAILABLE, problem)).into_response()
}

/// Answers with a photo of the data set as JPEG. Pages send their number, so that one with many requests does not delay the others.
async fn photo(
    size: Size,
    State(state): State<Arc<AppState>>,
    Extension(connection): Extension<Arc<OpenConnection>>,
    UrlPath(index): UrlPath<usize>,
    uri: Uri,
) -> Response {
    let page = access::query_value(&uri, "page").and_then(|page| page.parse().ok());
    let client = Client { peer: connection.peer, page: page.filter(|page| state.hub.has_page(*page)) };
    let Some(photos) = state.photos() else { return StatusCode::NOT_FOUND.into_response() };
    // Photo addresses carry the run's name, so another scene at this port has different ones.
    match photos.jpeg(index, size, client).await {
        Ok(bytes) => {
            let kind = [(header::CONTENT_TYPE, "image/jpeg"), (header::CACHE_CONTROL, "max-age=3600")];
            (kind, bytes).into_response()
        }
        Err(Refusal::Problem(problem)) => (StatusCode::UNPROCESSABLE_ENTITY, problem).into_response(),
        Err(Refusal::Unknown) => StatusCode::NOT_FOUND.into_response(),
        Err(Refusal::Busy) => busy("too many photos are asked for at once"),
    }
}

/// Answers with a film's file of this run; other files in the folder are not served.
async fn film(State(state): State<Arc<AppState>>, UrlPath(name): UrlPath<String>) -> Response {
    if !state.hub.has_film_file(&name) {
        return StatusCode::NOT_FOUND.into_response();
    }
    let kind = match name.rsplit_once('.') {
        Some((_, "gif")) => "image/gif",
        Some((_, "mp4")) => "video/mp4",
        Some((_, "json")) => "application/json",
        _ => "application/octet-stream",
    };
    match files::body(&state.films.join(&name), ()) {
        Some(body) => ([(header::CONTENT_TYPE, kind)], body).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::page::SILENCE;
    use super::*;
    use std::time::{Duration, Instant};

    /// One page reads, and so answers pings. The other has gone without closing its connection.
    #[test]
    fn silent_pages_are_given_up() {
        let hub = Arc::new(Hub::default());
        hub.greet_with(&serde_json::json!({}));
        let (host, of_training) = ("127.0.0.1".into(), false);
        let serve = ServeArguments { host, port: 0, token: None, allow_origin: None, of_training };
        let state = AppState::new(hub.clone(), PathBuf::new(), serve.clone());
        let server = start(open(&serve).expect("a port"), state).expect("a server");
        let address = server.address;
        let page = || {
            let stream = std::net::TcpStream::connect(address).expect("connected");
            tungstenite::client(format!("ws://{address}/socket"), stream).expect("a WebSocket").0
        };
        let (mut awake, _asleep) = (page(), page());
        let pages = |wanted: usize| {
            let start = Instant::now();
            while hub.pages() != wanted && start.elapsed() < Duration::from_secs(60) {
                std::thread::sleep(Duration::from_millis(5));
            }
            assert_eq!(hub.pages(), wanted);
        };
        pages(2);
        let (stop, stopped) = std::sync::mpsc::channel::<()>();
        let reading = std::thread::spawn(move || {
            while stopped.try_recv() == Err(std::sync::mpsc::TryRecvError::Empty) {
                awake.read().expect("a ping");
            }
            awake
        });
        pages(1);
        std::thread::sleep(2 * SILENCE);
        assert_eq!(hub.pages(), 1);
        drop(stop);
        drop(reading.join().expect("it reads"));
        pages(0);
        drop(server);
        assert!(std::net::TcpStream::connect(address).is_err() && Arc::strong_count(&hub) == 1);
    }
}
