//! Tests of sessions on cameras and rigs that are exchanged while others run.

use std::sync::Arc;
use std::thread;

use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::capture::{FrameSource, Pace, Simulated, SimulatedClock};
use crate::geometry::pixel::ImageSize;
use crate::pipeline::fleet::Fleet;
use crate::pipeline::instrument::RigPlan;
use crate::pipeline::running::{CameraPlan, Exchange, FleetOptions};
use crate::pipeline::scripted::*;
use crate::pipeline::session_request::EndError;
use crate::simulation::WorldOptions;
use crate::store::Store;

/// Camera `name` of a simulated rig; `lens` names its lens.
fn seated(name: &str, seat: u32, lens: &str) -> CameraPlan {
    let open = move || {
        let options = WorldOptions::on_rig(3, ImageSize::new(320, 240), seat);
        let source = Simulated::new(&options, Pace::Fastest, SimulatedClock::Own);
        Ok(Box::new(source) as Box<dyn FrameSource>)
    };
    CameraPlan {
        name: name.to_owned(),
        kind: "simulator".to_owned(),
        image_source: lens.to_owned(),
        open: Box::new(open),
        may_stall: false,
    }
}

fn fleet_with(folder: &tempfile::TempDir, plans: Vec<CameraPlan>) -> (Fleet, Arc<Store>) {
    let store = Arc::new(released(folder));
    (Fleet::start(plans, Arc::clone(&store), &FleetOptions::default()).unwrap(), store)
}

fn head() -> RigPlan {
    RigPlan { name: "head".to_owned(), cameras: vec!["left".to_owned(), "right".to_owned()] }
}

/// Asserts that the views which `record` kept are stored, and that it states why it was aborted.
fn assert_given_up(store: &Store, record: &SessionRecord, reason: &str) {
    assert_eq!(record.state, SessionState::Aborted);
    assert_eq!(record.reason.as_deref(), Some(reason));
    assert!(record.finished_at_ns.is_some() && record.views_kept >= 1);
    let sets = store.sensor_views(&record.id).unwrap();
    let mut sets: Vec<u32> = sets.iter().map(|view| view.frame_set).collect();
    sets.sort_unstable();
    sets.dedup();
    assert_eq!(record.views_kept as usize, sets.len());
    let stored = store.session(&record.id).unwrap().unwrap();
    assert_eq!((stored.state, &stored.reason), (record.state, &record.reason));
    assert_eq!(store.unfinished_sessions().unwrap(), []);
}

#[tokio::test]
async fn a_session_does_not_go_on_with_another_lens() {
    let folder = tempfile::tempdir().unwrap();
    let (fleet, store) = fleet_with(&folder, vec![seated("front", 0, "one")]);
    let mut events = fleet.events(Some(0));
    let id = fleet.start_session("front", request()).await.unwrap().id;
    until_session(&mut events, |record| record.views_kept >= 1).await;
    let to = |lens: &str| Exchange {
        stopped_cameras: vec!["front".to_owned()],
        cameras: vec![seated("front", 1, lens)],
        ..Exchange::default()
    };
    fleet.exchange(to("one")).unwrap();
    assert_eq!(fleet.live_session(&id).unwrap().state, SessionState::Collecting);

    fleet.exchange(to("two")).unwrap();
    let given_up = until_session(&mut events, |record| record.state.is_over()).await;
    assert_eq!(given_up.id, id);
    let reason = "the source of camera `front` changed from one to two, and a session never mixes views of both; its views are kept: start a new session";
    assert_given_up(&store, &given_up, reason);
    assert_eq!(*fleet.live_session(&id).unwrap(), given_up);
    let next = fleet.start_session("front", request()).await.unwrap();
    assert_eq!(next.sources["front"], "two");
    assert_eq!(fleet.camera("front").unwrap().session, Some(next.id));
}

#[tokio::test]
async fn a_restart_with_another_lens_gives_the_session_up_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let (fleet, store) = fleet_with(&folder, vec![seated("front", 0, "one")]);
    let id = fleet.start_session("front", request()).await.unwrap().id;
    until_session(&mut fleet.events(Some(0)), |record| record.views_kept >= 1).await;
    fleet
        .exchange(Exchange { stopped_cameras: vec!["front".to_owned()], ..Exchange::default() })
        .unwrap();
    drop((fleet, store));
    let (fleet, store) = fleet_with(&folder, vec![seated("front", 1, "two")]);
    let record = until_session(&mut fleet.events(Some(0)), |record| record.state.is_over()).await;
    assert_eq!(record.id, id);
    assert_given_up(&store, &record, &record.reason.clone().unwrap());
    assert!(
        record.reason.unwrap().starts_with("the source of camera `front` changed from one to two")
    );
}

#[tokio::test]
async fn a_paused_session_is_given_up_once_that_can_be_stored() {
    let folder = tempfile::tempdir().unwrap();
    let (fleet, store) = fleet_with(&folder, vec![seated("front", 0, "one")]);
    let mut events = fleet.events(Some(0));
    let id = fleet.start_session("front", request()).await.unwrap().id;
    until_session(&mut events, |record| record.views_kept >= 1).await;
    store.limit_growth(Some(2));
    until_session(&mut events, |record| record.reason.is_some()).await;
    let stopped_cameras = vec!["front".to_owned()];
    let cameras = vec![seated("front", 1, "two")];
    fleet.exchange(Exchange { stopped_cameras, cameras, ..Exchange::default() }).unwrap();
    store.limit_growth(None);
    let record = until_session(&mut events, |record| record.state.is_over()).await;
    assert_eq!(record.id, id);
    assert_given_up(&store, &record, &record.reason.clone().unwrap());
    assert!(fleet.paused().is_empty());
}

#[tokio::test]
async fn a_rig_does_not_go_on_with_another_lens_in_one_of_its_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let plans = vec![seated("left", 0, "a"), seated("right", 1, "b")];
    let (fleet, store) = fleet_with(&folder, plans);
    fleet.exchange(Exchange { rigs: vec![head()], ..Exchange::default() }).unwrap();
    let mut events = fleet.events(Some(0));
    let id = fleet.start_rig_session("head", request()).await.unwrap().id;
    let kept = until_session(&mut events, |record| record.views_kept >= 1).await;
    let stopped_rigs = vec!["head".to_owned()];
    let stopped_cameras = vec!["right".to_owned()];
    let (cameras, rigs) = (vec![seated("right", 2, "c")], vec![head()]);
    fleet.exchange(Exchange { stopped_rigs, stopped_cameras, cameras, rigs }).unwrap();
    let record = until_session(&mut events, |record| record.state.is_over()).await;
    assert_eq!((&record.id, record.members.len()), (&id, kept.members.len()));
    let reason = "the source of camera `right` changed from b to c, and a session never mixes views of both; its views are kept: start a new session";
    assert_given_up(&store, &record, reason);
    assert_eq!(fleet.camera("left").unwrap().session, None);
    let next = fleet.start_rig_session("head", request()).await.unwrap();
    assert_eq!(next.sources.values().collect::<Vec<_>>(), ["a", "c"]);
}

/// A rig that is being exchanged is not listed for a moment, while its old thread still stores the
/// session's counts: the session must not be aborted by others then.
#[tokio::test]
async fn a_session_is_not_given_up_while_its_rig_is_exchanged() {
    let folder = tempfile::tempdir().unwrap();
    let (plans, scripts): (Vec<_>, Vec<_>) =
        ["left", "right"].iter().map(|name| scripted(name)).unzip();
    let fleet = Arc::new(fleet_of(plans, &folder, PATIENCE));
    fleet.exchange(Exchange { rigs: vec![head()], ..Exchange::default() }).unwrap();
    let id = fleet.start_rig_session("head", request()).await.unwrap().id;
    // The thread cannot end before this lock is released.
    let left = fleet.link("left").unwrap();
    let guidance = left.guidance.lock().unwrap();
    let exchanging = Arc::clone(&fleet);
    let exchange = thread::spawn(move || {
        let (stopped_rigs, rigs) = (vec!["head".to_owned()], vec![head()]);
        exchanging.exchange(Exchange { stopped_rigs, rigs, ..Exchange::default() })
    });
    while fleet.rig("head").is_ok() {
        thread::yield_now();
    }
    assert!(fleet.exchange.try_lock().is_err(), "whoever gives up a session waits");
    let (aborting, asked) = (Arc::clone(&fleet), id.clone());
    let aborted = thread::spawn(move || aborting.abort_stored(&asked));
    drop(guidance);
    exchange.join().unwrap().unwrap();
    let (refused, state) = (aborted.join().unwrap().unwrap_err(), SessionState::Collecting);
    assert_eq!(refused, EndError::Over { id: id.clone(), state });
    assert_eq!(fleet.store().session(&id).unwrap().unwrap().state, state);
    assert_eq!(fleet.live_session(&id).unwrap().state, state);
    assert_eq!(fleet.abort_session(&id).await.unwrap().state, SessionState::Aborted);
    drop(scripts);
}

/// An unfinished session that is older than the one its camera resumed belongs to no camera.
#[tokio::test]
async fn an_older_unfinished_session_can_be_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![scripted("front").0], &folder, PATIENCE);
    let live = fleet.start_session("front", request()).await.unwrap();
    let older = SessionRecord { id: "0".to_owned(), started_at_ns: 0, ..live.clone() };
    fleet.store().begin_session(&older).unwrap();
    let refused = fleet.abort_stored(&live.id).unwrap_err();
    assert_eq!(refused, EndError::Over { id: live.id.clone(), state: SessionState::Collecting });
    assert_eq!(fleet.abort_stored("0").unwrap().state, SessionState::Aborted);
    assert_eq!(fleet.abort_session(&live.id).await.unwrap().state, SessionState::Aborted);
}
