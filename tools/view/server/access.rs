//! Access control: requests with the token, and this server's own pages.

use super::{AppState, refusal};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;
use std::sync::Arc;

/// Admits requests with the token. Without a token, admits only pages opened under a name of this machine or that of
/// `--allow-origin`. This stops foreign sites that point their own name here.
pub async fn guard(State(state): State<Arc<AppState>>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let allowed = state.serve.allow_origin.as_deref();
    let allowed_host = allowed.and_then(|origin| Some(origin.split_once("://")?.1));
    let host = header_text(headers, header::HOST);
    if let Some(token) = &state.serve.token {
        let given = query_value(request.uri(), "token").or_else(|| cookie(headers, &cookie_name(headers)));
        if !given.is_some_and(|given| equal(given.as_bytes(), token.as_bytes())) {
            let text = "401: this viewer wants a token: open http://HOST:PORT/?token=WORD with the word that was given to --token\n";
            return (StatusCode::UNAUTHORIZED, text).into_response();
        }
    } else if !host.is_some_and(|host| is_own_name(host) || Some(host) == allowed_host) {
        return foreign(&state, headers, "a name that is not this machine's: open http://localhost:PORT/");
    }
    if !is_own_page(headers, allowed) && !is_visit(&request) {
        return foreign(&state, headers, "a page of another site");
    }
    let name = cookie_name(headers);
    let from_query = query_value(request.uri(), "token").filter(|_| state.serve.token.is_some());
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
        // The cookie is for the page's own folder: a proxy may show another viewer below another path.
        set(header::SET_COOKIE, &format!("{name}={token}; HttpOnly; SameSite=Strict"));
    }
    response
}

/// Refuses, and says how to admit a proxy: to the page, and once on stderr.
fn foreign(state: &AppState, headers: &HeaderMap, problem: &str) -> Response {
    let [origin, host] =
        [header::ORIGIN, header::HOST].map(|name| header_text(headers, name).unwrap_or("none"));
    let [.., option, _] = state.serve.names();
    let remedy = format!(
        "if a proxy shows this page, start the viewer with {option} and the page's http(s)://HOST[:PORT]"
    );
    state.refused.call_once(|| {
        errln!("warning: a request to the viewer was refused (Origin {origin:.100}, Host {host:.100}): {problem}; {remedy}");
    });
    refusal(StatusCode::FORBIDDEN, &format!("{problem}; {remedy}"))
}

/// True if no foreign page makes the request: browsers name the page's origin, other programs send none. An origin that names
/// no page counts as foreign, even an empty one.
fn is_own_page(headers: &HeaderMap, allowed: Option<&str>) -> bool {
    let host = header_text(headers, header::HOST);
    let own_origin = headers.get_all(header::ORIGIN).iter().all(|origin| {
        let origin = origin.to_str().ok();
        let name = origin.and_then(|origin| Some(origin.split_once("://")?.1));
        name.is_some_and(|name| !name.is_empty() && (Some(name) == host || origin == allowed))
    });
    let own_site =
        headers.get_all("sec-fetch-site").iter().all(|site| site == "same-origin" || site == "none");
    own_origin && own_site
}

/// True if a person follows a link to the page. The linking page learns nothing of the answer.
fn is_visit(request: &Request) -> bool {
    let headers = request.headers();
    let says = |name: &str, value: &str| headers.get(name).is_some_and(|own| own == value);
    let navigates = says("sec-fetch-mode", "navigate") && says("sec-fetch-dest", "document");
    request.uri().path() == "/" && navigates && !headers.contains_key(header::ORIGIN)
}

/// True if a Host header has a loopback address or the name localhost.
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

/// Name of the token's cookie. Browsers send a host's cookies to all its ports, so viewers need different names. The port is
/// the one that the browser sees, which may be forwarded.
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

pub fn query_value(uri: &Uri, name: &str) -> Option<String> {
    let find = |part: &str| Some(part.strip_prefix(name)?.strip_prefix('=')?.to_owned());
    uri.query()?.split('&').find_map(find)
}

/// Takes the same time for any wrong word of the right length.
fn equal(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |differs, (a, b)| differs | (a ^ b)) == 0
}
