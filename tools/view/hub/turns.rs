//! Waiting requests for the rendering thread, and the order in which it serves them.

use super::{Outbox, RemoteRequest, SceneRequest, Task};
use crate::protocol::{FilmRequest, Pick, TrainAction, ViewRequest};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// One page.
pub(super) struct Client {
    pub(super) out: Arc<Outbox>,
    /// The newest camera.
    pub(super) view: Option<ViewRequest>,
    /// True if the camera or the scene has changed since the last frame.
    pub(super) stale: bool,
    /// True if a frame is under way.
    pub(super) on_the_way: bool,
    pub(super) picks: VecDeque<Pick>,
    /// Turn in which it was served last.
    pub(super) served: u64,
}

#[derive(Default)]
pub(super) struct State {
    pub(super) clients: BTreeMap<u64, Client>,
    pub(super) next_client: u64,
    pub(super) turn: u64,
    pub(super) remote: VecDeque<RemoteRequest>,
    pub(super) scenes: VecDeque<SceneRequest>,
    /// The turns in which a film and another program were served last.
    pub(super) film_served: u64,
    pub(super) remote_served: u64,
    pub(super) actions: VecDeque<TrainAction>,
    /// Waiting films, at most one of each page.
    pub(super) films: VecDeque<(u64, FilmRequest)>,
    /// Page whose film is in progress.
    pub(super) filming: Option<u64>,
    /// True if the film in progress is cancelled.
    pub(super) called_off: bool,
    /// Names of the files of finished films.
    pub(super) film_files: BTreeSet<String>,
    /// First message to every page.
    pub(super) greeting: String,
    /// Describes training's progress; see [`super::Hub::set_status`].
    pub(super) status: Option<Box<dyn Fn(u32) -> String + Send>>,
}

impl Client {
    pub(super) fn waits(&self) -> bool {
        !self.picks.is_empty() || self.stale && !self.on_the_way
    }
}

impl State {
    /// Cancels a page's film; true if it was still waiting.
    pub(super) fn call_off(&mut self, client: u64) -> bool {
        self.called_off |= self.filming == Some(client);
        let before = self.films.len();
        self.films.retain(|(owner, _)| *owner != client);
        self.films.len() < before
    }

    pub(super) fn has_films(&self) -> bool {
        self.filming.is_some() || !self.films.is_empty()
    }

    /// Takes the request of the page that has waited longest for a turn.
    pub(super) fn take_task(&mut self) -> Option<Task> {
        // Scene requests are few: each is written and sent before its page asks again.
        if let Some(request) = self.scenes.pop_front() {
            return Some(Task::Scene(request));
        }
        self.turn += 1;
        let films_turn = if self.has_films() { self.film_served } else { u64::MAX };
        let page = self.clients.iter_mut().filter(|(_, client)| client.waits());
        let page = page.min_by_key(|(_, client)| client.served);
        let pages_turn = page.as_ref().map_or(u64::MAX, |(_, client)| client.served);
        if self.remote_served <= pages_turn.min(films_turn)
            && let Some(request) = self.remote.pop_front()
        {
            self.remote_served = self.turn;
            return Some(Task::Remote(request));
        }
        if films_turn < pages_turn {
            self.film_served = self.turn;
            return Some(Task::Film);
        }
        let (&id, client) = page?;
        client.served = self.turn;
        if let Some(pick) = client.picks.pop_front() {
            return Some(Task::Pick { client: id, pick });
        }
        client.stale = false;
        client.on_the_way = true;
        client.view.map(|request| Task::Frame { client: id, request })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hub::Hub;
    use crate::hub::films::tests::film;
    use crate::hub::tests::{join, view};
    use std::time::Duration;

    #[test]
    fn another_program_and_films_take_turns_with_pages() {
        let hub = Hub::default();
        let [a, b] = [(); 2].map(|()| join(&hub));
        let (answer, _answers) = std::sync::mpsc::sync_channel(1);
        let served: String = (0..12)
            .map(|round| {
                // Each always has a request.
                [a, b].iter().for_each(|&page| hub.set_view(page, view(round)));
                hub.film(b, film());
                if hub.lock().remote.is_empty() {
                    let camera = view(round).camera.camera().expect("a camera");
                    hub.ask_remotely(RemoteRequest { camera, scale: 1.0, answer: answer.clone() });
                }
                match hub.next(Duration::ZERO).expect("a task") {
                    Task::Frame { client, .. } => {
                        hub.acknowledge(client);
                        if client == a { 'a' } else { 'b' }
                    }
                    Task::Film => {
                        hub.take_film();
                        'f'
                    }
                    Task::Remote(_) => 'r',
                    Task::Pick { .. } => 'p',
                    Task::Scene(_) => 's',
                }
            })
            .collect();
        let (first, rest) = served.split_at(4);
        assert!("abfr".chars().all(|who| first.contains(who)), "{served}");
        assert_eq!(rest, first.repeat(2), "{served}");
    }
}
