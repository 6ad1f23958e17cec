//! Thread `solve-<instrument>`: computes estimates and solves, so that no frame waits for them.

use std::sync::Arc;
use std::time::Instant;

use crate::pipeline::instrument::Instrument;
use crate::pipeline::jobs::Job;
use crate::pipeline::message::Message;

/// Does one job after the other until the queue is closed.
pub(super) fn run(instrument: &Arc<Instrument>) {
    while let Some(job) = instrument.jobs.take() {
        let started = Instant::now();
        let answer = match job {
            Job::Solve(job) => {
                let solved = job.solve();
                // An interrupted solve is no result of its session: the session is over, or is
                // solved again when the daemon restarts.
                if job.interrupt.is_requested() {
                    continue;
                }
                let elapsed_s = started.elapsed().as_secs_f64();
                let seconds = &instrument.metrics.solve_seconds;
                seconds.with_label_values(&[&instrument.name]).observe(elapsed_s);
                Message::Solved { session: job.session, solved }
            }
            Job::Estimate(job) => {
                let estimate = job.estimate();
                Message::Estimated { session: job.session, place: job.place, estimate }
            }
        };
        if instrument.messages.blocking_send(answer).is_err() {
            return;
        }
    }
}
