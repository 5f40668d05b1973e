//! A value that one thread writes and others read.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Clones share the value. If a thread panicked while it held the lock, at worst a count is too small.
#[derive(Debug, Default)]
pub(super) struct Shared<T>(Arc<Mutex<T>>);

impl<T> Shared<T> {
    pub fn lock(&self) -> MutexGuard<'_, T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: Clone> Shared<T> {
    pub fn copy(&self) -> T {
        self.lock().clone()
    }
}

impl<T> Clone for Shared<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}
