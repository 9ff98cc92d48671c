//! The ports of viewers. They are opened before anything is loaded, so that a port in use is an error at once and not
//! after the photos are read.

use super::LiveArguments;
use crate::view::server::{self, ServeArguments};
use crate::view::sibr;
use ashsplat::Result;
use std::net::{IpAddr, TcpListener};

/// The loopback address.
const OWN: &str = "127.0.0.1";

/// Open ports that are not served yet; early connections wait.
pub struct Doors {
    pub(super) page: Option<(TcpListener, ServeArguments)>,
    pub(super) network_viewer: Option<TcpListener>,
    /// See [`LiveArguments`].
    pub(super) share: f64,
}

impl LiveArguments {
    /// Opens the requested ports, if any.
    pub fn open(&self) -> Result<Option<Doors>> {
        if self.view.is_none() && self.ip.is_none() {
            return Ok(None);
        }
        let page = self.view.map(|port| {
            let (host, token) = (self.view_host.clone(), self.view_token.clone());
            let allow_origin = self.view_allow_origin.clone();
            let serve = ServeArguments { host, port, token, allow_origin, of_training: true };
            Ok((server::open(&serve)?, serve))
        });
        let network_viewer = self.network_viewer_address().map(|address| sibr::open(address, self.port));
        let (page, network_viewer) = (page.transpose()?, network_viewer.transpose()?);
        Ok(Some(Doors { page, network_viewer, share: self.view_share }))
    }

    /// Scripts for the reference pass `--ip 0.0.0.0`, which alone admits no other machine.
    fn network_viewer_address(&self) -> Option<&str> {
        let ip = self.ip.as_deref()?;
        if let Some(host) = &self.host {
            return Some(host);
        }
        if ip == "localhost" || ip.parse().is_ok_and(|address: IpAddr| address.is_loopback()) {
            return Some(ip);
        }
        tell!("note: the network viewer listens at {OWN}: --host {ip} lets others in, without a password");
        Some(OWN)
    }
}
