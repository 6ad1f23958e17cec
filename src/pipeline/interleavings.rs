//! The hand-overs between threads once more, compiled with the primitives of `shuttle`: their tests
//! run in thousands of orders of their threads, the same ones each time. Its waits never end by
//! their time limit, so that a hand-over that only a time limit ends is found as a deadlock.

/// `sync`, with shuttle's primitives.
mod sync {
    pub(super) use shuttle::sync::{Condvar, Mutex, MutexGuard};

    pub(super) use crate::locks::unpoisoned;

    pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
        unpoisoned(mutex.lock())
    }

    pub(in crate::pipeline) mod testing {
        use shuttle::scheduler::{PctScheduler, RandomScheduler};
        pub(in crate::pipeline) use shuttle::thread;
        use shuttle::{Config, FailurePersistence, Runner};

        /// Orders of each kind that a test runs in.
        const ORDERS: usize = 1000;
        /// Preemptions at chosen moments in an order of the second kind (Burckhardt et al., "A
        /// randomized scheduler with probabilistic guarantees of finding bugs", 2010).
        const DEPTH: usize = 3;
        const SEED: u64 = 1;
        /// The metrics need more than shuttle's own 32 kB.
        const STACK_BYTES: usize = 1 << 20;

        fn config() -> Config {
            let mut config = Config::new();
            config.stack_size = STACK_BYTES;
            config.failure_persistence = FailurePersistence::Print;
            config
        }

        /// In orders chosen evenly, and in orders with few preemptions.
        pub(in crate::pipeline) fn in_any_order(test: impl Fn() + Send + Sync + Clone + 'static) {
            let evenly = RandomScheduler::new_from_seed(SEED, ORDERS);
            Runner::new(evenly, config()).run(test.clone());
            let preempted = PctScheduler::new_from_seed(SEED, DEPTH, ORDERS);
            Runner::new(preempted, config()).run(test);
        }

        /// Once: a test of one thread.
        pub(in crate::pipeline) fn alone(test: impl Fn() + Send + Sync + 'static) {
            Runner::new(RandomScheduler::new_from_seed(SEED, 1), config()).run(test);
        }
    }
}

#[path = "assembly.rs"]
mod assembly;
#[path = "frame_slot.rs"]
mod frame_slot;
#[path = "jobs.rs"]
mod jobs;
#[path = "stop_signal.rs"]
mod stop_signal;
