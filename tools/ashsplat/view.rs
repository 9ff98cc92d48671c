//! `ashsplat view`, and what `train --view` shares with it.

mod assets;
mod draw;
mod film;
pub mod hub;
mod pace;
mod photos;
pub mod protocol;
pub mod server;
pub mod sibr;
mod sizes;
pub mod studio;
mod subject;

pub use draw::Painter;
pub use photos::Photos;
pub use subject::Subject;

use crate::args::DeviceArguments;
use crate::render::LookArguments;
use crate::{output, session};
use ashsplat::{Renderer, Result};
use clap::Args;
use hub::Hub;
use server::{ServeArguments, Site};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use studio::Studio;
use subject::Wanted;

/// Look at a scene, a trained model or a data set in a browser, also on a machine without a screen.
///
/// The pictures are rendered here and streamed to the page, as many as each page can take. From elsewhere, forward the
/// port (ssh -L 8090:localhost:8090 HOST), or use --host with --token.
#[derive(Args)]
pub struct Arguments {
    /// A file of Gaussians (PLY, compressed PLY, .splat, SPZ, glTF), a model folder, or a data set (its points)
    #[arg(value_name = "PATH")]
    path: Option<PathBuf>,
    /// Photos and cameras of this data set [default: that of the training]
    #[arg(short, long, value_name = "DATASET")]
    source_path: Option<PathBuf>,
    /// Folder of the photos within the data set [default: as in training, else images]
    #[arg(short, long, value_name = "NAME")]
    images: Option<String>,
    /// Iteration of the model folder's PLY [default: what was saved last]
    #[arg(long, value_name = "N")]
    iteration: Option<u32>,
    #[command(flatten)]
    serve: ServeArguments,
    /// Folder for camera paths and films [default: out/view]
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    look: LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
}

/// How long a thread that has nothing to do waits before it looks whether it is to end.
const REST: Duration = Duration::from_millis(200);

/// Runs the command until Ctrl-C.
pub fn run(arguments: &Arguments) -> Result<()> {
    // Where nothing can be written in the usual place, one can look all the same.
    arguments.out.as_deref().map(output::check_folder).transpose()?;
    let out = arguments.out.clone().unwrap_or_else(|| "out/view".into());
    // From now on: a ZIP is unpacked, and nothing of it may be left.
    let stop = session::stop_on_ctrl_c()?;
    // Before anything is loaded: a port in use costs no time.
    let listener = server::open(&arguments.serve)?;
    let subject = match &arguments.path {
        Some(path) => {
            let wanted = Wanted {
                iteration: arguments.iteration,
                source: arguments.source_path.as_deref(),
                images: arguments.images.as_deref(),
            };
            Subject::load(path, &wanted, &arguments.look, &arguments.device.host, &stop)?
        }
        None => Subject::nothing(),
    };
    let context = arguments.device.context()?;
    let mut renderer = Renderer::new(&context)?;
    if !subject.gaussians.is_empty() {
        renderer.upload(&subject.gaussians)?;
    }
    let hub = Arc::new(Hub::default());
    hub.greet_with(subject.greeting(context.device_name(), None).to_string());
    let base = subject.base;
    let site = Site {
        hub: hub.clone(),
        photos: subject.photos,
        films: out.clone(),
        token: arguments.serve.token.clone(),
    };
    let server = server::start(listener, site)?;
    announce(server.address, &arguments.serve);
    let mut studio = Studio::new(hub, base, out);
    while !stop.load(Ordering::Relaxed) {
        studio.serve(&mut renderer, REST)?;
    }
    arguments.device.report_validation(&context);
    Ok(())
}

/// Says where the page is.
pub fn announce(address: SocketAddr, arguments: &ServeArguments) {
    let name = if address.ip().is_loopback() { "localhost".into() } else { address.ip().to_string() };
    let word = if arguments.token.is_some() { "?token=WORD" } else { "" };
    say!("viewer at http://{name}:{}/{word}", address.port());
}
