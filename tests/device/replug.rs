//! A camera that comes and goes.

use plumb::capture::{CaptureError, SourceOpener};

use plumb::geometry::pixel::ImageSize;

use crate::guest::{
    PATIENCE, camera, footprint, frames_until_error, node_of, options, plug_in, unplug,
};

const ROUNDS: usize = 200;

/// Unplugged while it streams and plugged in again, under whatever number: found by what it is, and
/// nothing is left over.
pub fn two_hundred_rounds_leave_nothing_behind() -> String {
    let name = "vivid-001-vid-cap";
    let mut options = options(node_of(name).to_str().unwrap(), Some("GREY"));
    options.mode.size = Some(ImageSize::new(320, 180));
    let mut camera = camera(options);
    let (mut last_sequence, mut renumbered, mut node) = (0, 0, node_of(name));
    let mut round = |k: usize| {
        let mut source = camera.open().unwrap_or_else(|error| panic!("round {k}: {error}"));
        for _ in 0..2 {
            let sequence = source.next_frame(PATIENCE).unwrap().sequence;
            assert!(sequence > last_sequence || last_sequence == 0, "round {k}");
            last_sequence = sequence;
        }
        unplug();
        let (_, error) = frames_until_error(&mut *source);
        assert!(matches!(error, CaptureError::Lost { .. }), "round {k}: {error}");
        assert!(error.to_string().ends_with("it was unplugged"), "round {k}: {error}");
        let comes_back_early = k % 2 == 1;
        if comes_back_early {
            // Its number is still taken by the dead stream: it comes back under another.
            plug_in();
            renumbered += usize::from(node_of(name) != node);
        }
        drop(source);
        if !comes_back_early {
            plug_in();
        }
        node = node_of(name);
    };
    // The first rounds fill what is kept for ever: allocator arenas, the standard library's own.
    (0..20).for_each(&mut round);
    let (descriptors, threads, memory_kb) = footprint();
    (20..ROUNDS).for_each(&mut round);
    let after = footprint();
    assert_eq!((after.0, after.1), (descriptors, threads), "descriptors and threads");
    assert!(after.2 <= memory_kb + 1024, "{memory_kb} kB became {} kB", after.2);
    format!(
        "{ROUNDS} rounds: {descriptors} descriptors, {threads} threads, {memory_kb} kB before and {} kB after",
        after.2
    )
}
