//! Connections, each within its limits from opening to closing.

use super::open_connections::{Limits, OpenConnection, OpenConnections};
use axum::Router;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io::{IoSlice, Result};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};

/// Pause when no connection can be accepted, for example because there are no free descriptors.
const PAUSE: Duration = Duration::from_millis(100);
/// Most bytes of a request's headers.
const MAX_HEADERS: usize = 64 << 10;

pub async fn serve(listener: TcpListener, router: Router, limits: Limits) {
    let connections = Arc::new(OpenConnections::new(limits));
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                if let Some(connection) = connections.admit(peer.ip()) {
                    let stream = TrackedStream { stream, connection, connections: connections.clone() };
                    tokio::spawn(serve_connection(stream, router.clone()));
                }
            }
            Err(_) => tokio::time::sleep(PAUSE).await,
        }
        // A connection that makes way for this one closes before the next is accepted.
        tokio::task::yield_now().await;
    }
}

async fn serve_connection(stream: TrackedStream, router: Router) {
    let (connection, limits) = (stream.connection.clone(), stream.connections.limits);
    let answering = connection.clone();
    let router = TowerToHyperService::new(router);
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        let begun = answering.begin();
        request.extensions_mut().insert(answering.clone());
        let answer = router.call(request);
        async move {
            let answer = answer.await;
            drop(begun);
            answer
        }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(limits.headers).max_buf_size(MAX_HEADERS);
    let serving = http.serve_connection(TokioIo::new(stream), service).with_upgrades();
    tokio::select! {
        // A closed or malformed connection ends itself only.
        ended = serving => drop(ended),
        () = connection.until_evicted(limits.stall) => {}
    }
}

/// A stream that notes its connection's traffic, and removes the connection from the open ones when it closes.
struct TrackedStream {
    stream: TcpStream,
    connection: Arc<OpenConnection>,
    connections: Arc<OpenConnections>,
}

impl Drop for TrackedStream {
    fn drop(&mut self) {
        self.connections.remove(&self.connection);
    }
}

impl TrackedStream {
    fn note_written(&self, written: Poll<Result<usize>>) -> Poll<Result<usize>> {
        if matches!(written, Poll::Ready(Ok(bytes)) if bytes > 0) {
            self.connection.note_traffic();
        }
        written
    }
}

impl AsyncRead for TrackedStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        let before = buf.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(cx, buf);
        if buf.filled().len() > before {
            self.connection.note_traffic();
        }
        read
    }
}

impl AsyncWrite for TrackedStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.note_written(written)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, parts);
        self.note_written(written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
