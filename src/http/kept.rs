//! A few costly things, kept for the next request that needs them.

use std::sync::{Arc, Mutex, PoisonError};

/// How many are kept; each takes some bytes for every pixel of its picture.
const KEPT: usize = 4;

/// The values made lately, by what they were made for, the latest last.
#[derive(Debug)]
pub(super) struct Kept<K, V>(Mutex<Vec<(K, Arc<V>)>>);

impl<K, V> Default for Kept<K, V> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<K: PartialEq, V> Kept<K, V> {
    /// The value for `key`, if it is there still.
    pub(super) fn get(&self, key: &K) -> Option<Arc<V>> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().find(|(known, _)| known == key).map(|(_, value)| Arc::clone(value))
    }

    /// Keeps a value in place of the oldest.
    pub(super) fn keep(&self, key: K, value: V) -> Arc<V> {
        let value = Arc::new(value);
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.retain(|(known, _)| *known != key);
        if kept.len() == KEPT {
            kept.remove(0);
        }
        kept.push((key, Arc::clone(&value)));
        value
    }
}
