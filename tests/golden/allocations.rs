//! No memory is asked for per frame once a detector is warm.
#![expect(unsafe_code, reason = "an allocator that counts can be written in no other way")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use plumb::detection::board_detection::DetectOptions;
use plumb::detection::detector::Detector;
use plumb::imaging::gray::GrayImage;

use crate::detection::{Nuisance, Scene};

/// The system's allocator, counting what each thread asks for.
struct Counting;

thread_local! {
    static ASKED: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    ASKED.with(|asked| asked.set(asked.get() + 1));
}

// SAFETY: every call is passed on as it is to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How often `work` asks for memory.
fn asked(work: impl FnOnce()) -> u64 {
    let before = ASKED.get();
    work();
    ASKED.get() - before
}

/// Images with the board, with parts of it, and with none.
fn images() -> Vec<GrayImage> {
    let board = "9x6".parse().unwrap();
    let nuisances = [(false, false), (true, false), (false, true)];
    let scenes = (0..12).flat_map(|seed| {
        nuisances.map(|(occluded, cropped)| (seed, Nuisance { occluded, cropped }))
    });
    let mut images: Vec<_> =
        scenes.map(|(seed, nuisance)| Scene::new(seed, board, nuisance).image).collect();
    let stripes = (0..240 * 180).map(|i| if i % 240 / 7 % 2 == 0 { 40 } else { 200 }).collect();
    images.push(GrayImage::from_pixels(240, 180, stripes).unwrap());
    images.push(GrayImage::filled(240, 180, 99));
    images
}

fn search(detector: &mut Detector, image: &GrayImage, tracking: bool) -> bool {
    let options = DetectOptions { allow_partial: true };
    let found = if tracking {
        detector.track_board(image.view(), &options).map(|tracked| tracked.detection)
    } else {
        detector.find_board(image.view(), &options)
    };
    found.is_ok_and(|detection| {
        detector.reuse(detection);
        true
    })
}

#[test]
fn a_warm_detector_asks_for_no_memory() {
    let images = images();
    for tracking in [false, true] {
        let mut detector = Detector::new("9x6".parse().unwrap());
        let round = |detector: &mut Detector| {
            let twice = images.iter().flat_map(|image| [image, image]);
            twice.filter(|image| search(detector, image, tracking)).count()
        };
        assert!(
            asked(|| assert!(round(&mut detector) > 20)) > 0,
            "the first round fills the buffers"
        );
        assert_eq!(asked(|| assert!(round(&mut detector) > 20)), 0, "tracking: {tracking}");
    }
}
