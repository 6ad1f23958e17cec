//! A small cache of values that are costly to compute.

use std::sync::{Arc, Mutex};

use crate::locks::lock;

/// How many values are kept; each takes some bytes for every pixel of its image.
const KEPT_VALUES: usize = 4;

/// The values computed last with their keys, the newest last.
#[derive(Debug)]
pub(super) struct NewestValues<K, V>(Mutex<Vec<(K, Arc<V>)>>);

impl<K, V> Default for NewestValues<K, V> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<K: PartialEq, V> NewestValues<K, V> {
    /// The value for `key`; a missing one is computed and replaces the oldest.
    ///
    /// # Errors
    /// Those of `make`.
    pub(super) fn get_or_make<E>(
        &self,
        key: &K,
        make: impl FnOnce() -> Result<(K, V), E>,
    ) -> Result<Arc<V>, E> {
        if let Some(known) = self.get(key) {
            return Ok(known);
        }
        let (key, value) = make()?;
        let value = Arc::new(value);
        let mut kept = lock(&self.0);
        kept.retain(|(known, _)| *known != key);
        if kept.len() == KEPT_VALUES {
            kept.remove(0);
        }
        kept.push((key, Arc::clone(&value)));
        Ok(value)
    }

    fn get(&self, key: &K) -> Option<Arc<V>> {
        let kept = lock(&self.0);
        kept.iter().find(|(known, _)| known == key).map(|(_, value)| Arc::clone(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_makes_room() {
        let values = NewestValues::default();
        let mut made = 0;
        let mut get = |key: usize| {
            let make = || {
                made += 1;
                Ok::<_, ()>((key, key * 10))
            };
            assert_eq!(*values.get_or_make(&key, make).unwrap(), key * 10);
            made
        };
        assert_eq!((0..KEPT_VALUES).map(&mut get).last(), Some(KEPT_VALUES));
        assert_eq!(get(0), KEPT_VALUES, "it is kept");
        assert_eq!(get(KEPT_VALUES), KEPT_VALUES + 1);
        assert_eq!(get(0), KEPT_VALUES + 2, "it was the oldest");
    }
}
