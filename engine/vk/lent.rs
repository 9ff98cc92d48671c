//! What a slot lends to a recording and gets back however the recording ends: also by a panic.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

/// Where something lies while it is not lent.
pub(super) type Home<T> = Arc<Mutex<T>>;

/// Something that goes home when it is dropped.
pub(super) struct Lent<T: Default> {
    value: T,
    /// None: nobody wants it back.
    home: Option<Home<T>>,
}

impl<T: Default> Lent<T> {
    /// Takes it from where it lies; a default value lies there meanwhile.
    pub(super) fn from_home(home: &Home<T>) -> Self {
        let value = std::mem::take(&mut *home.lock().unwrap_or_else(PoisonError::into_inner));
        Self { value, home: Some(home.clone()) }
    }

    /// The value, which does not go home any more.
    pub(super) fn keep(mut self) -> T {
        self.home = None;
        std::mem::take(&mut self.value)
    }

    /// Whether this is where it goes.
    pub(super) fn is_from(&self, home: &Home<T>) -> bool {
        self.home.as_ref().is_some_and(|own| Arc::ptr_eq(own, home))
    }
}

impl<T: Default> Default for Lent<T> {
    fn default() -> Self {
        Self { value: T::default(), home: None }
    }
}

impl<T: Default> Deref for Lent<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T: Default> DerefMut for Lent<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T: Default> Drop for Lent<T> {
    fn drop(&mut self) {
        if let Some(home) = &self.home {
            *home.lock().unwrap_or_else(PoisonError::into_inner) = std::mem::take(&mut self.value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_home_unless_it_is_kept() {
        let home: Home<Vec<u32>> = Arc::new(Mutex::new(vec![1]));
        let mut lent = Lent::from_home(&home);
        lent.push(2);
        assert!(home.lock().expect("unpoisoned").is_empty() && lent.is_from(&home));
        drop(lent);
        assert_eq!(*home.lock().expect("unpoisoned"), [1, 2]);
        assert_eq!(Lent::from_home(&home).keep(), [1, 2]);
        assert!(home.lock().expect("unpoisoned").is_empty());
    }

    #[test]
    fn a_panic_sends_it_home() {
        let home: Home<Vec<u32>> = Arc::new(Mutex::new(vec![1]));
        let lent = Lent::from_home(&home);
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(move || {
            let _lent = lent;
            panic!("in the middle");
        }));
        assert!(panicked.is_err());
        assert_eq!(*home.lock().expect("unpoisoned"), [1]);
    }
}
