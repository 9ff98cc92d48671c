//! The ports of those who look on. They are opened before anything is loaded: one that is in use is refused at once, and
//! not after the photos.

use super::LiveArguments;
use crate::view::server::{self, ServeArguments};
use crate::view::sibr;
use ashsplat::Result;
use std::net::TcpListener;

/// Open ports, which nobody serves yet: who comes early waits.
pub struct Doors {
    pub(super) page: Option<(TcpListener, ServeArguments)>,
    pub(super) network_viewer: Option<TcpListener>,
    /// See [`LiveArguments`].
    pub(super) share: f64,
}

impl LiveArguments {
    /// Opens the ports, if there are to be any.
    pub fn open(&self) -> Result<Option<Doors>> {
        if self.view.is_none() && self.ip.is_none() {
            return Ok(None);
        }
        let page = self.view.map(|port| {
            let (host, token) = (self.view_host.clone(), self.view_token.clone());
            let serve = ServeArguments { host, port, token, of_training: true };
            Ok((server::open(&serve)?, serve))
        });
        let network_viewer = self.ip.as_ref().map(|ip| sibr::open(ip, self.port));
        let (page, network_viewer) = (page.transpose()?, network_viewer.transpose()?);
        Ok(Some(Doors { page, network_viewer, share: self.view_share }))
    }
}
