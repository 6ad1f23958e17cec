//! Processes a sequence with several threads; results come in the order of the sequence.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::mpsc::sync_channel;
use std::thread;

/// Calls a worker on each of `items`, and `take` on each result as soon as it is available, in the
/// order of the items. Each of the `threads` gets its own worker from `new_worker`. Stops at the
/// first error of `take`.
///
/// # Errors
/// The error of `take`.
pub fn in_order<T, R, E, W>(
    items: impl Iterator<Item = T> + Send,
    threads: usize,
    new_worker: impl Fn() -> W + Sync,
    mut take: impl FnMut(R) -> Result<(), E>,
) -> Result<(), E>
where
    T: Send,
    R: Send,
    W: FnMut(T) -> R,
{
    let items = Mutex::new(items.enumerate());
    // A poisoned lock means that another thread panicked; the scope passes the panic on.
    let next_item = || items.lock().ok().and_then(|mut items| items.next());
    thread::scope(|scope| {
        let (send, receive) = sync_channel::<(usize, R)>(2 * threads);
        let start = |k: usize| {
            let (send, next_item, new_worker) = (send.clone(), &next_item, &new_worker);
            let work = move || {
                let mut worker = new_worker();
                while let Some((index, item)) = next_item() {
                    if send.send((index, worker(item))).is_err() {
                        return;
                    }
                }
            };
            thread::Builder::new().name(format!("work-{k}")).spawn_scoped(scope, work).is_ok()
        };
        // Where the system has no more threads, those that it has suffice, or this one.
        if (0..threads.max(1)).filter(|k| start(*k)).count() == 0 {
            let mut worker = new_worker();
            while let Some((_, item)) = next_item() {
                take(worker(item))?;
            }
        }
        drop(send);
        let (mut next, mut early) = (0, BTreeMap::new());
        for (index, result) in receive {
            early.insert(index, result);
            while let Some(result) = early.remove(&next) {
                take(result)?;
                next += 1;
            }
        }
        Ok(())
    })
}

/// The number of threads to use by default.
pub fn all_cores() -> usize {
    thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_whatever_each_takes() {
        for threads in [1, 2, 7] {
            let mut seen = Vec::new();
            let new_worker = || {
                |item: u64| (0..(item * 7919) % 5000).fold(item, |item, k| item ^ (k & 1) ^ (k & 1))
            };
            let done: Result<(), ()> = in_order(0..500_u64, threads, new_worker, |result| {
                seen.push(result);
                Ok(())
            });
            assert_eq!((done, seen), (Ok(()), (0..500).collect()));
        }
    }

    #[test]
    fn an_error_ends_it() {
        let mut taken = 0;
        let done = in_order(
            0..,
            3,
            || |item: u32| item,
            |item| {
                taken += 1;
                if item == 10 { Err("enough") } else { Ok(()) }
            },
        );
        assert_eq!((done, taken), (Err("enough"), 11));
    }
}
