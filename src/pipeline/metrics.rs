//! The daemon's metrics, in Prometheus's terms.

use prometheus::core::Collector;
use prometheus::{
    Encoder, HistogramOpts, HistogramVec, IntCounter, IntCounterVec, IntGauge, IntGaugeVec, Opts,
    Registry, TextEncoder,
};

use crate::pipeline::camera_status::CameraState;

/// Every count, by camera.
#[derive(Debug)]
pub(super) struct Metrics {
    registry: Registry,
    /// Frame sets received.
    pub(super) frames: IntCounterVec,
    /// Frame sets lost, and why: `device` (a gap in its count), `damaged`, `overload` (replaced by
    /// a newer one before it was searched), `store` (while the session was paused).
    pub(super) dropped: IntCounterVec,
    /// Frames searched for a board.
    pub(super) searched: IntCounterVec,
    /// Frames in which it was found.
    pub(super) boards: IntCounterVec,
    /// Views kept.
    pub(super) views: IntCounterVec,
    /// Frames not kept by a session, and why.
    pub(super) rejected: IntCounterVec,
    /// Sessions that ended, and how.
    pub(super) sessions: IntCounterVec,
    /// Times that a camera was opened.
    pub(super) opened: IntCounterVec,
    /// Times that a camera was lost.
    pub(super) lost: IntCounterVec,
    /// Frames drawn and encoded for clients.
    pub(super) previews: IntCounterVec,
    /// Frames that a newer one replaced before they were drawn.
    pub(super) previews_skipped: IntCounterVec,
    /// Frame sets that a rig's session observed, and whether every camera gave a frame.
    pub(super) frame_sets: IntCounterVec,
    /// Depth of kept views that is in memory, in bytes.
    pub(super) kept_depth_bytes: IntGaugeVec,
    /// Sessions that are paused because what they keep cannot be stored.
    pub(super) paused: IntGauge,
    /// Times that something could not be stored.
    pub(super) store_failures: IntCounter,
    /// Rows of the store that were found unreadable.
    pub(super) unreadable_rows: IntGauge,
    state: IntGaugeVec,
    /// Decoding and detection of one frame, in seconds.
    pub(super) detection_seconds: HistogramVec,
    /// From taking a frame from its source to announcing what was seen in it, in seconds.
    pub(super) latency_seconds: HistogramVec,
    /// A final solve, in seconds.
    pub(super) solve_seconds: HistogramVec,
}

const FRAME_SECONDS: [f64; 12] =
    [0.0005, 0.001, 0.002, 0.003, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.3, 1.0];
const SOLVE_SECONDS: [f64; 9] = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0];

/// Metrics as they are made: each is registered.
struct NewMetrics {
    registry: Registry,
}

impl NewMetrics {
    fn counters(
        &self,
        name: &str,
        help: &str,
        labels: &[&str],
    ) -> Result<IntCounterVec, prometheus::Error> {
        self.register(IntCounterVec::new(Opts::new(name, help), labels)?)
    }

    fn gauges(
        &self,
        name: &str,
        help: &str,
        labels: &[&str],
    ) -> Result<IntGaugeVec, prometheus::Error> {
        self.register(IntGaugeVec::new(Opts::new(name, help), labels)?)
    }

    /// By camera.
    fn histograms(
        &self,
        name: &str,
        help: &str,
        buckets: &[f64],
    ) -> Result<HistogramVec, prometheus::Error> {
        let options = HistogramOpts::new(name, help).buckets(buckets.to_vec());
        self.register(HistogramVec::new(options, &["camera"])?)
    }

    fn register<M: Collector + Clone + 'static>(&self, metric: M) -> Result<M, prometheus::Error> {
        self.registry.register(Box::new(metric.clone()))?;
        Ok(metric)
    }
}

impl Metrics {
    pub(super) fn new() -> Result<Self, prometheus::Error> {
        let new = NewMetrics { registry: Registry::new() };
        Ok(Self {
            frames: new.counters("plumb_frames_total", "frame sets received", &["camera"])?,
            dropped: new.counters(
                "plumb_frames_dropped_total",
                "lost frame sets, by reason",
                &["camera", "why"],
            )?,
            searched: new.counters(
                "plumb_frames_searched_total",
                "frames searched for a board",
                &["camera"],
            )?,
            boards: new.counters(
                "plumb_boards_found_total",
                "frames in which the board was found",
                &["camera"],
            )?,
            views: new.counters("plumb_views_kept_total", "views kept by sessions", &["camera"])?,
            rejected: new.counters(
                "plumb_frames_rejected_total",
                "frames not kept by a session",
                &["camera", "reason"],
            )?,
            sessions: new.counters(
                "plumb_sessions_ended_total",
                "ended sessions, by outcome",
                &["camera", "state"],
            )?,
            opened: new.counters(
                "plumb_camera_opened_total",
                "times that the camera was opened",
                &["camera"],
            )?,
            lost: new.counters(
                "plumb_camera_lost_total",
                "times that the camera was lost",
                &["camera"],
            )?,
            frame_sets: new.counters(
                "plumb_rig_frame_sets_total",
                "frame sets of a rig's session, and whether every camera gave a frame",
                &["rig", "complete"],
            )?,
            kept_depth_bytes: new.gauges(
                "plumb_kept_depth_bytes",
                "bytes of depth images of kept views in memory",
                &["camera"],
            )?,
            paused: new.register(IntGauge::new(
                "plumb_sessions_paused",
                "sessions paused because the store cannot be written",
            )?)?,
            store_failures: new.register(IntCounter::new(
                "plumb_store_failures_total",
                "failed writes to the store",
            )?)?,
            unreadable_rows: new.register(IntGauge::new(
                "plumb_store_unreadable_rows",
                "rows of the store that were found unreadable since the start",
            )?)?,
            previews: new.counters(
                "plumb_previews_drawn_total",
                "frames drawn and encoded for all who watch them",
                &["camera"],
            )?,
            previews_skipped: new.counters(
                "plumb_previews_skipped_total",
                "watched frames that a newer one replaced before they were drawn",
                &["camera"],
            )?,
            state: new.gauges(
                "plumb_camera_state",
                "1 for the current state of the camera, else 0",
                &["camera", "state"],
            )?,
            detection_seconds: new.histograms(
                "plumb_detection_seconds",
                "decoding and detection of a frame",
                &FRAME_SECONDS,
            )?,
            latency_seconds: new.histograms(
                "plumb_frame_latency_seconds",
                "latency from a frame's arrival to its detection result",
                &FRAME_SECONDS,
            )?,
            solve_seconds: new.histograms("plumb_solve_seconds", "final solves", &SOLVE_SECONDS)?,
            registry: new.registry,
        })
    }

    /// Makes a camera's metrics appear before they first change.
    pub(super) fn introduce(&self, camera: &str) {
        for counter in [
            &self.frames,
            &self.searched,
            &self.boards,
            &self.views,
            &self.opened,
            &self.lost,
            &self.previews,
            &self.previews_skipped,
        ] {
            counter.with_label_values(&[camera]);
        }
        for why in ["device", "damaged", "overload", "store", "fault"] {
            self.dropped.with_label_values(&[camera, why]);
        }
        self.set_state(camera, CameraState::Starting);
    }

    pub(super) fn set_state(&self, camera: &str, state: CameraState) {
        for other in CameraState::ALL {
            self.state.with_label_values(&[camera, other.name()]).set(i64::from(other == state));
        }
    }

    /// In the text format, version 0.0.4.
    pub(super) fn text(&self) -> String {
        let mut text = Vec::new();
        // Writing to memory cannot fail, and even an incomplete text is worth showing.
        let _ = TextEncoder::new().encode(&self.registry.gather(), &mut text);
        String::from_utf8_lossy(&text).into_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_shows_from_the_start_and_in_one_state() {
        let metrics = Metrics::new().unwrap();
        metrics.introduce("front");
        metrics.set_state("front", CameraState::Streaming);
        let text = metrics.text();
        assert!(text.contains("plumb_frames_total{camera=\"front\"} 0"), "{text}");
        assert!(
            text.contains("plumb_frames_dropped_total{camera=\"front\",why=\"overload\"} 0"),
            "{text}"
        );
        assert!(
            text.contains("plumb_camera_state{camera=\"front\",state=\"starting\"} 0"),
            "{text}"
        );
        assert!(
            text.contains("plumb_camera_state{camera=\"front\",state=\"streaming\"} 1"),
            "{text}"
        );
    }
}
