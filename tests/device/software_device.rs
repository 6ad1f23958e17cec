//! The library's software device, fed with frames: recorded by the library's own recorder, or live
//! in a context of the library's.
//!
//! The functions are those of `rs_internal.h`, `rs_record_playback.h` and their like; realsense-sys
//! has no bindings of the first.
#![allow(unsafe_code, reason = "the library's C interface")]

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::Path;
use std::ptr::{from_ref, null_mut};
use std::sync::atomic::{AtomicPtr, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use realsense_rust::context::Context;
use realsense_rust::kind::Rs2Option;

/// One of the library's objects.
type Handle = *mut c_void;

/// Which of a device's streams, in the library's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    Depth,
    Infrared,
    /// The right one.
    Infrared2,
    Color,
}

/// In the order of [`Images`].
const STREAMS: [Stream; 4] = [Stream::Depth, Stream::Infrared, Stream::Infrared2, Stream::Color];

/// Intrinsics and distortion of a stream, as the device states them.
#[derive(Debug, Clone, Copy)]
pub struct StatedCamera {
    pub focal_px: [f32; 2],
    pub principal_px: [f32; 2],
    /// Brown–Conrady: k1, k2, p1, p2, k3.
    pub coefficients: [f32; 5],
}

/// The device that is made.
#[derive(Debug, Clone)]
pub struct Device {
    pub serial: &'static str,
    pub size: [u32; 2],
    pub fps: u32,
    pub depth_unit_m: f32,
    /// Of depth and both infrared ones, then of color.
    pub cameras: [StatedCamera; 2],
    /// Column by column, and meters.
    pub color_from_depth: ([f32; 9], [f32; 3]),
    /// From the left infrared sensor to the right one, in meters.
    pub baseline_m: f32,
    /// Options of the depth sensor that can be set, with what they stand at.
    pub options: Vec<(Rs2Option, f32)>,
}

/// Frames taken together: depth (16 bit), left and right infrared (8 bit), color (RGB).
pub type SensorImages = [(Stream, Vec<u8>); 4];

#[repr(C)]
#[derive(Clone, Copy)]
struct Intrinsics {
    size: [c_int; 2],
    principal: [f32; 2],
    focal: [f32; 2],
    model: c_int,
    coefficients: [f32; 5],
}

#[repr(C)]
#[derive(Clone, Copy)]
struct VideoStream {
    stream: c_int,
    index: c_int,
    unique: c_int,
    size: [c_int; 2],
    fps: c_int,
    bytes_per_pixel: c_int,
    format: c_int,
    intrinsics: Intrinsics,
}

#[repr(C)]
struct VideoFrame {
    pixels: *mut c_void,
    deleter: extern "C" fn(*mut c_void),
    stride: c_int,
    bytes_per_pixel: c_int,
    timestamp_ms: f64,
    clock: c_int,
    number: c_int,
    profile: Handle,
    depth_unit_m: f32,
}

#[repr(C)]
struct Extrinsics {
    rotation: [f32; 9],
    translation: [f32; 3],
}

const BROWN_CONRADY: c_int = 4;
const HARDWARE_CLOCK: c_int = 0;
const INFO_NAME: c_int = 0;
const INFO_SERIAL: c_int = 1;
const INFO_FIRMWARE: c_int = 2;
const INFO_PRODUCT_LINE: c_int = 10;
const OPTION_DEPTH_UNITS: c_int = 28;
const MATCHER_DEPTH_LEFT_RIGHT_COLOR: c_int = 2;

unsafe extern "C" {
    fn malloc(bytes: usize) -> *mut c_void;
    fn free(memory: *mut c_void);
    fn rs2_get_error_message(error: Handle) -> *const c_char;
    fn rs2_create_software_device(error: *mut Handle) -> Handle;
    fn rs2_software_device_register_info(
        device: Handle,
        info: c_int,
        text: *const c_char,
        error: *mut Handle,
    );
    fn rs2_software_device_add_sensor(
        device: Handle,
        name: *const c_char,
        error: *mut Handle,
    ) -> Handle;
    fn rs2_software_device_create_matcher(device: Handle, matcher: c_int, error: *mut Handle);
    fn rs2_software_sensor_add_video_stream_ex(
        s: Handle,
        v: VideoStream,
        d: c_int,
        error: *mut Handle,
    ) -> Handle;
    fn rs2_software_sensor_add_read_only_option(
        sensor: Handle,
        option: c_int,
        value: f32,
        error: *mut Handle,
    );
    fn rs2_software_sensor_add_option(
        sensor: Handle,
        option: c_int,
        least: f32,
        most: f32,
        step: f32,
        default: f32,
        is_writable: c_int,
        error: *mut Handle,
    );
    fn rs2_get_option(sensor: Handle, option: c_int, error: *mut Handle) -> f32;
    fn rs2_context_add_software_device(context: Handle, device: Handle, error: *mut Handle);
    fn rs2_set_devices_changed_callback(
        context: Handle,
        callback: extern "C" fn(Handle, Handle, *mut c_void),
        user: *mut c_void,
        error: *mut Handle,
    );
    fn rs2_delete_device_list(devices: Handle);
    fn rs2_software_sensor_on_video_frame(sensor: Handle, frame: VideoFrame, error: *mut Handle);
    fn rs2_register_extrinsics(
        from: Handle,
        to: Handle,
        extrinsics: Extrinsics,
        error: *mut Handle,
    );
    fn rs2_create_record_device_ex(
        device: Handle,
        file: *const c_char,
        compress: c_int,
        e: *mut Handle,
    ) -> Handle;
    fn rs2_query_sensors(device: Handle, error: *mut Handle) -> Handle;
    fn rs2_get_sensors_count(sensors: Handle, error: *mut Handle) -> c_int;
    fn rs2_create_sensor(sensors: Handle, index: c_int, error: *mut Handle) -> Handle;
    fn rs2_get_stream_profiles(sensor: Handle, error: *mut Handle) -> Handle;
    fn rs2_get_stream_profiles_count(profiles: Handle, error: *mut Handle) -> c_int;
    fn rs2_get_stream_profile(profiles: Handle, index: c_int, error: *mut Handle) -> Handle;
    fn rs2_open_multiple(sensor: Handle, profiles: *mut Handle, count: c_int, error: *mut Handle);
    fn rs2_create_frame_queue(capacity: c_int, error: *mut Handle) -> Handle;
    fn rs2_start_queue(sensor: Handle, queue: Handle, error: *mut Handle);
    fn rs2_stop(sensor: Handle, error: *mut Handle);
    fn rs2_close(sensor: Handle, error: *mut Handle);
    fn rs2_delete_stream_profiles_list(profiles: Handle);
    fn rs2_delete_sensor(sensor: Handle);
    fn rs2_delete_sensor_list(sensors: Handle);
    fn rs2_delete_frame_queue(queue: Handle);
    fn rs2_delete_device(device: Handle);
}

extern "C" fn release(pixels: *mut c_void) {
    // SAFETY: `pixels` came from `malloc`, and the library gives it back once.
    unsafe { free(pixels) }
}

/// Calls the library; a refusal ends the test with the library's words.
macro_rules! call {
    ($function:ident ( $($argument:expr),* )) => {{
        let mut error: Handle = null_mut();
        // SAFETY: the arguments are as the library's header asks for them, and live as long as the
        // call.
        let answer = unsafe { $function($($argument,)* &mut error) };
        if !error.is_null() {
            // SAFETY: the library made the error with its message, and it is still there.
            let words = unsafe { CStr::from_ptr(rs2_get_error_message(error)) };
            panic!("{}: {}", stringify!($function), words.to_string_lossy());
        }
        answer
    }};
}

/// A device with what is fed to it.
struct SoftwareDevice {
    device: Handle,
    depth_sensor: Handle,
    color_sensor: Handle,
    /// Of [`STREAMS`].
    profiles: [Handle; 4],
}

/// Records `frame_sets` as `device` would give them, one every `pace`, into a .bag file.
pub fn record(path: &Path, device: &Device, pace: Duration, frame_sets: &[SensorImages]) {
    let made = make(device);
    let file = CString::new(path.to_str().unwrap()).unwrap();
    let recorder = call!(rs2_create_record_device_ex(made.device, file.as_ptr(), 1));
    // The recorder has sensors of its own, that are opened; what is fed goes to the device's.
    let sensors = call!(rs2_query_sensors(recorder));
    let queue = call!(rs2_create_frame_queue(100));
    let open: Vec<(Handle, Handle)> = (0..call!(rs2_get_sensors_count(sensors)))
        .map(|index| {
            let sensor = call!(rs2_create_sensor(sensors, index));
            let list = call!(rs2_get_stream_profiles(sensor));
            let count = call!(rs2_get_stream_profiles_count(list));
            let mut profiles: Vec<Handle> =
                (0..count).map(|k| call!(rs2_get_stream_profile(list, k))).collect();
            call!(rs2_open_multiple(sensor, profiles.as_mut_ptr(), count));
            call!(rs2_start_queue(sensor, queue));
            (sensor, list)
        })
        .collect();
    for (number, images) in frame_sets.iter().enumerate() {
        for (stream, pixels) in images {
            feed(&made, device, *stream, number, pixels);
        }
        // The recorder stamps by the clock: this is the pace of the playback.
        std::thread::sleep(pace);
    }
    for (sensor, list) in open {
        call!(rs2_stop(sensor));
        call!(rs2_close(sensor));
        // SAFETY: each is deleted once, and not used any more.
        unsafe {
            rs2_delete_stream_profiles_list(list);
            rs2_delete_sensor(sensor);
        }
    }
    // SAFETY: likewise; the recorder goes before the device that it records, and closes its file.
    unsafe {
        rs2_delete_frame_queue(queue);
        rs2_delete_sensor_list(sensors);
        rs2_delete_device(recorder);
        rs2_delete_sensor(made.depth_sensor);
        rs2_delete_sensor(made.color_sensor);
        rs2_delete_device(made.device);
    }
}

fn make(described: &Device) -> SoftwareDevice {
    let device = call!(rs2_create_software_device());
    let serial = CString::new(described.serial).unwrap();
    for (info, text) in [
        (INFO_NAME, c"Intel RealSense D435 (made)"),
        (INFO_SERIAL, serial.as_c_str()),
        (INFO_FIRMWARE, c"5.16.0.1"),
        (INFO_PRODUCT_LINE, c"D400"),
    ] {
        call!(rs2_software_device_register_info(device, info, text.as_ptr()));
    }
    let depth_sensor = call!(rs2_software_device_add_sensor(device, c"Stereo Module".as_ptr()));
    let color_sensor = call!(rs2_software_device_add_sensor(device, c"RGB Camera".as_ptr()));
    let profiles = STREAMS.map(|stream| {
        let sensor = if stream == Stream::Color { color_sensor } else { depth_sensor };
        call!(rs2_software_sensor_add_video_stream_ex(sensor, video_stream(described, stream), 1))
    });
    call!(rs2_software_sensor_add_read_only_option(
        depth_sensor,
        OPTION_DEPTH_UNITS,
        described.depth_unit_m
    ));
    for (option, value) in &described.options {
        call!(rs2_software_sensor_add_option(
            depth_sensor,
            *option as c_int,
            0.0,
            10.0,
            1.0,
            *value,
            1
        ));
    }
    call!(rs2_software_device_create_matcher(device, MATCHER_DEPTH_LEFT_RIGHT_COLOR));
    let (rotation, translation) = described.color_from_depth;
    call!(rs2_register_extrinsics(profiles[0], profiles[3], Extrinsics { rotation, translation }));
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let beside = |x_m: f32| Extrinsics { rotation: identity, translation: [x_m, 0.0, 0.0] };
    call!(rs2_register_extrinsics(profiles[0], profiles[1], beside(0.0)));
    call!(rs2_register_extrinsics(profiles[0], profiles[2], beside(-described.baseline_m)));
    SoftwareDevice { device, depth_sensor, color_sensor, profiles }
}

/// The library's number of the stream, its index, its bytes a pixel, its format.
fn layout(stream: Stream) -> [c_int; 4] {
    match stream {
        Stream::Depth => [1, 0, 2, 1],
        Stream::Infrared => [3, 1, 1, 9],
        Stream::Infrared2 => [3, 2, 1, 9],
        Stream::Color => [2, 0, 3, 5],
    }
}

fn video_stream(device: &Device, stream: Stream) -> VideoStream {
    let [number, index, bytes_per_pixel, format] = layout(stream);
    let size = device.size.map(|side| side as c_int);
    let camera = device.cameras[usize::from(stream == Stream::Color)];
    VideoStream {
        stream: number,
        index,
        unique: 10 * number + index,
        size,
        fps: device.fps as c_int,
        bytes_per_pixel,
        format,
        intrinsics: Intrinsics {
            size,
            principal: camera.principal_px,
            focal: camera.focal_px,
            model: BROWN_CONRADY,
            coefficients: camera.coefficients,
        },
    }
}

fn feed(made: &SoftwareDevice, device: &Device, stream: Stream, number: usize, pixels: &[u8]) {
    let [_, _, bytes_per_pixel, _] = layout(stream);
    assert_eq!(pixels.len(), (device.size[0] * device.size[1]) as usize * bytes_per_pixel as usize);
    // SAFETY: as many bytes are asked for as are copied into them, and nobody else has them yet.
    let copy = unsafe {
        let copy = malloc(pixels.len());
        assert!(!copy.is_null());
        std::ptr::copy_nonoverlapping(pixels.as_ptr(), copy.cast::<u8>(), pixels.len());
        copy
    };
    let sensor = if stream == Stream::Color { made.color_sensor } else { made.depth_sensor };
    let profile = made.profiles[STREAMS.iter().position(|of| *of == stream).unwrap()];
    let frame = VideoFrame {
        pixels: copy,
        deleter: release,
        stride: device.size[0] as c_int * bytes_per_pixel,
        bytes_per_pixel,
        timestamp_ms: 1.7e12 + number as f64 * 1000.0 / f64::from(device.fps),
        clock: HARDWARE_CLOCK,
        number: number as c_int + 1,
        profile,
        depth_unit_m: if stream == Stream::Depth { device.depth_unit_m } else { 0.0 },
    };
    call!(rs2_software_sensor_on_video_frame(sensor, frame));
}

/// A software device that a context lists, until it is dropped.
pub struct LiveDevice {
    made: SoftwareDevice,
    device: Device,
    /// What keeps it listed: the context itself remembers the device only as long as someone else
    /// does.
    listed: Handle,
    shown: usize,
}

// SAFETY: the library's objects may be used from any thread; this is used from one at a time.
unsafe impl Send for LiveDevice {}

impl LiveDevice {
    /// Adds it to the devices of `context`.
    pub fn plug_in(context: &Arc<Mutex<Context>>, device: &Device) -> Self {
        let made = make(device);
        let context = context.lock().unwrap();
        // SAFETY: the binding's context is the library's pointer and nothing else.
        let library: Handle = unsafe { from_ref(&*context).cast::<Handle>().read() };
        // For as long as the context lives, which may call back later.
        let added: &'static AtomicPtr<c_void> = Box::leak(Box::default());
        let user = from_ref(added).cast_mut().cast();
        call!(rs2_set_devices_changed_callback(library, keep_added, user));
        call!(rs2_context_add_software_device(library, made.device));
        let listed = loop {
            let listed = added.load(Ordering::Acquire);
            if !listed.is_null() {
                break listed;
            }
            std::thread::yield_now();
        };
        Self { made, device: device.clone(), listed, shown: 0 }
    }

    /// Gives one frame of every sensor.
    pub fn show(&mut self, images: &SensorImages) {
        for (stream, pixels) in images {
            feed(&self.made, &self.device, *stream, self.shown, pixels);
        }
        self.shown += 1;
    }

    /// Loses one frame of every sensor.
    pub fn skip(&mut self) {
        self.shown += 1;
    }

    /// What an option of the depth sensor stands at.
    pub fn option(&self, option: Rs2Option) -> f32 {
        call!(rs2_get_option(self.made.depth_sensor, option as c_int))
    }
}

impl Drop for LiveDevice {
    fn drop(&mut self) {
        // SAFETY: each is deleted once, and not used any more.
        unsafe {
            rs2_delete_device_list(self.listed);
            rs2_delete_sensor(self.made.depth_sensor);
            rs2_delete_sensor(self.made.color_sensor);
            rs2_delete_device(self.made.device);
        }
    }
}

/// Keeps the list of what was added, and so what is in it; once.
extern "C" fn keep_added(removed: Handle, added: Handle, user: *mut c_void) {
    // SAFETY: `user` is the pointer that was registered, which lives for ever; both lists are given
    // away to this function.
    unsafe {
        rs2_delete_device_list(removed);
        let kept = &*user.cast::<AtomicPtr<c_void>>();
        if kept.compare_exchange(null_mut(), added, Ordering::AcqRel, Ordering::Acquire).is_err() {
            rs2_delete_device_list(added);
        }
    }
}
