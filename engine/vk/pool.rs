//! Objects that a recording borrows and returns when it ends, even by a panic.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

/// Storage of a reusable object between recordings.
pub(super) type Pool<T> = Arc<Mutex<T>>;

/// A value that returns to its pool when it is dropped.
pub(super) struct PoolGuard<T: Default> {
    value: T,
    /// None: the value is dropped, not returned.
    pool: Option<Pool<T>>,
}

impl<T: Default> PoolGuard<T> {
    /// Takes the object out of the pool, and leaves a default value there.
    pub(super) fn take_from(pool: &Pool<T>) -> Self {
        let value = std::mem::take(&mut *pool.lock().unwrap_or_else(PoisonError::into_inner));
        Self { value, pool: Some(pool.clone()) }
    }

    /// Takes the value out of the guard; it does not return to the pool.
    pub(super) fn keep(mut self) -> T {
        self.pool = None;
        std::mem::take(&mut self.value)
    }

    /// True if this is the pool to which the value returns.
    pub(super) fn is_from(&self, pool: &Pool<T>) -> bool {
        self.pool.as_ref().is_some_and(|own| Arc::ptr_eq(own, pool))
    }
}

impl<T: Default> Default for PoolGuard<T> {
    fn default() -> Self {
        Self { value: T::default(), pool: None }
    }
}

impl<T: Default> Deref for PoolGuard<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T: Default> DerefMut for PoolGuard<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T: Default> Drop for PoolGuard<T> {
    fn drop(&mut self) {
        if let Some(pool) = &self.pool {
            *pool.lock().unwrap_or_else(PoisonError::into_inner) = std::mem::take(&mut self.value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_home_unless_it_is_kept() {
        let pool: Pool<Vec<u32>> = Arc::new(Mutex::new(vec![1]));
        let mut guard = PoolGuard::take_from(&pool);
        guard.push(2);
        assert!(pool.lock().expect("unpoisoned").is_empty() && guard.is_from(&pool));
        drop(guard);
        assert_eq!(*pool.lock().expect("unpoisoned"), [1, 2]);
        assert_eq!(PoolGuard::take_from(&pool).keep(), [1, 2]);
        assert!(pool.lock().expect("unpoisoned").is_empty());
    }

    #[test]
    fn a_panic_sends_it_home() {
        let pool: Pool<Vec<u32>> = Arc::new(Mutex::new(vec![1]));
        let guard = PoolGuard::take_from(&pool);
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(move || {
            let _guard = guard;
            panic!("in the middle");
        }));
        assert!(panicked.is_err());
        assert_eq!(*pool.lock().expect("unpoisoned"), [1]);
    }
}
