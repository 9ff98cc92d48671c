//! Photographs on the device: all of them, or those of the next iterations.

use super::block::in_threads;
use super::schedule::ViewOrder;
use super::settings::TrainSettings;
use crate::error::{Error, Result};
use crate::frame::array_of;
use crate::passes::loss::{
    DepthPoint, DepthPointBuffers, NativeLayout, check_depth_points, photo_bytes, photo_on_device,
};
use crate::scene::photo::TEXEL_BYTES;
use crate::scene::{Camera, Fingerprint, StoredPhoto};
use crate::vk::{Buffer, Context, MemoryKind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

/// Number of threads that read ahead. Each waits with its photograph until that is needed.
const READERS: usize = 2;
/// Maximum number of photographs on the host: those of the threads and the one being uploaded.
const ON_HOST: u64 = READERS as u64 + 1;

/// The views' photographs in the layout of [`photo_on_device`].
pub(super) struct Photos {
    /// Per view: true if it has masked or transparent pixels.
    masked: Vec<bool>,
    /// Per view: true if it can be composed over another background.
    transparent: Vec<bool>,
    /// Texels: one buffer per view, or the places of the stream.
    texels: Vec<Buffer>,
    /// Present if the photographs lie in a file.
    stream: Option<Stream>,
}

/// Places on the device that photographs share.
struct SharedSlots {
    count: usize,
    /// Bytes of each.
    bytes: u64,
}

impl SharedSlots {
    /// Plans as many places as fit the file's budget, less the photographs that wait on the host. None if the photographs do not
    /// lie in a file: then all are on the device.
    fn of(layout: NativeLayout, photos: &[PhotoSize], file_memory: Option<u64>) -> Result<Option<Self>> {
        let Some(memory) = file_memory else { return Ok(None) };
        // Waiting photographs have the device's layout. A photograph being read also has its decoded pixels or the file's texels.
        let bytes = photos.iter().map(|photo| photo.device_bytes(layout)).max().unwrap_or(0).max(4);
        let read = photos.iter().map(|photo| TEXEL_BYTES * photo.pixels()).max().unwrap_or(0);
        let read = READERS as u64 * read;
        let held = memory.saturating_sub(read) / bytes;
        if held <= ON_HOST {
            let what = format!(
                "reading ahead ({} of the largest photograph, {READERS} more being read)",
                ON_HOST + 1
            );
            let limit = (memory, "--photo-memory, or half of --max-memory or --max-host-memory");
            return Err(Error::too_large(what, ((ON_HOST + 1) * bytes + read, "bytes"), limit));
        }
        let count = usize::try_from(held - ON_HOST).unwrap_or(usize::MAX).min(photos.len());
        Ok(Some(Self { count, bytes }))
    }

    fn requests(&self) -> Vec<(&'static str, u64)> {
        vec![("photo", self.bytes); self.count]
    }
}

/// Size and masks of a photograph, known from its header and camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhotoSize {
    /// Name for errors.
    pub name: String,
    /// Width in training, pixels.
    pub width: u32,
    /// Height in training, pixels.
    pub height: u32,
    /// True if it is known to have pixels that do not count.
    pub masked: bool,
    /// True if it has an inverse-depth map.
    pub inverse_depth: bool,
    /// Upper bound of its visible sparse points; 0 unless training uses them.
    pub depth_points: u32,
}

impl PhotoSize {
    pub(super) fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    pub(super) fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    fn device_bytes(&self, layout: NativeLayout) -> u64 {
        photo_bytes(layout, self.width, self.height, self.masked)
    }
}

/// Sizes of the views' photographs, in the views' order.
pub(super) fn sizes_of(views: &[TrainView], settings: &TrainSettings) -> Vec<PhotoSize> {
    let uses_points = settings.depth_points > 0.0;
    let size = |(index, view): (usize, &TrainView)| PhotoSize {
        name: format!("view {index}"),
        width: view.photo.width,
        height: view.photo.height,
        masked: view.photo.is_masked(),
        inverse_depth: view.inverse_depth.is_some(),
        depth_points: view
            .depth_points
            .as_ref()
            .filter(|_| uses_points)
            .map_or(0, |points| points.len() as u32),
    };
    views.iter().enumerate().map(size).collect()
}

/// Bytes of device memory for the photographs.
#[derive(Clone, Copy)]
pub(super) struct PhotoBytes {
    /// Photographs that stay on the device, inverse-depth maps and sparse points.
    pub held: u64,
    /// Staging memory during an upload.
    pub staging: u64,
    /// All photographs.
    pub all: u64,
    /// Memory budget of photographs in a file.
    pub budget: Option<u64>,
}

impl PhotoBytes {
    /// Bytes if reading ahead needs more than its budget.
    pub fn reading_ahead(context: &Context, photos: &[PhotoSize], needed: u64, budget: Option<u64>) -> Self {
        let all = context.allocation_bytes(&requests(context, photos));
        Self { held: needed, staging: 0, all, budget }
    }
}

/// Memory budget of the views' photographs, if they lie in a file.
pub(super) fn memory_of_file(views: &[TrainView]) -> Option<u64> {
    views.iter().find_map(|view| view.photo.file()).map(|file| file.memory_bytes())
}

/// Device memory of the photographs. `file_memory`: memory budget of photographs in a file.
///
/// # Errors
/// [`Error::TooLarge`] if the budget is too small to read ahead.
pub(super) fn device_bytes(
    context: &Context,
    photos: &[PhotoSize],
    file_memory: Option<u64>,
) -> Result<PhotoBytes> {
    let all = context.allocation_bytes(&requests(context, photos));
    let maps = context.allocation_bytes(&map_requests(photos));
    Ok(match SharedSlots::of(NativeLayout::of(context.limits()), photos, file_memory)? {
        None => PhotoBytes { held: all + maps, staging: 0, all, budget: None },
        Some(places) => PhotoBytes {
            held: maps + context.allocation_bytes(&places.requests()),
            staging: context.staging_bytes(places.bytes),
            all: all.max(context.allocation_bytes(&SharedSlots { count: photos.len(), ..places }.requests())),
            budget: file_memory,
        },
    })
}

fn requests(context: &Context, photos: &[PhotoSize]) -> Vec<(&'static str, u64)> {
    photos.iter().map(|photo| ("photo", photo.device_bytes(NativeLayout::of(context.limits())))).collect()
}

fn on_device(layout: NativeLayout, photo: &StoredPhoto) -> Result<Vec<u8>> {
    Ok(photo_on_device(layout, photo.width, photo.height, photo.is_masked(), photo.texels()?))
}

/// Refuses views whose cameras and photographs differ in size.
pub(super) fn check(views: &[TrainView]) -> Result<()> {
    for (index, TrainView { camera, photo, inverse_depth, depth_points, .. }) in views.iter().enumerate() {
        let name = format!("view {index}");
        camera
            .check()
            .and_then(|()| camera.check_differentiable())
            .map_err(|error| error.within(format_args!("{name}")))?;
        if (photo.width, photo.height) != (camera.width, camera.height) {
            let problem = format!(
                "the photo has {}x{} pixels, its camera {}x{}; they must agree",
                photo.width, photo.height, camera.width, camera.height
            );
            return Err(Error::argument(name, problem));
        }
        photo.check().map_err(|problem| Error::argument(name.clone(), problem))?;
        let pixels = photo.width as usize * photo.height as usize;
        if let Some(map) = inverse_depth.as_ref().filter(|map| map.len() != pixels) {
            let problem = format!("the inverse-depth map has {} values for {pixels} pixels", map.len());
            return Err(Error::argument(name, problem));
        }
        if let Some(points) = depth_points {
            check_depth_points(&name, points, (photo.width, photo.height))?;
        }
    }
    Ok(())
}

impl Photos {
    /// Uploads the photographs of the views, which have these sizes, or allocates places for some of them. The seed determines
    /// the order of their use.
    pub fn new(context: &Context, views: &[TrainView], sizes: &[PhotoSize], seed: u32) -> Result<Self> {
        let (texels, stream) =
            match SharedSlots::of(NativeLayout::of(context.limits()), sizes, memory_of_file(views))? {
                Some(places) => {
                    let photos = views.iter().map(|view| view.photo.clone()).collect();
                    let places = context.allocate("photos", &places.requests(), MemoryKind::Device)?;
                    (places, Some(Stream { photos, seed, running: None }))
                }
                None => (upload_all(context, views, sizes)?, None),
            };
        Ok(Self {
            masked: views.iter().map(|view| view.photo.is_masked()).collect(),
            transparent: views.iter().map(|view| view.photo.is_transparent()).collect(),
            texels,
            stream,
        })
    }

    /// True if all photographs stay on the device.
    pub fn are_resident(&self) -> bool {
        self.stream.is_none()
    }

    /// Loads the photograph of an iteration to the device if necessary. No submission that uses another photograph may be
    /// pending.
    pub fn prepare(&mut self, context: &Context, iteration: u32) -> Result<()> {
        self.stream.as_mut().map_or(Ok(()), |stream| stream.prepare(context, &self.texels, iteration))
    }

    /// Begins to load the next iteration's photograph beside the prepared one, if the device has a copy queue.
    pub fn prefetch(&mut self, context: &Context) -> Result<()> {
        self.stream.as_mut().map_or(Ok(()), |stream| stream.prefetch(context, &self.texels))
    }

    /// Texels of a view after [`Photos::prepare`].
    pub fn of(&self, view: usize) -> &Buffer {
        match self.stream.as_ref().map(|stream| &stream.running) {
            None => &self.texels[view],
            Some(Some(running)) if running.at.view == view => &self.texels[running.at.place],
            Some(_) => panic!("view {view} is not the one that was prepared"),
        }
    }

    /// Bytes of the buffer that [`Photos::between_steps`] needs as `place`.
    pub fn place_bytes(&self) -> u64 {
        let places = if self.are_resident() { &[][..] } else { &self.texels };
        places.iter().map(Buffer::bytes).max().unwrap_or(0)
    }

    /// Texels of any view, between steps: those on the device, or those of the file, uploaded to `place`.
    pub fn between_steps(&self, context: &Context, view: usize, place: &Buffer) -> Result<Buffer> {
        let Some(stream) = &self.stream else { return Ok(self.texels[view].clone()) };
        let texels = on_device(NativeLayout::of(context.limits()), &stream.photos[view])?;
        context.upload(&place.range(0, texels.len() as u64), &texels)?;
        Ok(place.clone())
    }

    /// True if a view has masked or transparent pixels.
    pub fn is_masked(&self, view: usize) -> bool {
        self.masked[view]
    }

    /// True if a view can be composed over another background.
    pub fn is_transparent(&self, view: usize) -> bool {
        self.transparent[view]
    }
}

fn upload_all(context: &Context, views: &[TrainView], sizes: &[PhotoSize]) -> Result<Vec<Buffer>> {
    let texels = context.allocate("photos", &requests(context, sizes), MemoryKind::Device)?;
    let begin = |(buffer, view): (_, &TrainView)| {
        context.begin_upload(buffer, &on_device(NativeLayout::of(context.limits()), &view.photo)?, false)
    };
    let begun = texels.iter().zip(views).try_for_each(begin);
    // Also finishes uploads begun before a photograph that cannot be read, because they hold memory.
    let finished = context.finish_uploads();
    if let Err(error) = begun.and(finished) {
        // A copy queue may still use some of them.
        drop(texels);
        context.free_staging();
        return Err(error);
    }
    Ok(texels)
}

/// Photographs that are read during training. Threads take turns to read them in the order of their loads, which each thread
/// computes on its own.
struct Stream {
    photos: Vec<StoredPhoto>,
    seed: u32,
    running: Option<ActiveStream>,
}

struct ActiveStream {
    context: Context,
    schedule: Residency,
    /// The prepared iteration.
    iteration: u32,
    at: PhotoUse,
    /// Photograph of the next iteration; true if its load has begun.
    ahead: Option<(PhotoUse, bool)>,
    /// Number of photographs taken from the threads.
    taken: usize,
    /// Texels of each thread's loads, in order. A thread ends when its receiver is dropped.
    texels: Vec<Receiver<Result<Vec<u8>>>>,
}

impl ActiveStream {
    /// Texels of the next load, once they are read.
    fn take(&mut self) -> Result<Vec<u8>> {
        let texels = self.texels[self.taken % READERS].recv().map_err(|_| {
            let problem = "the thread that reads them has ended; go on from a checkpoint";
            Error::argument("photographs", problem)
        })??;
        self.taken += 1;
        Ok(texels)
    }

    /// Texels of the next load if they are read already.
    fn try_take(&mut self) -> Result<Option<Vec<u8>>> {
        let texels = self.texels[self.taken % READERS].try_recv().ok().transpose()?;
        self.taken += usize::from(texels.is_some());
        Ok(texels)
    }
}

impl Drop for ActiveStream {
    fn drop(&mut self) {
        // A load in progress uses memory that is freed now. After an error nothing is pending.
        let _ = self.context.finish_uploads();
    }
}

impl Stream {
    fn prepare(&mut self, context: &Context, places: &[Buffer], iteration: u32) -> Result<()> {
        if self.running.as_ref().is_some_and(|running| running.iteration == iteration) {
            return Ok(());
        }
        // Restarts at the first iteration, after a checkpoint and after a failure.
        let mut running = match self.running.take() {
            Some(running) if running.iteration + 1 == iteration => running,
            _ => self.start(context, places.len(), iteration)?,
        };
        running.iteration = iteration;
        let (at, begun) = running.ahead.take().unwrap_or_else(|| (running.schedule.advance(), false));
        running.at = at;
        if at.load && !begun {
            let texels = running.take()?;
            context.begin_upload(&places[at.place].range(0, texels.len() as u64), &texels, true)?;
        }
        context.take_over_uploads()?;
        self.running = Some(running);
        Ok(())
    }

    fn prefetch(&mut self, context: &Context, places: &[Buffer]) -> Result<()> {
        let Some(mut running) = self.running.take_if(|running| running.ahead.is_none()) else {
            return Ok(());
        };
        let at = running.schedule.advance();
        // The prepared photograph's place is in use.
        let free = at.load && at.place != running.at.place && context.transfers().copy_queue;
        let texels = if free { running.try_take()? } else { None };
        if let Some(texels) = &texels {
            context.begin_upload(&places[at.place].range(0, texels.len() as u64), texels, true)?;
        }
        running.ahead = Some((at, texels.is_some()));
        self.running = Some(running);
        Ok(())
    }

    fn start(&self, context: &Context, places: usize, iteration: u32) -> Result<ActiveStream> {
        let layout = NativeLayout::of(context.limits());
        let order = ViewOrder::new(self.seed, self.photos.len());
        let schedule = Residency::new(order, places, iteration);
        // If all photographs fit, each is read once.
        let loads = if places < self.photos.len() { usize::MAX } else { self.photos.len() };
        let reader = |thread: usize| {
            let (mut ahead, photos) = (schedule.clone(), self.photos.clone());
            let (sender, texels) = sync_channel(0);
            let read = move || {
                for load in 0..loads {
                    let next = std::iter::repeat_with(|| ahead.advance()).find(|next| next.load);
                    let Some(next) = next.filter(|_| load % READERS == thread) else { continue };
                    let texels = on_device(layout, &photos[next.view]);
                    let failed = texels.is_err();
                    if sender.send(texels).is_err() || failed {
                        return;
                    }
                }
            };
            let spawned = std::thread::Builder::new().name("photographs".into()).spawn(read);
            spawned.map_err(|e| Error::argument("photographs", format!("no thread to read them: {e}")))?;
            Ok(texels)
        };
        let texels = (0..READERS).map(reader).collect::<Result<_>>()?;
        let context = context.clone();
        Ok(ActiveStream {
            context,
            schedule,
            iteration,
            at: PhotoUse { view: 0, place: 0, load: false },
            ahead: None,
            taken: 0,
            texels,
        })
    }
}

/// Per view: its inverse-depth map (a float per pixel, row by row) and its sparse points, if it has them.
pub(super) struct DepthMaps(Vec<(Option<Buffer>, Option<DepthPointBuffers>)>);

/// Buffers of all views in order, each view's map before its points.
fn map_requests(photos: &[PhotoSize]) -> Vec<(&'static str, u64)> {
    let of_photo = |photo: &PhotoSize| {
        let map = photo.inverse_depth.then(|| ("inverse_depth_map", 4 * photo.pixels()));
        let points = Some(photo.depth_points).filter(|&count| count > 0).map(DepthPointBuffers::requests);
        map.into_iter().chain(points.into_iter().flatten())
    };
    photos.iter().flat_map(of_photo).collect()
}

impl DepthMaps {
    /// Uploads the maps and points of the views, whose photographs have these sizes.
    pub fn new(context: &Context, views: &[TrainView], sizes: &[PhotoSize]) -> Result<Self> {
        let requests = map_requests(sizes);
        let buffers = match requests.is_empty() {
            true => Vec::new(),
            false => context.allocate("depth maps", &requests, MemoryKind::Device)?,
        };
        let mut buffers = buffers.into_iter();
        let each = views.iter().zip(sizes).map(|(view, size)| {
            let map = view.inverse_depth.as_ref().and_then(|map| Some((map, buffers.next()?)));
            if let Some((map, buffer)) = &map {
                context.upload(buffer, bytemuck::cast_slice(map))?;
            }
            let points = match &view.depth_points {
                Some(points) if size.depth_points > 0 => {
                    let size = (view.photo.width, view.photo.height);
                    let own = array_of(buffers.by_ref().take(3).collect());
                    Some(DepthPointBuffers::upload(context, own, points, size)?)
                }
                _ => None,
            };
            Ok((map.map(|(_, buffer)| buffer), points))
        });
        Ok(Self(each.collect::<Result<_>>()?))
    }

    pub fn of(&self, view: usize) -> Option<&Buffer> {
        self.0[view].0.as_ref()
    }

    pub fn points_of(&self, view: usize) -> Option<&DepthPointBuffers> {
        self.0[view].1.as_ref()
    }
}

/// Photograph of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PhotoUse {
    pub view: usize,
    /// Index of its place on the device.
    pub place: usize,
    /// True if it must be loaded into the place.
    pub load: bool,
}

/// Belady's algorithm: the order is known, so a load replaces the photograph whose next use is last.
#[derive(Clone)]
pub(super) struct Residency {
    order: ViewOrder,
    /// Next iteration, counted from 1.
    iteration: u32,
    /// View in each place.
    places: Vec<Option<usize>>,
    /// Iterations at which each view is next used: in this epoch and in the next.
    uses: Vec<[u32; 2]>,
    /// Iteration from which `uses` must be recomputed.
    epoch_end: u32,
}

impl Residency {
    /// Starts at an iteration with empty places.
    pub fn new(order: ViewOrder, places: usize, iteration: u32) -> Self {
        let uses = vec![[0; 2]; order.views];
        Self { order, iteration, places: vec![None; places], uses, epoch_end: 0 }
    }

    /// Photograph of the next iteration.
    pub fn advance(&mut self) -> PhotoUse {
        let iteration = self.iteration;
        self.iteration += 1;
        if iteration >= self.epoch_end {
            self.look_ahead(iteration);
        }
        let view = self.order.view(iteration);
        if let Some(place) = self.places.iter().position(|&held| held == Some(view)) {
            return PhotoUse { view, place, load: false };
        }
        let farthest =
            |&place: &usize| self.places[place].map_or(u32::MAX, |held| self.next_use(held, iteration));
        let place = (0..self.places.len()).max_by_key(farthest).unwrap_or(0);
        self.places[place] = Some(view);
        PhotoUse { view, place, load: true }
    }

    /// Notes the iteration of each view, in the epoch of the given iteration and in the next.
    fn look_ahead(&mut self, iteration: u32) {
        let views = self.uses.len() as u32;
        let first = (iteration - 1) / views * views + 1;
        for epoch in [1, 0] {
            for at in first + epoch * views..first + (epoch + 1) * views {
                self.uses[self.order.view(at)][epoch as usize] = at;
            }
        }
        self.epoch_end = first + views;
    }

    fn next_use(&self, view: usize, iteration: u32) -> u32 {
        let [this, next] = self.uses[view];
        if this > iteration { this } else { next }
    }
}

/// A photograph and its camera.
#[derive(Clone, Debug)]
pub struct TrainView {
    /// Camera of the photograph, with its size.
    pub camera: Camera,
    /// Photograph, kept on the device with 8 bits per channel. Masked pixels carry no loss. Photographs in a file are read
    /// ahead of the iterations that need them.
    pub photo: StoredPhoto,
    /// Inverse depth that the photograph's pixels should have, row by row: the sum of blending weights / z, 1 / world units.
    /// Pixels of [`MAP_NOTHING`](crate::kernels::constants::MAP_NOTHING) and above, like infinity, do not count. A view with a
    /// map adds [`InverseDepth`](super::InverseDepth) to the loss.
    pub inverse_depth: Option<Arc<[f32]>>,
    /// Any id of the camera that took the photograph. Views with the same id share [`LensEffects`](crate::scene::LensEffects).
    pub camera_id: u32,
    /// Sparse points that the photograph shows. With [`TrainSettings::depth_points`](super::TrainSettings::depth_points) a view
    /// with points adds [`SparseDepth`](super::SparseDepth) to the loss. Excludes inverse-depth maps.
    pub depth_points: Option<Arc<[DepthPoint]>>,
}

impl TrainView {
    /// Creates a view to train on, without depths.
    pub fn new(camera: Camera, photo: impl Into<StoredPhoto>) -> Self {
        Self { camera, photo: photo.into(), inverse_depth: None, camera_id: 0, depth_points: None }
    }
}

/// Hash of views, cameras and photographs in their order; `by_camera`: also of the ids of their cameras.
pub(super) fn fingerprint_of(views: &[TrainView], by_camera: bool) -> u64 {
    let of_view = |view: &TrainView| {
        let mut print = Fingerprint::new();
        print.add_camera(&view.camera);
        print.add(bytemuck::bytes_of(&view.photo.fingerprint()));
        view.inverse_depth.iter().for_each(|map| print.add(bytemuck::cast_slice(map)));
        if by_camera {
            print.add(bytemuck::bytes_of(&view.camera_id));
        }
        for point in view.depth_points.iter().flat_map(|points| points.iter()) {
            let [x, y] = point.position_px;
            print.add(bytemuck::cast_slice(&[x, y, point.inverse_z]));
        }
        print.finish()
    };
    // Photographs have many megabytes.
    let each = in_threads(views, (), |(), view| of_view(view));
    let mut all = Fingerprint::new();
    all.add(bytemuck::cast_slice(&each));
    all.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of loads in `epochs` epochs.
    fn loads(views: usize, places: usize, epochs: u32) -> u32 {
        let mut schedule = Residency::new(ViewOrder::new(3, views), places, 1);
        let mut order = ViewOrder::new(3, views);
        let mut held = vec![None; places];
        let mut loads = 0;
        for iteration in 1..=epochs * views as u32 {
            let at = schedule.advance();
            assert_eq!(at.view, order.view(iteration));
            if at.load {
                assert!(!held.contains(&Some(at.view)), "it was there");
                held[at.place] = Some(at.view);
                loads += 1;
            }
            assert_eq!(held[at.place], Some(at.view));
        }
        loads
    }

    #[test]
    fn photographs_that_all_fit_are_loaded_once() {
        assert_eq!(loads(17, 17, 10), 17);
        assert_eq!(loads(17, 1, 10), 170 - repeats(17, 10));
    }

    /// Number of views that come last in an epoch and first in the next.
    fn repeats(views: usize, epochs: u32) -> u32 {
        let mut order = ViewOrder::new(3, views);
        let ends = (1..epochs).map(|epoch| epoch * views as u32);
        ends.filter(|&at| order.view(at) == order.view(at + 1)).count() as u32
    }

    /// Least-recently-used replacement would load nearly all in every epoch.
    #[test]
    fn half_the_places_save_half_the_loads() {
        let of_all = f64::from(loads(40, 20, 20)) / 800.0;
        // All in the first epoch, half in each of the others.
        assert!(of_all <= (40.0 + 19.0 * 20.0) / 800.0, "{of_all}");
    }

    #[test]
    fn a_resumed_run_loads_the_same_views() {
        let mut schedule = Residency::new(ViewOrder::new(3, 9), 4, 14);
        let mut order = ViewOrder::new(3, 9);
        for iteration in 14..60 {
            assert_eq!(schedule.advance().view, order.view(iteration));
        }
    }
}
