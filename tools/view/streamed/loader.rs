//! The thread that reads tiles and uploads them: no frame waits for a file.

use crate::loaded_scene::Streamed;
use ashsplat::scene::Gaussians;
use ashsplat::vk::Context;
use ashsplat::{DeviceScene, Error, Result, ShStorage};
use ashsplat_program::session::{guarded, locked};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A tile and its Gaussians on the device, or the error.
pub type LoadedTile = (usize, Result<DeviceScene>);

pub struct Loader {
    shared: Arc<Shared>,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    requested: VecDeque<usize>,
    current: Option<usize>,
    arrivals: Vec<LoadedTile>,
    /// Context for uploads; none once the loader ends.
    context: Option<Context>,
    /// True while the thread uses the device.
    is_uploading: bool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    /// Waits for the next tile to read; none once the loader ends.
    fn next(&self) -> Option<usize> {
        let mut state = self.lock();
        loop {
            state.context.as_ref()?;
            if let Some(tile) = state.requested.pop_front() {
                state.current = Some(tile);
                return Some(tile);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Returns the context for an upload, unless the loader ends.
    fn begin_upload(&self) -> Option<Context> {
        let mut state = self.lock();
        state.is_uploading = state.context.is_some();
        state.context.clone()
    }

    fn arrive(&self, arrival: LoadedTile) {
        let mut state = self.lock();
        (state.current, state.is_uploading) = (None, false);
        state.arrivals.push(arrival);
        self.changed.notify_all();
    }
}

impl Loader {
    /// Starts the thread; `on_loaded` is called after each tile. All tiles have the SH degree `sh_degree`.
    pub fn start(
        context: Context,
        streamed: Streamed,
        sh_degree: u32,
        stored: impl Fn(&Gaussians) -> ShStorage + Send + 'static,
        on_loaded: impl Fn() + Send + 'static,
    ) -> Result<Loader> {
        let state = Mutex::new(State { context: Some(context), ..State::default() });
        let shared = Arc::new(Shared { state, changed: Condvar::new() });
        let own = shared.clone();
        let work = move || {
            while let Some(tile) = own.next() {
                let gaussians = guarded(|| streamed.read(tile, sh_degree));
                let Some(context) = own.begin_upload() else { return };
                // The waiting side must get a result for each tile, even after a panic. By then the thread no longer holds the device.
                let scene = guarded(|| {
                    let tile = gaussians?;
                    DeviceScene::upload_stored(&context, &tile, 0, stored(&tile))
                });
                drop(context);
                own.arrive((tile, scene));
                on_loaded();
            }
        };
        let thread = std::thread::Builder::new().name("tiles".into()).spawn(work);
        thread.map_err(|e| Error::argument("viewer", format!("no thread to read with: {e}")))?;
        Ok(Loader { shared })
    }

    /// Replaces the list of tiles to read, most urgent first. Earlier entries that are not repeated are dropped.
    pub fn request(&self, tiles: impl IntoIterator<Item = usize>) {
        let mut state = self.shared.lock();
        let known = |tile: &usize| {
            state.current == Some(*tile) || state.arrivals.iter().any(|(arrived, _)| arrived == tile)
        };
        state.requested = tiles.into_iter().filter(|tile| !known(tile)).collect();
        drop(state);
        self.shared.changed.notify_one();
    }

    /// Takes the tiles that have arrived since the last call.
    pub fn arrivals(&self) -> Vec<LoadedTile> {
        std::mem::take(&mut self.shared.lock().arrivals)
    }
}

impl Drop for Loader {
    /// Waits until the thread is done with the device, but not for a file, since a network's may never come. Afterwards the
    /// thread holds nothing of the device.
    fn drop(&mut self) {
        let mut state = self.shared.lock();
        state.context = None;
        self.shared.changed.notify_all();
        while state.is_uploading {
            state = self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.arrivals.clear();
    }
}

impl Streamed {
    fn read(&self, tile: usize, sh_degree: u32) -> Result<Gaussians> {
        if let (Some(folder), Some(path)) = (&self.within, self.tree.path(tile)) {
            let real = dunce::canonicalize(&path).map_err(|e| Error::io(&path, "read", e))?;
            if !real.starts_with(folder) {
                let problem = "leads out of the folder that may be opened";
                return Err(Error::input(path, problem, "start the viewer with the tree's path"));
            }
        }
        let gaussians = self.tree.read(tile, &self.read)?.gaussians;
        let degree = gaussians.sh_degree;
        if degree != sh_degree {
            let path = self.tree.path(tile).unwrap_or_default();
            let problem = format!("has SH degree {degree}, and the coarsest tile {sh_degree}");
            return Err(Error::input(path, problem, "write the tree again with `ashsplat tiles`"));
        }
        Ok(gaussians)
    }
}
