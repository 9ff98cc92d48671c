//! `ashsplat view`, and what `train --view` shares with it.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::expect_used))]
// Used by the program alone.
#![allow(missing_docs)]

#[macro_use]
extern crate ashsplat_program;

mod appearances;
mod assets;
mod cut;
mod draw;
mod edits;
mod film;
pub mod hub;
mod labels;
mod loaded_scene;
mod loading;
mod openings;
mod pace;
mod photos;
pub mod protocol;
pub mod render_thread;
pub mod server;
mod sizes;
mod streamed;
#[cfg(feature = "window")]
mod window;

pub use appearances::PhotoAppearances;
pub use loaded_scene::LoadedScene;
pub use photos::Photos;

use ashsplat::{Error, RenderSettings, Renderer, Result, ShStorage};
use ashsplat_files::{colmap, splats};
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::look::{LookArguments, parse_direction};
use ashsplat_program::{model, output, session};
use clap::Args;
use draw::ViewedScene;
use edits::GaussianSet;
use glam::Vec3;
use hub::Hub;
use loaded_scene::{OpenScenes, SceneArguments, is_plain_name};
use loading::Loading;
use openings::{OpenRequest, Openings};
use protocol::ToPage;
use render_thread::RenderThread;
use server::{AppState, ServeArguments};
use std::collections::BTreeSet;
use std::net::{IpAddr, Ipv6Addr, SocketAddr, TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Scope;
use std::time::Duration;
use streamed::{OnTile, SceneRenderer};

/// Look at a scene, a trained model, a tree of tiles or a data set in a browser, also on a machine without a screen; or in a window.
///
/// The pictures are rendered here and streamed to the page, as many as each page can take. From elsewhere, forward the
/// port (ssh -L 8090:localhost:8090 HOST), or use --host with --token.
#[derive(Args)]
pub struct Arguments {
    /// A file of Gaussians (PLY, compressed PLY, .splat, SPZ, glTF, SOG), a model folder, a folder of `ashsplat tiles`, a data set
    /// (its points), or a folder of such files, of which the page chooses one [default: the page takes files that are dropped on it, and paths in this folder or below]
    #[arg(value_name = "PATH")]
    path: Option<PathBuf>,
    #[command(flatten)]
    scene: SceneArguments,
    /// Up direction [default: that of the cameras; without cameras 0,-1,0]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_direction)]
    up: Option<Vec3>,
    #[command(flatten)]
    serve: ServeArguments,
    /// Open a window on this machine's screen instead of serving a page
    #[arg(long, conflicts_with_all = ["host", "port", "token", "allow_origin"])]
    window: bool,
    /// Show the window's frames as soon as they are ready, without waiting for the screen's refresh
    #[arg(long, requires = "window")]
    no_vsync: bool,
    /// Folder for camera paths, films and the window's screenshots [default: out/view]
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    look: LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
}

/// Interval at which an idle thread checks whether it should end.
const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Time for pages to receive the reason why the program ends.
const FINAL_MESSAGE_TIME: Duration = Duration::from_millis(300);

/// Runs the command until Ctrl-C.
pub fn run(arguments: &Arguments) -> Result<()> {
    if !matches!(arguments.look.sh_storage, None | Some(ShStorage::F32)) {
        outln!("SH are rounded to their storage, in pictures and in scenes that are saved from here");
    }
    // The default folder may be read-only: looking needs no files.
    arguments.out.as_deref().map(output::check_folder).transpose()?;
    let out = arguments.out.clone().unwrap_or_else(|| "out/view".into());
    // From here on Ctrl-C only sets a flag, so that an unpacked ZIP is removed.
    let stop = session::stop_on_ctrl_c()?;
    // Report a missing file before any address.
    if let Some(path) = &arguments.path {
        std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    }
    if arguments.window {
        if cfg!(feature = "window") && arguments.path.is_none() {
            let problem = "a window opens nothing by itself: give what it is to show, `ashsplat view --window out/MODEL` for \
                           example; without --window, the page takes files and paths";
            return Err(Error::argument("--window", problem));
        }
        #[cfg(feature = "window")]
        return window::run(arguments, out, stop);
        #[cfg(not(feature = "window"))]
        return Err(Error::argument(
            "--window",
            "this program was built without windows: `cargo install --locked --path tools/ashsplat --features window` installs \
             one with them; without --window the viewer is a page in a browser",
        ));
    }
    // Report a port in use before anything is loaded.
    let listener = server::open(&arguments.serve)?;
    let openings = arguments.openings(&listener);
    let hub = Arc::new(Hub::default());
    let name = arguments.path.as_ref().map(|path| path.display().to_string());
    hub.greet_with(&loading::message(name.as_deref().unwrap_or_default()));
    let mut state = AppState::new(hub.clone(), out.clone(), arguments.serve.clone());
    state.openings.clone_from(&openings);
    let state = Arc::new(state);
    let server = server::start(listener, state.clone())?;
    announce(server.address, &arguments.serve);
    outln!(
        "{}; Ctrl-C ends the viewer",
        match &name {
            Some(name) if openings.is_some() => format!("the page chooses a scene of {name}"),
            Some(name) => format!("it shows {name}"),
            None => "nothing is open: drop a file of Gaussians onto the page, or give a path there".into(),
        }
    );
    std::thread::scope(|threads| {
        let viewer = ViewerSession { arguments, openings, hub: hub.clone(), state, stop: &stop };
        let ended = viewer.run(threads, out);
        // Stops a scene that is still being read.
        stop.store(true, Ordering::Relaxed);
        if let Err(error) = &ended {
            hub.broadcast(&loading::failure("", error, None));
            std::thread::sleep(if hub.pages() > 0 { FINAL_MESSAGE_TIME } else { Duration::ZERO });
        }
        ended
    })
}

/// Opens and shows the viewer's scenes, one after another.
struct ViewerSession<'a> {
    arguments: &'a Arguments,
    openings: Option<Arc<Openings>>,
    hub: Arc<Hub>,
    state: Arc<AppState>,
    stop: &'a AtomicBool,
}

impl<'a> ViewerSession<'a> {
    fn run<'scope>(&self, threads: &'scope Scope<'scope, 'a>, out: PathBuf) -> Result<()>
    where
        'a: 'scope,
    {
        let (arguments, stop, hub) = (self.arguments, self.stop, &self.hub);
        let begin = |request: OpenRequest| {
            let (path, within) = (request.path.clone(), request.within.clone());
            Loading::begin(threads, hub, request, move || arguments.load(&path, within.as_deref(), stop))
        };
        let request = |path: &PathBuf| OpenRequest {
            path: path.clone(),
            name: path.display().to_string(),
            ..OpenRequest::default()
        };
        let scene = arguments.path.as_ref().filter(|_| arguments.folder_of_scenes().is_none());
        let mut loading = scene.map(request).map(begin).transpose()?;
        // The device opens while the scene is read.
        let context = arguments.device.context()?;
        let mut renderer = SceneRenderer::new(Renderer::new(&context)?, arguments.look.sh_storage);
        let mut render_thread = RenderThread::new(hub.clone(), RenderSettings::default(), out);
        let first =
            loading.take().map_or_else(|| Ok(LoadedScene::nothing()), |loading| loading.finish().1)?;
        let mut open = first.open_scenes();
        self.show(first, &mut open, &mut renderer, &mut render_thread)?;
        while !stop.load(Ordering::Relaxed) {
            if let Some(read) = loading.take_if(|loading| loading.is_finished()) {
                let (mut request, read) = read.finish();
                // Pages may open the next scene.
                request.permit = None;
                let opened = read.and_then(|loaded| {
                    let (name, file) = (request.name.clone(), self.file_for_commands(&request, loaded.file));
                    let mut loaded = LoadedScene { name, file, ..loaded };
                    if request.add && open.parts.iter().any(|part| part.count > 0) {
                        loaded = self.added(loaded, open.clone(), &renderer)?;
                    }
                    self.show(loaded, &mut open, &mut renderer, &mut render_thread)
                });
                // The previous scene stays.
                if let Err(error) = opened {
                    hub.broadcast(&loading::failure(&request.name, &error, request.prefix().as_deref()));
                    render_thread::fatal(error)?;
                }
            }
            if loading.is_none() {
                let request = self.openings.as_ref().and_then(|openings| openings.take());
                loading = request.map(begin).transpose()?;
            }
            render_thread.serve(&mut renderer, POLL_INTERVAL)?;
        }
        arguments.device.report_validation(&context);
        Ok(())
    }

    /// The path of an opened file in commands that pages show; none if it has none that a person could type.
    fn file_for_commands(&self, request: &OpenRequest, file: Option<PathBuf>) -> Option<PathBuf> {
        let base = self.arguments.path.as_deref().unwrap_or(Path::new("."));
        match (&request.within, file) {
            // Commands name the file that the page has sent, not its copy here.
            _ if request.upload.is_some() => {
                is_plain_name(&request.name).then(|| PathBuf::from(&request.name))
            }
            // Pages do not see where the folder lies.
            (Some(folder), Some(file)) => Some(base.join(file.strip_prefix(folder).ok()?)),
            (_, file) => file,
        }
    }

    fn added(&self, new: LoadedScene, mut open: OpenScenes, renderer: &SceneRenderer) -> Result<LoadedScene> {
        let name = &new.name;
        if new.tree.is_some() || renderer.tree().is_some() {
            return Err(Error::argument(name, "is not added: a tree of tiles is drawn alone"));
        }
        renderer.keep_drawn(name, &mut open.parts)?;
        let all = renderer.gaussians(GaussianSet::Visible)?;
        let degree = new.gaussians.sh_degree.max(all.sh_degree);
        let needed = (all.len() + new.gaussians.len()) as u64 * splats::row_bytes(degree);
        let limit = self.arguments.device.host.memory().limit();
        if needed > limit {
            let what = format!("{name} beside the open scene");
            let (unit, limit_name) = ("bytes of host memory", "--max-host-memory");
            return Err(Error::TooLarge { what, needed, unit, limit, limit_name });
        }
        Ok(LoadedScene { joined: Some(self.hub.run()), ..new.added_to(open, all) })
    }

    /// Shows a scene. If it does not fit, the scenes that were open before are shown again, if any.
    fn show(
        &self,
        loaded: LoadedScene,
        open: &mut OpenScenes,
        renderer: &mut SceneRenderer,
        render_thread: &mut RenderThread,
    ) -> Result<()> {
        let mut greeting = loaded.greeting(renderer.renderer.context().device_name(), None);
        greeting["open"] = self.openings.as_ref().map(|openings| openings.described()).into();
        let hub = self.hub.clone();
        let on_tile: OnTile = Arc::new(move |problem: Option<String>| match problem {
            None => hub.renew(),
            Some(problem) => hub.broadcast(&ToPage::problem(&problem)),
        });
        if let Err(error) = renderer.show(&loaded.gaussians, loaded.tree.as_ref(), on_tile) {
            // The previous scene is already gone.
            self.show(loaded.without_last(), open, renderer, render_thread)?;
            return Err(error);
        }
        *open = loaded.open_scenes();
        render_thread.show(loaded.base, loaded.appearances, loaded.frame);
        self.state.show_photos(loaded.photos);
        self.hub.greet_with(&greeting);
        self.hub.broadcast(&ToPage::json(&greeting));
        Ok(())
    }
}

impl Arguments {
    #[cfg(feature = "window")]
    fn load_path(&self, stop: &AtomicBool) -> Result<LoadedScene> {
        self.path.as_ref().map_or_else(|| Ok(LoadedScene::nothing()), |path| self.load(path, None, stop))
    }

    fn load(&self, path: &Path, within: Option<&Path>, stop: &AtomicBool) -> Result<LoadedScene> {
        let loaded = LoadedScene::load(path, within, &self.scene, &self.look, &self.device.host, stop)?;
        Ok(LoadedScene { up: self.up, ..loaded })
    }

    /// Limits of what pages may open; none if the viewer was started with a scene.
    fn openings(&self, listener: &TcpListener) -> Option<Arc<Openings>> {
        let max_bytes = self.device.host.memory().limit();
        let folder = match self.path {
            // Everyone who sees the page may list a folder that the command names. The shell's folder is for this machine only.
            Some(_) => self.folder_of_scenes().map(Path::to_owned),
            None => {
                std::env::current_dir().ok().filter(|_| server::is_for_this_machine(listener, &self.serve))
            }
        };
        (self.path.is_none() || folder.is_some()).then(|| Arc::new(Openings::new(folder, max_bytes)))
    }

    /// The path, if it is a folder of which pages choose a scene.
    fn folder_of_scenes(&self) -> Option<&Path> {
        let path = self.path.as_deref().filter(|path| path.is_dir() && model::is_dataset(path))?;
        if colmap::is_data_set(path) {
            return None;
        }
        let mut names = std::fs::read_dir(path).ok()?.flatten().map(|entry| entry.file_name());
        names.any(|name| openings::format_of(&name.to_string_lossy()).is_some()).then_some(path)
    }
}

/// Prints the page's address. If the server listens at all addresses, prints one for this machine and those for others.
pub fn announce(address: SocketAddr, arguments: &ServeArguments) {
    let word = if arguments.token.is_some() { "?token=WORD" } else { "" };
    let page = |place: String| format!("http://{place}/{word}");
    let (ip, port) = (address.ip(), address.port());
    let here = if ip.is_loopback() || ip.is_unspecified() {
        format!("localhost:{port}")
    } else {
        address.to_string()
    };
    let others = if ip.is_unspecified() { outward_addresses(ip.is_ipv6()) } else { BTreeSet::new() };
    let others: Vec<String> = others.iter().map(|ip| page(SocketAddr::new(*ip, port).to_string())).collect();
    let others =
        if others.is_empty() { String::new() } else { format!("; from elsewhere {}", others.join(", ")) };
    outln!("viewer at {}{others}", page(here));
}

/// This machine's outward addresses, by its routes to common ranges. Connecting a datagram socket sends nothing.
fn outward_addresses(with_ipv6: bool) -> BTreeSet<IpAddr> {
    let ranges = ["192.0.2.1", "10.0.0.1", "172.16.0.1", "192.168.0.1", "2001:db8::1", "fd00::1"];
    let towards = |range: IpAddr| {
        let any = if range.is_ipv6() { Ipv6Addr::UNSPECIFIED.into() } else { IpAddr::from([0; 4]) };
        let socket = UdpSocket::bind((any, 0)).ok()?;
        socket.connect((range, 9)).ok()?;
        Some(socket.local_addr().ok()?.ip())
    };
    let ranges = ranges.iter().filter_map(|range| range.parse().ok());
    let ranges = ranges.filter(|range: &IpAddr| with_ipv6 || range.is_ipv4());
    ranges.filter_map(towards).filter(|ip| !ip.is_loopback()).collect()
}
