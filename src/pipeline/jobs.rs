//! The jobs of an instrument's solve thread: at most one final solve, and one running estimate for
//! each camera. A newer job replaces an older one, whose result is no longer needed.

#[cfg(test)]
use super::sync::testing;
use super::sync::{Condvar, Mutex, MutexGuard, lock, unpoisoned};
use crate::estimation::interrupt::Interrupt;
use crate::pipeline::solve_job::{EstimateJob, SolveJob};

/// The next job.
#[derive(Debug)]
pub(super) enum Job {
    /// The final solve.
    Solve(Box<SolveJob>),
    /// A running estimate of one camera.
    Estimate(Box<EstimateJob>),
}

/// The jobs that wait.
#[derive(Debug, Default)]
pub(super) struct Jobs {
    state: Mutex<WaitingJobs>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct WaitingJobs {
    solve: Option<Box<SolveJob>>,
    /// Interrupts the solve that was taken last.
    running: Interrupt,
    /// By the camera's place.
    estimates: Vec<Option<Box<EstimateJob>>>,
    closed: bool,
}

impl Jobs {
    pub(super) fn solve(&self, job: SolveJob) {
        let mut state = self.lock();
        state.running.request();
        state.solve = Some(Box::new(job));
        // The session is being solved: it takes no estimate any more.
        state.estimates.clear();
        self.changed.notify_all();
    }

    pub(super) fn estimate(&self, job: EstimateJob) {
        let mut state = self.lock();
        let place = job.place;
        if state.estimates.len() <= place {
            state.estimates.resize_with(place + 1, || None);
        }
        state.estimates[place] = Some(Box::new(job));
        self.changed.notify_all();
    }

    /// Waits for a job; the final solve comes before any estimate. `None` once closed.
    pub(super) fn take(&self) -> Option<Job> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some(job) = state.solve.take() {
                state.running = job.interrupt.clone();
                return Some(Job::Solve(job));
            }
            if let Some(job) = state.estimates.iter_mut().find_map(Option::take) {
                return Some(Job::Estimate(job));
            }
            state = unpoisoned(self.changed.wait(state));
        }
    }

    /// The result is no longer needed.
    pub(super) fn abandon_solve(&self) {
        let mut state = self.lock();
        state.solve = None;
        state.running.request();
    }

    /// Ends the thread that takes the jobs, and interrupts its computation.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        state.running.request();
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, WaitingJobs> {
        lock(&self.state)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::testing::{alone, in_any_order, thread};
    use super::*;
    use crate::calibration::InstrumentObservations;
    use crate::estimation::problem::LensChoice;
    use crate::pipeline::solve_job::SolveInput;

    fn job(session: &str) -> SolveJob {
        let observations = InstrumentObservations { board: None, cameras: Vec::new() };
        let interrupt = Interrupt::new();
        let observations = SolveInput::Board(Box::new(observations));
        SolveJob { session: session.into(), lens: LensChoice::Auto, observations, interrupt }
    }

    fn taken(jobs: &Jobs) -> Box<SolveJob> {
        match jobs.take() {
            Some(Job::Solve(job)) => job,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_solve_that_nobody_waits_for_is_ended() {
        alone(|| {
            let jobs = Jobs::default();
            jobs.solve(job("first"));
            let first = taken(&jobs);
            assert!(!first.interrupt.is_requested());
            jobs.solve(job("second"));
            assert!(first.interrupt.is_requested(), "a newer one took its place");
            let second = taken(&jobs);
            assert!(!second.interrupt.is_requested());
            jobs.abandon_solve();
            assert!(second.interrupt.is_requested());
            jobs.solve(job("third"));
            let third = taken(&jobs);
            jobs.close();
            assert!(third.interrupt.is_requested() && jobs.take().is_none());
        });
    }

    #[test]
    fn closing_ends_the_solve_that_runs_and_whoever_waits_for_one() {
        in_any_order(|| {
            let jobs = Arc::new(Jobs::default());
            let solving = Arc::clone(&jobs);
            let solver = thread::spawn(move || {
                let taken: Vec<Job> = std::iter::from_fn(|| solving.take()).collect();
                let interrupted = |job: &Job| match job {
                    Job::Solve(solve) => solve.interrupt.is_requested(),
                    Job::Estimate(_) => false,
                };
                taken.iter().all(interrupted)
            });
            jobs.solve(job("first"));
            jobs.solve(job("second"));
            jobs.close();
            assert!(solver.join().unwrap());
        });
    }

    #[test]
    fn an_interrupted_solve_gives_no_result() {
        let job = job("one");
        job.interrupt.request();
        assert!(job.solve().is_err());
    }
}
