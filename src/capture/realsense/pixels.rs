//! The bytes of a frame that the library owns.
#![expect(unsafe_code, reason = "the library gives a pointer and a length")]

use std::ptr;
use std::slice;
use std::sync::Arc;

use realsense_rust::frame::ImageFrame;

/// A copy of a frame's pixels. A frame that a program gave to a software device states no size: it
/// has the rows that its profile promises.
pub(super) fn pixels_of<K>(frame: &ImageFrame<K>) -> Arc<[u8]> {
    let size = match frame.get_data_size() {
        0 => frame.stride() * frame.height(),
        size => size,
    };
    // SAFETY: the library keeps `size` bytes at `get_data` as long as the frame is held, which the
    // borrow outlives; nothing writes to them by then, and they are copied before it ends.
    let bytes =
        unsafe { slice::from_raw_parts(ptr::from_ref(frame.get_data()).cast::<u8>(), size) };
    Arc::from(bytes)
}
