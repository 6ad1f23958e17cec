//! Compiles the modules that pass data between threads a second time, with the primitives of
//! `shuttle`: their tests run under thousands of thread schedules, the same ones each time.
//! Shuttle's waits never time out, so code that only makes progress through a time limit is
//! reported as a deadlock.

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

        /// Schedules of each kind that a test runs under.
        const ORDERS: usize = 1000;
        /// Preemptions in a schedule of the second kind (Burckhardt et al., "A randomized scheduler
        /// with probabilistic guarantees of finding bugs", 2010).
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

        /// Under uniformly random schedules, and under schedules with few preemptions.
        pub(in crate::pipeline) fn in_any_order(test: impl Fn() + Send + Sync + Clone + 'static) {
            let evenly = RandomScheduler::new_from_seed(SEED, ORDERS);
            Runner::new(evenly, config()).run(test.clone());
            let preempted = PctScheduler::new_from_seed(SEED, DEPTH, ORDERS);
            Runner::new(preempted, config()).run(test);
        }

        /// Once: for a test with one thread.
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
