//! Tests of sessions without a board: seeded points with descriptors of their own, seen from known
//! poses.

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::key_frames::MOST_KEY_FRAMES;
use crate::calibration::session_record::{Finish, SessionRequest};
use crate::calibration::target::CalibrationTarget;
use crate::estimation::problem::LensChoice;
use crate::features::descriptor::{Descriptor, LENGTH};
use crate::features::detector::Features;
use crate::features::keypoint::Keypoint;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

const SIZE: ImageSize = ImageSize::new(640, 480);
const NOISE_PX: f64 = 0.3;
/// The distance to the middle of the scene.
const DISTANCE: f64 = 5.0;

struct SeededScene {
    points: Vec<(Point3<f64>, Descriptor)>,
    random: ChaCha8Rng,
}

impl SeededScene {
    fn of(seed: u64, count: usize) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let points = (0..count).map(|_| {
            let mut uniform = |reach: f64| random.random_range(-reach..reach);
            let point = Point3::new(uniform(5.0), uniform(4.0), DISTANCE + uniform(2.0));
            // Few entries are not 0, so that two descriptors have next to nothing in common.
            let mut numbers = [0; LENGTH];
            (0..8).for_each(|_| numbers[random.random_range(0..LENGTH)] = 181);
            (point, Descriptor(numbers))
        });
        let points = points.collect();
        Self { points, random: ChaCha8Rng::seed_from_u64(seed + 1000) }
    }

    /// From `center`, rotated about its own axis by `roll`.
    fn image(&mut self, center: [f64; 3], roll: f64) -> SceneImage {
        let lens = Lens::from_parameters(LensModel::Pinhole, &[500.0, 500.0, 322.0, 236.0, 0.0]);
        let lens = lens.unwrap();
        let rotation = Pose::from_axis_angle(Vector3::new(0.0, 0.0, roll), Vector3::zeros());
        let camera_from_scene =
            Pose::new(rotation.rotation(), -(rotation.rotation() * Vector3::from(center)));
        let mut features = Features::default();
        for (point, descriptor) in &self.points {
            let Some(pixel) = lens.pixel_from_point(&(camera_from_scene * *point)) else {
                continue;
            };
            let mut noise = || NOISE_PX * self.random.random_range(-1.7..1.7);
            let pixel = Pixel::new(pixel.x + noise(), pixel.y + noise());
            if SIZE.contains(pixel) {
                let keypoint = Keypoint { pixel, scale_px: 2.0, angle: 0.0, contrast: 0.1 };
                features.keypoints.push(keypoint);
                features.descriptors.push(*descriptor);
            }
        }
        SceneImage::of_features("", SIZE, features)
    }
}

/// An object as slim as a statue in front of a long lens: `count` points on an upright cylinder,
/// each with the angle over which it is still recognized.
struct Statue {
    points: Vec<(f64, f64, f64, Descriptor)>,
    random: ChaCha8Rng,
}

impl Statue {
    fn of(seed: u64, count: usize) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let points = (0..count).map(|_| {
            let mut between = |low: f64, high: f64| random.random_range(low..high);
            let (around, height) = (between(0.0, std::f64::consts::TAU), between(-0.7, 0.7));
            let recognized = between(15.0, 40.0).to_radians();
            let mut numbers = [0; LENGTH];
            (0..8).for_each(|_| numbers[random.random_range(0..LENGTH)] = 181);
            (around, height, recognized, Descriptor(numbers))
        });
        let points = points.collect();
        Self { points, random: ChaCha8Rng::seed_from_u64(seed + 1000) }
    }

    /// An image from a distance, after a motion of `angle` around the object. A feature has another
    /// descriptor if it faces the camera at too different an angle.
    fn image(&mut self, angle: f64) -> SceneImage {
        const RADIUS: f64 = 0.2;
        let lens = Lens::from_parameters(LensModel::Pinhole, &[1500.0, 1500.0, 322.0, 236.0, 0.0]);
        let (lens, mut features) = (lens.unwrap(), Features::default());
        for (around, height, recognized, descriptor) in &self.points {
            let from_camera = around - angle;
            if from_camera.cos() < 0.3 {
                continue;
            }
            let (x, z) = (RADIUS * from_camera.sin(), DISTANCE - RADIUS * from_camera.cos());
            let Some(pixel) = lens.pixel_from_point(&Point3::new(x, *height, z)) else { continue };
            let mut noise = || NOISE_PX * self.random.random_range(-1.7..1.7);
            let pixel = Pixel::new(pixel.x + noise(), pixel.y + noise());
            // The descriptor changes in steps, for each point at angles of its own.
            let steps = ((angle + around * 9.0) / recognized).floor() as usize;
            let mut descriptor = *descriptor;
            descriptor.0.rotate_right(steps * 5 % LENGTH);
            let keypoint = Keypoint { pixel, scale_px: 2.0, angle: 0.0, contrast: 0.1 };
            features.keypoints.push(keypoint);
            features.descriptors.push(descriptor);
        }
        SceneImage::of_features("", SIZE, features)
    }
}

struct Walk {
    session: Session,
    frames: u64,
}

impl Walk {
    fn begin(finish: Option<Finish>) -> Self {
        let (target, lens) = (CalibrationTarget::Scene, LensChoice::Model(LensModel::Pinhole));
        let request = SessionRequest { target, lens, finish, given: Vec::new() };
        let record = SessionRecord::begin("s", "front", request, 0);
        Self { session: Session::begin(record, &[], &AdmissionOptions::default()), frames: 0 }
    }

    fn frame(&mut self) -> FrameFacts {
        self.frames += 1;
        FrameFacts {
            sequence: self.frames,
            name: None,
            host_time_ns: self.frames as i64 * 100_000_000,
            device_time_ns: None,
            image_size: SIZE,
        }
    }

    fn show(&mut self, image: SceneImage) -> Result<u32, &'static str> {
        let frame = self.frame();
        let seen = Ok(FrameContent::Scene(image));
        let observed =
            self.session.observe(&[Some(CameraFrame { frame, seen, depth: None })]).unwrap();
        observed.admissions[0].clone().unwrap().map_err(|rejection| rejection.kind())
    }

    fn message(&self) -> &str {
        &self.session.record().guidance.message
    }
}

#[test]
fn key_frames_are_kept_from_elsewhere_only() {
    for seed in 0..4 {
        let (mut scene, mut walk) = (SeededScene::of(seed, 700), Walk::begin(None));
        assert_eq!(walk.show(scene.image([0.0; 3], 0.0)), Ok(0));
        assert_eq!(walk.show(scene.image([0.0; 3], 0.0)), Err("too_similar"), "stood still");
        let step = |part: f64| [part * DISTANCE, 0.0, 0.0];
        assert_eq!(walk.show(scene.image(step(0.01), 0.0)), Err("too_similar"));
        assert_eq!(walk.show(scene.image(step(0.12), 0.0)), Ok(1));
        assert_eq!(walk.show(scene.image(step(0.24), 0.0)), Ok(2));
        assert_eq!(walk.show(scene.image(step(0.005), 0.0)), Err("too_similar"), "back again");
        assert_eq!(walk.show(scene.image(step(0.24), 0.8)), Ok(3), "rotated about its axis");
        assert_eq!(
            walk.show(SeededScene::of(seed + 50, 700).image([0.0; 3], 0.0)),
            Err("unknown_scene")
        );
        assert_eq!(walk.show(SeededScene::of(seed, 40).image([0.0; 3], 0.0)), Err("no_texture"));
        let record = walk.session.record();
        assert_eq!((record.frames_seen, record.boards_seen, record.views_kept), (9, 7, 4));
        assert_eq!(record.rejected.of("too_similar"), 3);
        assert!(record.coverage.fraction() > 0.9, "{:?}", record.coverage);
    }
}

#[test]
fn key_frames_around_a_thing_are_kept_before_it_is_lost() {
    for (seed, step_deg) in [(0, 8.0), (1, 8.0), (2, 4.0), (3, 12.0)] {
        let (mut statue, mut walk) = (Statue::of(seed, 1500), Walk::begin(None));
        let images = (96.0 / step_deg) as u32;
        for k in 0..=images {
            let _ = walk.show(statue.image((step_deg * f64::from(k)).to_radians()));
        }
        let record = walk.session.record();
        assert_eq!(record.rejected.of("unknown_scene"), 0, "{step_deg}");
        assert!((4..=images).contains(&record.views_kept), "{step_deg}: {}", record.views_kept);
    }
}

#[test]
fn a_session_begins_anew_where_its_first_image_was_of_something_else() {
    let (mut scene, mut walk) = (SeededScene::of(5, 900), Walk::begin(None));
    assert_eq!(walk.show(SeededScene::of(50, 700).image([0.0; 3], 0.0)), Ok(0));
    for k in 0..8 {
        let kept = walk.show(scene.image([0.6 * f64::from(k) - 2.0, 0.0, 0.0], 0.0));
        assert_eq!(kept, if k < 4 { Err("unknown_scene") } else { Ok(k - 3) });
    }
    let record = walk.session.record();
    assert_eq!((record.frames_seen, record.views_kept), (9, 5));
}

#[test]
fn what_is_in_the_way_is_said_and_then_what_to_do_next() {
    let (mut scene, mut walk) = (SeededScene::of(7, 700), Walk::begin(None));
    assert_eq!(walk.show(scene.image([0.0; 3], 0.0)), Ok(0));
    assert!(walk.message().contains("step sideways"), "{}", walk.message());
    for _ in 0..4 {
        let _ = walk.show(SeededScene::of(7, 30).image([0.0; 3], 0.0));
    }
    assert!(walk.message().contains("texture"), "{}", walk.message());
    for _ in 0..4 {
        let _ = walk.show(SeededScene::of(8, 700).image([0.0; 3], 0.0));
    }
    assert!(walk.message().contains("smaller steps"), "{}", walk.message());
    assert_eq!(walk.show(scene.image([0.6, 0.0, 0.0], 0.0)), Ok(1));
    assert!(walk.message().contains("step sideways"), "{}", walk.message());
}

#[test]
fn a_camera_that_stands_still_has_too_few_views_and_the_reason() {
    let (mut scene, mut walk) = (SeededScene::of(3, 400), Walk::begin(None));
    for _ in 0..20 {
        let _ = walk.show(scene.image([0.0; 3], 0.0));
    }
    walk.session.stop(0).unwrap();
    let record = walk.session.record();
    assert_eq!(record.state, SessionState::Failed);
    let reason = record.reason.as_deref().unwrap();
    assert!(
        reason.starts_with("key frames kept: 1; ") && reason.contains("stood still"),
        "{reason}"
    );
}

#[test]
fn what_did_not_match_is_not_said_to_have_stood_still() {
    let reason = |images: Vec<SceneImage>| {
        let mut walk = Walk::begin(None);
        for image in images {
            let _ = walk.show(image);
        }
        walk.session.stop(0).unwrap();
        walk.session.record().reason.clone().unwrap()
    };
    let mut scene = SeededScene::of(3, 700);
    let mut near = |count: u32| -> Vec<SceneImage> {
        (0..count).map(|k| scene.image([0.004 * f64::from(k) * DISTANCE, 0.0, 0.0], 0.0)).collect()
    };
    let others = |count: u64| (0..count).map(|k| SeededScene::of(50 + k, 700).image([0.0; 3], 0.0));
    let moved = reason(near(12));
    assert!(moved.contains("the camera moved too little"), "{moved}");
    let lost = reason(near(1).into_iter().chain(others(5)).collect());
    assert!(lost.contains("no inlier matches (median 0)"), "{lost}");
    let both = reason(near(6).into_iter().chain(others(4)).collect());
    assert!(both.contains("5 images are too similar to the key frames, 4 share nothing"), "{both}");
    for reason in [moved, lost, both] {
        assert!(!reason.contains("stood still"), "{reason}");
    }
}

#[test]
fn images_that_change_size_are_the_reason() {
    let (mut scene, mut walk) = (SeededScene::of(3, 700), Walk::begin(None));
    assert_eq!(walk.show(scene.image([0.0; 3], 0.0)), Ok(0));
    let mut other = scene.image([0.6, 0.0, 0.0], 0.0);
    other.size = ImageSize::new(1280, 960);
    assert_eq!(walk.show(other), Err("other_image_size"));
    walk.session.stop(0).unwrap();
    let reason = walk.session.record().reason.clone().unwrap();
    assert!(reason.ends_with("keep the camera at one size and start again"), "{reason}");
}

#[test]
fn key_frames_among_images_that_share_nothing_are_not_solved() {
    let unconnected = |unknown: u64| {
        let finish = Finish { min_views: Some(5), ..Finish::default() };
        let (mut scene, mut walk) = (SeededScene::of(5, 900), Walk::begin(Some(finish)));
        for k in 0..4 {
            assert_eq!(walk.show(scene.image([0.6 * f64::from(k), 0.0, 0.0], 0.0)), Ok(k));
        }
        for k in 0..unknown {
            let other = SeededScene::of(50 + k, 700).image([0.0; 3], 0.0);
            assert_eq!(walk.show(other), Err("unknown_scene"));
        }
        (scene, walk)
    };
    let (_, mut walk) = unconnected(4);
    assert_eq!(walk.session.stop(0).unwrap(), [Action::Announce, Action::Solve]);
    let (_, mut walk) = unconnected(5);
    assert_eq!(walk.session.stop(0).unwrap(), [Action::Close]);
    let reason = walk.session.record().reason.clone().unwrap();
    assert!(reason.starts_with("5 of 9 images") && reason.contains("smaller"), "{reason}");
    // The goal is reached once most images share something.
    let (mut scene, mut walk) = unconnected(6);
    assert_eq!(walk.show(scene.image([2.4, 0.0, 0.0], 0.0)), Ok(4));
    assert_eq!(walk.session.record().state, SessionState::Collecting);
    assert_eq!(walk.show(scene.image([2.4, 0.0, 0.0], 0.0)), Err("too_similar"));
    assert_eq!(walk.session.record().state, SessionState::Solving);
}

#[test]
fn it_holds_so_many_key_frames_ends_by_itself_and_comes_back_over_a_restart() {
    let mut scene = SeededScene::of(5, 900);
    let places = |k: u32| {
        let (row, column) = (f64::from(k / 7), f64::from(k % 7));
        [0.6 * column - 1.8, 0.6 * row - 1.2, 0.0]
    };
    let images: Vec<SceneImage> =
        (0..MOST_KEY_FRAMES as u32 + 5).map(|k| scene.image(places(k), 0.0)).collect();
    let mut walk = Walk::begin(None);
    for (k, image) in images.iter().enumerate() {
        let expected = if k < MOST_KEY_FRAMES { Ok(k as u32) } else { Err("full") };
        assert_eq!(walk.show(image.clone()), expected, "{k}");
    }
    let session = &walk.session;
    let stored: Vec<_> = (session.kept().iter())
        .map(|kept| (*kept, session.key_frame(kept).unwrap()))
        .map(|(kept, key)| (kept, key.frame.clone(), key.image.clone()))
        .collect();
    let record = session.record().clone();
    let (resumed, actions) = Session::resume_scene(record, &stored, &AdmissionOptions::default());
    assert_eq!(actions, [Action::Announce, Action::Estimate(0)]);
    assert_eq!((resumed.kept(), resumed.record().views_kept), (session.kept(), 30));
    assert_eq!(resumed.record().coverage, session.record().coverage);

    let finish = Finish { min_views: Some(5), ..Finish::default() };
    let mut walk = Walk::begin(Some(finish));
    for image in &images[..5] {
        assert!(walk.show(image.clone()).is_ok());
    }
    assert_eq!(walk.session.record().state, SessionState::Solving);
}
