//! The page and its WebSocket, over HTTP: on threads of its own, which never touch the device.

use super::assets;
use super::hub::{Hub, Pick};
use super::photos::{Photos, Size};
use super::protocol::{FromPage, ToPage};
use ashsplat::{Error, Result};
use axum::Router;
use axum::body::Body;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path as UrlPath, Request, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use clap::Args;
use serde_json::json;
use std::net::{IpAddr, SocketAddr, TcpListener, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::unbounded_channel;
use tokio::sync::oneshot;

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
    /// Whether these are the options of `train --view`, which have other names.
    #[arg(skip)]
    pub of_training: bool,
}

/// A page that does not take a message within this time is given up.
const PATIENCE: Duration = Duration::from_secs(30);
/// So often a page is asked whether it is still there,
const PING: Duration = if cfg!(test) { Duration::from_millis(100) } else { Duration::from_secs(15) };
/// and it is given up when nothing has come of it for so long: a laptop asleep never says that it goes.
const SILENCE: Duration = PING.saturating_mul(3);
/// Longest message of a page.
const LONGEST_MESSAGE: usize = 256 * 1024;

/// What requests are answered from.
pub struct Site {
    pub hub: Arc<Hub>,
    pub photos: Option<Arc<Photos>>,
    /// Where films lie.
    pub films: PathBuf,
    pub token: Option<String>,
}

/// What serves, as long as the value lives: with it goes all that the site holds, an unpacked data set, say.
pub struct Server {
    /// Where the page is.
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

/// Starts to serve.
pub fn start(arguments: &ServeArguments, site: Site) -> Result<Server> {
    let listener = bind(arguments)?;
    let failed = |e: std::io::Error| Error::argument("viewer", format!("cannot listen: {e}"));
    let address = listener.local_addr().map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
    let (stop, stopped) = oneshot::channel();
    let serve = async move {
        let listener = tokio::net::TcpListener::from_std(listener)?;
        tokio::select! {
            ended = axum::serve(listener, router(Arc::new(site))) => ended,
            _ = stopped => Ok(()),
        }
    };
    let thread = std::thread::Builder::new().name("viewer".into());
    let run = move || {
        let ended: std::io::Result<()> = runtime.block_on(serve);
        if let Err(error) = ended {
            tell!("warning: the viewer's server has ended: {error}");
        }
    };
    let thread = thread.spawn(run).map_err(failed)?;
    Ok(Server { address, stop: Some(stop), thread: Some(thread) })
}

/// Opens the port; an address that others can reach wants a token.
fn bind(arguments: &ServeArguments) -> Result<TcpListener> {
    let ServeArguments { host, port, token, of_training } = arguments;
    let [host_option, port_option, token_option, other_port] = match of_training {
        true => ["--view-host", "--view", "--view-token", "--view=PORT"],
        false => ["--host", "--port", "--token", "--port N"],
    };
    let plain = |word: &str| word.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
    if token.as_ref().is_some_and(|token| token.is_empty() || !plain(token)) {
        let problem = "must be of letters, digits, '-', '_' and '.', since it stands in the page's address";
        return Err(Error::argument(token_option, problem));
    }
    let addresses = (host.as_str(), *port).to_socket_addrs();
    let addresses: Vec<SocketAddr> = addresses
        .map_err(|e| Error::argument(host_option, format!("'{host}' is no address of this machine: {e}")))?
        .collect();
    let open = addresses.iter().any(|address| !address.ip().is_loopback());
    if open && token.is_none() {
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

fn router(site: Arc<Site>) -> Router {
    Router::new()
        .route("/socket", get(socket))
        .route("/photo/{index}", get(photo))
        .route("/thumbnail/{index}", get(thumbnail))
        .route("/film/{name}", get(film))
        .fallback(asset)
        .layer(middleware::from_fn_with_state(site.clone(), guard))
        .with_state(site)
}

/// Lets in who knows the token; without one, only pages that were opened under a name of this machine itself, so that
/// no foreign page can have its name point here.
async fn guard(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    if let Some(token) = &site.token {
        let given = query_value(request.uri(), "token").or_else(|| cookie(headers, &cookie_name(headers)));
        if !given.is_some_and(|given| equal(given.as_bytes(), token.as_bytes())) {
            let text = "401: this viewer wants a token: open http://HOST:PORT/?token=WORD with the word that was given to --token\n";
            return (StatusCode::UNAUTHORIZED, text).into_response();
        }
    } else if !header_text(headers, header::HOST).is_some_and(is_own_name) {
        let text = "403: open this page as http://localhost:PORT/\n";
        return (StatusCode::FORBIDDEN, text).into_response();
    }
    let name = cookie_name(headers);
    let from_query = query_value(request.uri(), "token").filter(|_| site.token.is_some());
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let mut set = |name, value: &str| {
        if let Ok(value) = value.parse() {
            headers.insert(name, value);
        }
    };
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::REFERRER_POLICY, "no-referrer");
    set(
        header::CONTENT_SECURITY_POLICY,
        "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'",
    );
    if let Some(token) = from_query {
        set(header::SET_COOKIE, &format!("{name}={token}; HttpOnly; SameSite=Strict; Path=/"));
    }
    response
}

/// Whether a Host header names this machine from within.
fn is_own_name(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.chars().all(|c| c.is_ascii_digit()) => name,
        _ => host,
    };
    let bare = name.trim_start_matches('[').trim_end_matches(']');
    name == "localhost" || bare.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

fn header_text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// Browsers send a host's cookies to all its ports: those of several viewers must have several names. The port is the one
/// that the browser sees, which another may forward.
fn cookie_name(headers: &HeaderMap) -> String {
    let port =
        header_text(headers, header::HOST).and_then(|host| host.rsplit_once(':')?.1.parse::<u16>().ok());
    format!("ashsplat_token_{}", port.unwrap_or(80))
}

fn cookie(headers: &HeaderMap, name: &str) -> Option<String> {
    let all = header_text(headers, header::COOKIE)?;
    let find = |part: &str| Some(part.trim().strip_prefix(name)?.strip_prefix('=')?.to_owned());
    all.split(';').find_map(find)
}

fn query_value(uri: &Uri, name: &str) -> Option<String> {
    let find = |part: &str| Some(part.strip_prefix(name)?.strip_prefix('=')?.to_owned());
    uri.query()?.split('&').find_map(find)
}

/// Takes as long for a wrong word as for the right one.
fn equal(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |differs, (a, b)| differs | (a ^ b)) == 0
}

async fn asset(uri: Uri) -> Response {
    match assets::find(uri.path()) {
        Some((kind, text)) => {
            ([(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-cache")], text).into_response()
        }
        None => (StatusCode::NOT_FOUND, "404: there is nothing of this name\n").into_response(),
    }
}

/// A photo of the data set as JPEG.
async fn photo(State(site): State<Arc<Site>>, UrlPath(index): UrlPath<usize>) -> Response {
    send_photo(site, index, Size::Full).await
}

/// The same, small.
async fn thumbnail(State(site): State<Arc<Site>>, UrlPath(index): UrlPath<usize>) -> Response {
    send_photo(site, index, Size::Thumbnail).await
}

async fn send_photo(site: Arc<Site>, index: usize, size: Size) -> Response {
    let Some(photos) = site.photos.clone() else { return StatusCode::NOT_FOUND.into_response() };
    // The page's addresses of photos carry the run's name: of another scene at this port they are others.
    match tokio::task::spawn_blocking(move || photos.jpeg(index, size)).await {
        Ok(Some(Ok(bytes))) => {
            let kind = [(header::CONTENT_TYPE, "image/jpeg"), (header::CACHE_CONTROL, "max-age=3600")];
            (kind, Body::from(bytes.as_ref().clone())).into_response()
        }
        Ok(Some(Err(problem))) => (StatusCode::UNPROCESSABLE_ENTITY, problem).into_response(),
        _ => StatusCode::NOT_FOUND.into_response(),
    }
}

/// A file that a film left.
async fn film(State(site): State<Arc<Site>>, UrlPath(name): UrlPath<String>) -> Response {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '.' || c == '_' || c == '-';
    if !name.chars().all(plain) || name.starts_with('.') {
        return StatusCode::NOT_FOUND.into_response();
    }
    let kind = match name.rsplit_once('.') {
        Some((_, "gif")) => "image/gif",
        Some((_, "mp4")) => "video/mp4",
        Some((_, "json")) => "application/json",
        _ => "application/octet-stream",
    };
    let path = site.films.join(&name);
    match tokio::task::spawn_blocking(move || std::fs::read(path)).await {
        Ok(Ok(bytes)) => ([(header::CONTENT_TYPE, kind)], Body::from(bytes)).into_response(),
        _ => StatusCode::NOT_FOUND.into_response(),
    }
}

async fn socket(State(site): State<Arc<Site>>, headers: HeaderMap, upgrade: WebSocketUpgrade) -> Response {
    // A page of another site may open a WebSocket to anywhere; browsers say whose page it is.
    let own = match (header_text(&headers, header::ORIGIN), header_text(&headers, header::HOST)) {
        (Some(origin), Some(host)) => origin.split_once("://").is_some_and(|(_, name)| name == host),
        _ => true,
    };
    if !own {
        return (StatusCode::FORBIDDEN, "403: a page of another site\n").into_response();
    }
    let upgrade = upgrade.max_message_size(LONGEST_MESSAGE).max_frame_size(LONGEST_MESSAGE);
    upgrade.on_upgrade(move |socket| converse(socket, site.hub.clone()))
}

/// One page, from its coming to its going.
async fn converse(mut socket: WebSocket, hub: Arc<Hub>) {
    let (sender, mut outgoing) = unbounded_channel();
    let client = hub.join(sender);
    let mut clock = tokio::time::interval(PING);
    let mut heard = Instant::now();
    loop {
        let message = tokio::select! {
            // What has come counts before the clock.
            biased;
            message = socket.recv() => {
                heard = Instant::now();
                match message {
                    Some(Ok(Message::Text(text))) => heed(&hub, client, text.as_str()),
                    Some(Ok(Message::Close(_)) | Err(_)) | None => break,
                    Some(Ok(_)) => {}
                }
                continue;
            },
            message = outgoing.recv() => match message {
                Some(ToPage::Text(text)) => Message::Text(text.into()),
                Some(ToPage::Binary(bytes)) => Message::Binary(bytes.into()),
                None => break,
            },
            _ = clock.tick() => {
                if heard.elapsed() > SILENCE {
                    break;
                }
                Message::Ping(Default::default())
            }
        };
        if !matches!(tokio::time::timeout(PATIENCE, socket.send(message)).await, Ok(Ok(()))) {
            break;
        }
    }
    hub.leave(client);
}

/// Does what a page says, or notes it for the thread that renders.
fn heed(hub: &Hub, client: u64, text: &str) {
    let refuse = |message: &str| hub.send(client, ToPage::problem(message));
    match serde_json::from_str(text) {
        Ok(FromPage::View(view)) => hub.set_view(client, view),
        Ok(FromPage::Ack {}) => hub.acknowledge(client),
        Ok(FromPage::Pick { id, camera, look, pixel }) => {
            if !hub.pick(client, Pick { id, camera, look, pixel }) {
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
                hub.send(client, ToPage::json(&json!({ "type": "film", "cancelled": true })));
            }
        }
        Err(error) => refuse(&format!("not understood: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_this_machine() {
        for own in ["localhost", "localhost:8090", "127.0.0.1:1", "[::1]:8090", "[::1]"] {
            assert!(is_own_name(own), "{own}");
        }
        for foreign in ["example.org", "evil.localhost.example:80", "10.0.0.7:8090", ""] {
            assert!(!is_own_name(foreign), "{foreign}");
        }
    }

    #[test]
    fn cookies_are_of_the_port_that_the_browser_sees() {
        let headers = |host: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().expect("a header"));
            headers.insert(
                header::COOKIE,
                "ashsplat_token_9000=a; ashsplat_token_9001=b".parse().expect("a header"),
            );
            headers
        };
        for (host, expected) in
            [("localhost:9000", Some("a")), ("[::1]:9001", Some("b")), ("example.org", None)]
        {
            let headers = headers(host);
            assert_eq!(cookie(&headers, &cookie_name(&headers)).as_deref(), expected, "{host}");
        }
    }

    /// One page reads, and so answers pings. The other is gone without having closed its connection.
    #[test]
    fn silent_pages_are_given_up() {
        let hub = Arc::new(Hub::default());
        hub.greet_with("{}".into());
        let site = Site { hub: hub.clone(), photos: None, films: PathBuf::new(), token: None };
        let serve = ServeArguments { host: "127.0.0.1".into(), port: 0, token: None, of_training: false };
        let server = start(&serve, site).expect("a port");
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

    #[test]
    fn options_have_the_commands_names() {
        let serve =
            |of_training| ServeArguments { host: "0.0.0.0".into(), port: 0, token: None, of_training };
        let said = |of_training| bind(&serve(of_training)).expect_err("open to others").to_string();
        assert!(said(true).contains("--view-token WORD") && said(false).contains(" --token WORD"));
    }

    #[test]
    fn values_are_found() {
        let uri: Uri = "/a?x=1&token=secret&tokens=2".parse().expect("a URI");
        assert_eq!(query_value(&uri, "token").as_deref(), Some("secret"));
        assert!(equal(b"secret", b"secret") && !equal(b"secret", b"secre") && !equal(b"secret", b"sEcret"));
    }
}
