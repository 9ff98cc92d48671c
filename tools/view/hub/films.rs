//! Films that pages request. They wait in order, and a page can cancel its own.

use super::Hub;
use crate::protocol::FilmRequest;

impl Hub {
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
    /// [`Hub::film_is_called_off`].
    pub fn cancel_film(&self, client: u64) -> bool {
        self.change(|state| state.call_off(client))
    }

    /// Takes the film that has waited longest; it is now in progress.
    pub fn take_film(&self) -> Option<(u64, FilmRequest)> {
        self.change(|state| {
            let next = state.films.pop_front()?;
            (state.filming, state.called_off) = (Some(next.0), false);
            Some(next)
        })
    }

    /// True if the film in progress is cancelled: by its page, or because the page has left.
    pub fn film_is_called_off(&self) -> bool {
        self.lock().called_off
    }

    /// Marks the film in progress as ended.
    pub fn film_ended(&self) {
        self.change(|state| (state.filming, state.called_off) = (None, false));
    }

    /// Lets pages fetch these files of a film.
    pub fn publish_film(&self, files: impl IntoIterator<Item = String>) {
        self.change(|state| state.film_files.extend(files));
    }

    /// True if the file belongs to a film of this run of the program.
    pub fn has_film_file(&self, name: &str) -> bool {
        self.lock().film_files.contains(name)
    }

    /// True if a film is in progress or waits.
    pub fn has_films(&self) -> bool {
        self.lock().has_films()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::hub::tests::join;
    use crate::protocol::Look;

    pub(in crate::hub) fn film() -> FilmRequest {
        let look = Look::default();
        FilmRequest {
            keys: Vec::new(),
            seconds: 1.0,
            frames_per_second: 1,
            closed: false,
            width: 1,
            height: 1,
            look,
        }
    }

    #[test]
    fn films_wait_for_their_turn_and_pages_call_off_their_own_only() {
        let hub = Hub::default();
        let [a, b, c] = [(); 3].map(|()| join(&hub));
        assert_eq!((hub.film(a, film()), hub.film(b, film())), (Some(0), Some(1)));
        assert_eq!(hub.film(a, film()), None, "one of each page");
        assert_eq!(hub.take_film().map(|(owner, _)| owner), Some(a));
        assert_eq!((hub.film(c, film()), hub.film(a, film())), (Some(2), None));
        // A waiting film goes at once; the film in progress stays.
        assert!(hub.cancel_film(b) && !hub.film_is_called_off());
        assert!(!hub.cancel_film(b), "it has none any more");
        // A film in progress stays cancelled when another page requests one.
        assert!(!hub.cancel_film(a));
        assert_eq!(hub.film(b, film()), Some(2));
        assert!(hub.film_is_called_off());
        hub.film_ended();
        assert_eq!(hub.take_film().map(|(owner, _)| owner), Some(c));
        assert!(!hub.film_is_called_off(), "that was another");
        // A page that leaves cancels its films.
        hub.leave(b);
        hub.leave(c);
        assert!(hub.film_is_called_off());
        hub.film_ended();
        assert!(hub.take_film().is_none() && !hub.has_films());
        assert_eq!(hub.film(c, film()), None, "no page is connected");
    }
}
