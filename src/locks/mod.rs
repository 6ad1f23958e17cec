//! Locks that outlive a fault. A thread that panics while it holds a lock poisons it; what it did
//! is caught and reported where it runs, and the others go on with what the lock guards, which
//! every holder leaves whole: a list, a map or one value that is replaced.

use std::sync::{
    LockResult, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard,
};

/// Waits for the lock.
pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    unpoisoned(mutex.lock())
}

/// Waits until nobody writes.
pub(crate) fn read<T: ?Sized>(shared: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    unpoisoned(shared.read())
}

/// Waits until nobody reads or writes.
pub(crate) fn write<T: ?Sized>(shared: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    unpoisoned(shared.write())
}

/// What a lock or a wait gives, also after a fault.
pub(crate) fn unpoisoned<T>(result: LockResult<T>) -> T {
    result.unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_of_one_holder_does_not_stop_the_others() {
        let (mutex, shared) = (Mutex::new(1), RwLock::new(1));
        let fault = std::thread::scope(|scope| {
            let holder = scope.spawn(|| {
                let (_mutex, _shared) = (lock(&mutex), write(&shared));
                panic!("a fault while both are held");
            });
            holder.join()
        });
        assert!(fault.is_err() && mutex.is_poisoned() && shared.is_poisoned());
        *lock(&mutex) += 1;
        *write(&shared) += 1;
        assert_eq!((*lock(&mutex), *read(&shared)), (2, 2));
    }
}
