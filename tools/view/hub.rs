//! Requests of the pages, waiting for the one thread that renders.
//!
//! Each page has one waiting camera, its newest, and at most one frame under way. The next frame is rendered after the page has
//! confirmed the last, so a slow page gets fewer frames, but never old ones. Pages, the film in progress and programs that
//! speak the reference's protocol take turns.

mod films;
mod outbox;
mod turns;

use super::protocol::{Pick, ToPage, TrainAction, ViewRequest};
use ashsplat::Gaussians;
use ashsplat_files::splats::WriteOptions;
use ashsplat_program::session::locked;
use outbox::Outbox;
use serde_json::json;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use turns::{Client, State};

/// Most pages; more are refused.
const MOST_PAGES: usize = 24;
/// Most waiting pictures for programs of the reference's protocol; more are refused.
const MOST_REMOTE: usize = 8;
/// Most waiting requests for the scene itself; more are refused.
const MOST_SCENES: usize = 2;
/// Most waiting picks of one page; more are refused.
const MOST_PICKS: usize = 4;
/// Most waiting training actions; more are refused.
const MOST_ACTIONS: usize = 64;

/// A picture for a program that speaks the reference's protocol; the answer is its RGB bytes.
#[derive(Debug)]
pub struct RemoteRequest {
    pub camera: ashsplat::Camera,
    pub scale: f32,
    /// Channel of capacity one.
    pub answer: std::sync::mpsc::SyncSender<Vec<u8>>,
}

/// A request for the current Gaussians, to write them to a file.
#[derive(Debug)]
pub struct SceneRequest {
    /// An error says in words why there are none.
    pub answer: oneshot::Sender<Result<CurrentScene, String>>,
}

/// The scene now.
#[derive(Debug)]
pub struct CurrentScene {
    pub gaussians: Gaussians,
    /// Shape and coordinate frame.
    pub marks: WriteOptions,
}

/// Next task of the rendering thread.
#[derive(Debug)]
pub enum Task {
    Frame {
        client: u64,
        request: ViewRequest,
    },
    Pick {
        client: u64,
        pick: Pick,
    },
    /// The next frame of the film in progress, or the first of a new film.
    Film,
    Remote(RemoteRequest),
    Scene(SceneRequest),
}

/// See the module.
#[derive(Default)]
pub struct Hub {
    state: Mutex<State>,
    wake: Condvar,
}

impl Hub {
    fn lock(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    fn change<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let result = change(&mut self.lock());
        self.wake.notify_all();
        result
    }

    /// Sets the first message to every page.
    pub fn greet_with(&self, greeting: String) {
        self.change(|state| state.greeting = greeting);
    }

    /// Sets the function that describes training's progress from an iteration on.
    pub fn set_status(&self, status: impl Fn(u32) -> String + Send + 'static) {
        self.change(|state| state.status = Some(Box::new(status)));
    }

    /// True if another page may join.
    pub fn has_room(&self) -> bool {
        self.pages() < MOST_PAGES
    }

    /// Adds a page. Returns its number and outbox, or none if there are too many.
    pub fn join(&self) -> Option<(u64, Arc<Outbox>)> {
        self.change(|state| {
            if state.clients.len() >= MOST_PAGES {
                return None;
            }
            state.next_client += 1;
            let outbox = Arc::new(Outbox::default());
            // The page sends this number with its requests for photos.
            outbox.put(ToPage::json(&json!({ "type": "page", "page": state.next_client })));
            outbox.put(ToPage::Text(state.greeting.clone()));
            let client = Client {
                out: outbox.clone(),
                view: None,
                stale: false,
                on_the_way: false,
                picks: VecDeque::new(),
                served: state.turn,
            };
            state.clients.insert(state.next_client, client);
            Some((state.next_client, outbox))
        })
    }

    /// Removes a page.
    pub fn leave(&self, client: u64) {
        self.change(|state| {
            state.clients.remove(&client);
            state.call_off(client);
        });
    }

    /// Number of connected pages.
    pub fn pages(&self) -> usize {
        self.lock().clients.len()
    }

    /// True if a page of this number is connected.
    pub fn has_page(&self, client: u64) -> bool {
        self.lock().clients.contains_key(&client)
    }

    /// Sets the newest camera of a page.
    pub fn set_view(&self, client: u64, view: ViewRequest) {
        self.change(|state| {
            if let Some(client) = state.clients.get_mut(&client) {
                client.view = Some(view);
                client.stale = true;
            }
        });
    }

    /// Confirms that a page's frame has arrived.
    pub fn acknowledge(&self, client: u64) {
        self.change(|state| {
            if let Some(client) = state.clients.get_mut(&client) {
                client.on_the_way = false;
            }
        });
    }

    /// Queues a page's question about a pixel; false if too many of its picks wait.
    pub fn pick(&self, client: u64, pick: Pick) -> bool {
        self.change(|state| {
            let client = state.clients.get_mut(&client);
            client.is_some_and(|client| queue(&mut client.picks, pick, MOST_PICKS))
        })
    }

    /// Queues another program's request for a picture; false if too many wait.
    pub fn ask_remotely(&self, request: RemoteRequest) -> bool {
        self.change(|state| queue(&mut state.remote, request, MOST_REMOTE))
    }

    /// Queues a request for the Gaussians; false if too many wait.
    pub fn ask_for_scene(&self, request: SceneRequest) -> bool {
        self.change(|state| queue(&mut state.scenes, request, MOST_SCENES))
    }

    /// Requests new frames for the pages that follow the scene's changes.
    pub fn renew(&self) {
        self.change(|state| {
            for client in state.clients.values_mut() {
                client.stale |= client.view.is_some_and(|view| view.follow);
            }
        });
    }

    /// Queues a training action; false if nothing is trained or too many wait.
    pub fn act(&self, action: TrainAction) -> bool {
        self.change(|state| state.status.is_some() && queue(&mut state.actions, action, MOST_ACTIONS))
    }

    /// Takes all queued training actions.
    pub fn actions(&self) -> Vec<TrainAction> {
        self.lock().actions.drain(..).collect()
    }

    /// Sends to one page.
    pub fn send(&self, client: u64, message: ToPage) {
        if let Some(client) = self.lock().clients.get(&client) {
            client.out.put(message);
        }
    }

    /// Sends to all pages.
    pub fn broadcast(&self, message: &ToPage) {
        for client in self.lock().clients.values() {
            client.out.put(message.clone());
        }
    }

    /// Describes training's progress to a page; none if nothing is trained.
    pub fn status(&self, since: u32) -> Option<String> {
        self.lock().status.as_ref().map(|status| status(since))
    }

    /// True if any request is waiting.
    pub fn is_wanted(&self) -> bool {
        let state = self.lock();
        !state.remote.is_empty()
            || !state.scenes.is_empty()
            || !state.films.is_empty()
            || state.clients.values().any(Client::waits)
    }

    /// Returns the next task; waits at most this long.
    pub fn next(&self, longest: Duration) -> Option<Task> {
        let end = Instant::now() + longest;
        let mut state = self.lock();
        loop {
            if let Some(task) = state.take_task() {
                return Some(task);
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() || !state.actions.is_empty() {
                return None;
            }
            state = match self.wake.wait_timeout(state, left) {
                Ok((state, _)) => state,
                Err(poisoned) => poisoned.into_inner().0,
            };
        }
    }
}

/// Adds to a queue; false if it is full.
fn queue<T>(queue: &mut VecDeque<T>, item: T, most: usize) -> bool {
    let has_room = queue.len() < most;
    if has_room {
        queue.push_back(item);
    }
    has_room
}

#[cfg(test)]
mod tests {
    use super::super::protocol::{CameraMessage, Look};
    use super::*;

    pub(super) fn view(seq: u64) -> ViewRequest {
        let camera = CameraMessage {
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
            width: 1,
            height: 1,
        };
        ViewRequest { seq, camera, look: Look::default(), follow: seq == 100, as_photo: None }
    }

    pub(super) fn join(hub: &Hub) -> u64 {
        hub.join().expect("room").0
    }

    fn next(hub: &Hub) -> Option<(u64, u64)> {
        match hub.next(Duration::ZERO) {
            Some(Task::Frame { client, request }) => Some((client, request.seq)),
            _ => None,
        }
    }

    #[test]
    fn the_newest_camera_wins_and_nothing_waits_behind_a_frame() {
        let hub = Hub::default();
        let client = join(&hub);
        assert_eq!(next(&hub), None);
        (1..=5).for_each(|seq| hub.set_view(client, view(seq)));
        assert_eq!(next(&hub), Some((client, 5)));
        hub.set_view(client, view(6));
        hub.set_view(client, view(7));
        assert_eq!(next(&hub), None, "the frame before has not come yet");
        hub.acknowledge(client);
        assert_eq!(next(&hub), Some((client, 7)));
        hub.acknowledge(client);
        assert_eq!(next(&hub), None, "nothing has changed");
        hub.renew();
        assert_eq!(next(&hub), None, "it does not follow");
        hub.set_view(client, view(100));
        assert!(next(&hub).is_some());
        hub.acknowledge(client);
        hub.renew();
        assert_eq!(next(&hub), Some((client, 100)));
    }

    #[test]
    fn pages_take_turns() {
        let hub = Hub::default();
        let [a, b, c] = [(); 3].map(|()| join(&hub));
        let mut served = Vec::new();
        // Page a asks for ten frames; the others ask for two.
        for round in 0..10 {
            hub.set_view(a, view(round));
            if round < 2 {
                hub.set_view(b, view(round));
                hub.set_view(c, view(round));
            }
            let (client, _) = next(&hub).expect("a frame");
            served.push(client);
            hub.acknowledge(client);
        }
        assert_eq!(served[..6], [a, b, c, a, a, a], "{served:?}");
        hub.leave(a);
        assert_eq!(next(&hub), None);
    }

    #[test]
    fn picks_are_bounded() {
        let hub = Hub::default();
        let client = join(&hub);
        let pick = Pick { id: 1, camera: view(1).camera, look: Look::default(), pixel: [0, 0] };
        let taken = (0..10).filter(|_| hub.pick(client, pick)).count();
        assert_eq!(taken, MOST_PICKS);
    }

    #[test]
    fn pages_and_other_programs_are_bounded() {
        let hub = Hub::default();
        let pages: Vec<u64> = (0..100).filter_map(|_| hub.join()).map(|(client, _)| client).collect();
        assert!(pages.len() == MOST_PAGES && !hub.has_room());
        hub.leave(pages[0]);
        assert!(hub.has_room() && hub.join().is_some());
        let (answer, _answers) = std::sync::mpsc::sync_channel(1);
        let camera = view(0).camera.camera().expect("a camera");
        let ask = || hub.ask_remotely(RemoteRequest { camera, scale: 1.0, answer: answer.clone() });
        assert_eq!((0..100).filter(|_| ask()).count(), MOST_REMOTE);
        let scene = || hub.ask_for_scene(SceneRequest { answer: oneshot::channel().0 });
        assert_eq!((0..100).filter(|_| scene()).count(), MOST_SCENES);
    }

    #[test]
    fn training_hears_a_bounded_number_of_actions() {
        let hub = Hub::default();
        // Without training, nothing would ever fetch the actions.
        assert!(!hub.act(TrainAction::Pause) && hub.actions().is_empty());
        hub.set_status(|_| String::new());
        let taken = (0..1000).filter(|_| hub.act(TrainAction::Step)).count();
        assert_eq!((taken, hub.actions().len()), (MOST_ACTIONS, MOST_ACTIONS));
        assert!(hub.act(TrainAction::Stop) && hub.actions().len() == 1);
    }
}
