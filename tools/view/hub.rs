//! Requests of the pages, waiting for the one thread that renders.
//!
//! Each page has one waiting camera, its newest, and at most one frame under way. The next frame is rendered after the page has
//! confirmed the last, so a slow page gets fewer frames, but never old ones. Pages and the film in progress take turns.

mod outbox;

use super::edits::GaussianSet;
use super::protocol::{Edit, EditRequest, FilmRequest, Pick, ToPage, TrainAction, ViewRequest};
use ashsplat::Gaussians;
use ashsplat_files::splats::WriteOptions;
use ashsplat_program::session::locked;
use outbox::Outbox;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Most pages; more are refused.
const MAX_PAGES: usize = 24;
/// Most waiting requests for the scene itself; more are refused.
const MAX_SCENES: usize = 2;
/// Most waiting picks of one page; more are refused.
const MAX_PICKS: usize = 4;
/// Most waiting edits of one page; more are refused.
const MAX_EDITS: usize = 2;
/// Most waiting training actions; more are refused.
const MAX_ACTIONS: usize = 64;

/// Answer to a request for the current Gaussians, to write them to a file. An error says in words why there are none.
pub type SceneAnswer = oneshot::Sender<Result<CurrentScene, String>>;

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
    Scene {
        part: GaussianSet,
        answer: SceneAnswer,
    },
    Edit {
        client: u64,
        edit: Edit,
    },
}

#[derive(Default)]
struct Client {
    out: Arc<Outbox>,
    view: Option<ViewRequest>,
    /// True if the camera or the scene has changed since the last frame.
    stale: bool,
    in_flight: bool,
    picks: VecDeque<Pick>,
    edits: VecDeque<Edit>,
    /// Turn in which it was served last.
    served: u64,
}

#[derive(Default)]
struct State {
    clients: BTreeMap<u64, Client>,
    next_client: u64,
    turn: u64,
    scenes: VecDeque<(GaussianSet, SceneAnswer)>,
    film_served: u64,
    actions: VecDeque<TrainAction>,
    /// Waiting films, at most one of each page.
    films: VecDeque<(u64, FilmRequest)>,
    /// Page whose film is in progress.
    filming: Option<u64>,
    /// True if the film in progress is cancelled.
    film_cancelled: bool,
    film_files: BTreeSet<String>,
    greeting: String,
    /// The scene's `run` in this message.
    run: String,
    /// Describes training's progress; see [`Hub::set_status`].
    status: Option<Box<dyn Fn(u32) -> String + Send>>,
}

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

    /// Sets the first message to every page. Edits of another scene that still wait are dropped.
    pub fn greet_with(&self, greeting: &Value) {
        self.change(|state| {
            state.greeting = greeting.to_string();
            state.run = greeting["run"].as_str().unwrap_or_default().into();
            state.clients.values_mut().for_each(|client| client.edits.clear());
        });
    }

    /// Returns the scene's `run` in the first message.
    pub fn run(&self) -> String {
        self.lock().run.clone()
    }

    /// Sets the function that describes training's progress from an iteration on.
    pub fn set_status(&self, status: impl Fn(u32) -> String + Send + 'static) {
        self.change(|state| state.status = Some(Box::new(status)));
    }

    pub fn accepts_pages(&self) -> bool {
        self.pages() < MAX_PAGES
    }

    /// Adds a page. Returns its number and outbox, or none if there are too many.
    pub fn join(&self) -> Option<(u64, Arc<Outbox>)> {
        self.change(|state| {
            if state.clients.len() >= MAX_PAGES {
                return None;
            }
            state.next_client += 1;
            let outbox = Arc::new(Outbox::default());
            // The page sends this number with its requests for photos.
            outbox.put(ToPage::json(&json!({ "type": "page", "page": state.next_client })));
            outbox.put(ToPage::Text(state.greeting.clone()));
            let client = Client { out: outbox.clone(), served: state.turn, ..Client::default() };
            state.clients.insert(state.next_client, client);
            Some((state.next_client, outbox))
        })
    }

    pub fn leave(&self, client: u64) {
        self.change(|state| {
            state.clients.remove(&client);
            state.cancel_film(client);
        });
    }

    pub fn pages(&self) -> usize {
        self.lock().clients.len()
    }

    pub fn has_page(&self, client: u64) -> bool {
        self.lock().clients.contains_key(&client)
    }

    /// Changes a page's state, if it is still connected.
    fn change_client<T>(&self, client: u64, change: impl FnOnce(&mut Client) -> T) -> Option<T> {
        self.change(|state| state.clients.get_mut(&client).map(change))
    }

    pub fn set_view(&self, client: u64, view: ViewRequest) {
        self.change_client(client, |client| (client.view, client.stale) = (Some(view), true));
    }

    /// Confirms that a page's frame has arrived.
    pub fn acknowledge(&self, client: u64) {
        self.change_client(client, |client| client.in_flight = false);
    }

    /// Queues a page's question about a pixel; false if too many of its picks wait.
    pub fn pick(&self, client: u64, pick: Pick) -> bool {
        self.change_client(client, |client| queue(&mut client.picks, pick, MAX_PICKS)).unwrap_or(false)
    }

    /// Queues a request for the Gaussians; false if too many wait.
    pub fn request_scene(&self, part: GaussianSet, answer: SceneAnswer) -> bool {
        self.change(|state| queue(&mut state.scenes, (part, answer), MAX_SCENES))
    }

    /// Queues a page's edit.
    ///
    /// # Errors
    /// In words, if the edit is of another scene, and if too many edits of the page wait.
    pub fn edit(&self, client: u64, EditRequest { run, edit }: EditRequest) -> Result<(), &'static str> {
        self.change(|state| {
            if run != state.run {
                return Err("the scene has changed: select again");
            }
            let Some(client) = state.clients.get_mut(&client) else { return Ok(()) };
            let queued = queue(&mut client.edits, edit, MAX_EDITS);
            queued.then_some(()).ok_or("too many edits wait: try again in a moment")
        })
    }

    /// Requests new frames for the pages that follow the scene's changes.
    pub fn renew(&self) {
        self.change(|state| {
            for client in state.clients.values_mut() {
                client.stale |= client.view.as_ref().is_some_and(|view| view.follow);
            }
        });
    }

    /// Queues a training action; false if nothing is trained or too many wait.
    pub fn act(&self, action: TrainAction) -> bool {
        self.change(|state| state.status.is_some() && queue(&mut state.actions, action, MAX_ACTIONS))
    }

    pub fn actions(&self) -> Vec<TrainAction> {
        self.lock().actions.drain(..).collect()
    }

    pub fn send(&self, client: u64, message: ToPage) {
        if let Some(client) = self.lock().clients.get(&client) {
            client.out.put(message);
        }
    }

    pub fn broadcast(&self, message: &ToPage) {
        for client in self.lock().clients.values() {
            client.out.put(message.clone());
        }
    }

    /// Describes training's progress to a page; none if nothing is trained.
    pub fn status(&self, since: u32) -> Option<String> {
        self.lock().status.as_ref().map(|status| status(since))
    }

    /// Requests a film. Returns the number of films before it, or none if the page has one already.
    pub fn film(&self, client: u64, request: FilmRequest) -> Option<usize> {
        self.change(|state| {
            let has = state.filming == Some(client) || state.films.iter().any(|(owner, _)| *owner == client);
            if has || !state.clients.contains_key(&client) {
                return None;
            }
            state.films.push_back((client, request));
            Some(state.films.len() - 1 + usize::from(state.filming.is_some()))
        })
    }

    /// Cancels a page's film. True if the film was still waiting. A film in progress ends once its maker calls
    /// [`Hub::film_is_cancelled`].
    pub fn cancel_film(&self, client: u64) -> bool {
        self.change(|state| state.cancel_film(client))
    }

    /// Takes the film that has waited longest; it is now in progress.
    pub fn take_film(&self) -> Option<(u64, FilmRequest)> {
        self.change(|state| {
            let next = state.films.pop_front()?;
            (state.filming, state.film_cancelled) = (Some(next.0), false);
            Some(next)
        })
    }

    /// True if the film in progress is cancelled: by its page, or because the page has left.
    pub fn film_is_cancelled(&self) -> bool {
        self.lock().film_cancelled
    }

    pub fn film_ended(&self) {
        self.change(|state| (state.filming, state.film_cancelled) = (None, false));
    }

    /// Lets pages fetch these files of a film.
    pub fn publish_film(&self, files: impl IntoIterator<Item = String>) {
        self.change(|state| state.film_files.extend(files));
    }

    /// True if the file belongs to a film of this run of the program.
    pub fn has_film_file(&self, name: &str) -> bool {
        self.lock().film_files.contains(name)
    }

    pub fn has_films(&self) -> bool {
        self.lock().has_films()
    }

    /// True if any request is waiting, or a film is in progress.
    pub fn has_work(&self) -> bool {
        let state = self.lock();
        !state.scenes.is_empty() || state.has_films() || state.clients.values().any(Client::waits)
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

impl Client {
    fn waits(&self) -> bool {
        !self.picks.is_empty() || !self.edits.is_empty() || self.stale && !self.in_flight
    }
}

impl State {
    /// Cancels a page's film; true if it was still waiting.
    fn cancel_film(&mut self, client: u64) -> bool {
        self.film_cancelled |= self.filming == Some(client);
        let before = self.films.len();
        self.films.retain(|(owner, _)| *owner != client);
        self.films.len() < before
    }

    fn has_films(&self) -> bool {
        self.filming.is_some() || !self.films.is_empty()
    }

    /// Takes the request of the page that has waited longest for a turn.
    fn take_task(&mut self) -> Option<Task> {
        // Scene requests are few: each is written and sent before its page asks again.
        if let Some((part, answer)) = self.scenes.pop_front() {
            return Some(Task::Scene { part, answer });
        }
        self.turn += 1;
        let films_turn = if self.has_films() { self.film_served } else { u64::MAX };
        let page = self.clients.iter_mut().filter(|(_, client)| client.waits());
        let page = page.min_by_key(|(_, client)| client.served);
        let pages_turn = page.as_ref().map_or(u64::MAX, |(_, client)| client.served);
        if films_turn < pages_turn {
            self.film_served = self.turn;
            return Some(Task::Film);
        }
        let (&id, client) = page?;
        client.served = self.turn;
        if let Some(edit) = client.edits.pop_front() {
            return Some(Task::Edit { client: id, edit });
        }
        if let Some(pick) = client.picks.pop_front() {
            return Some(Task::Pick { client: id, pick });
        }
        client.stale = false;
        client.in_flight = true;
        client.view.clone().map(|request| Task::Frame { client: id, request })
    }
}

/// Adds to a queue; false if it is full.
fn queue<T>(queue: &mut VecDeque<T>, item: T, max: usize) -> bool {
    let has_room = queue.len() < max;
    if has_room {
        queue.push_back(item);
    }
    has_room
}
