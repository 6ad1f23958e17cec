//! What goes wrong with real devices, made to go wrong.

use std::io::Read;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use plumb::capture::{CaptureError, SourceOpener};

use crate::guest::{PATIENCE, VIVID, camera, frames_until_error, options, press, processor_time};

pub fn a_camera_in_use_is_reported_with_its_holder() -> String {
    let mut holder = Command::new("v4l2-ctl");
    holder.args(["-d", VIVID, "--stream-mmap", "--stream-count=100000"]);
    let mut holder = holder.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    // It writes one of these for each frame; tried before, this program may take the device from
    // it.
    let mut progress = holder.stderr.take().unwrap().bytes();
    assert!(progress.any(|byte| byte.unwrap() == b'<'), "v4l2-ctl did not stream");
    let mut waiting = camera(options(VIVID, Some("YUYV")));
    let error = waiting.open().map(|_| ()).unwrap_err();
    let expected = format!("in use by v4l2-ctl (process {})", holder.id());
    assert!(error.to_string().contains(&expected), "{error}");
    assert!(matches!(error, CaptureError::Lost { .. }), "it may be free again by itself");
    holder.kill().unwrap();
    holder.wait().unwrap();
    waiting.open().unwrap().next_frame(PATIENCE).unwrap();
    error.to_string()
}

/// Each of vivid's faults: what is reported, and that the camera gives frames again afterwards.
pub fn each_injected_fault_is_reported_and_survived() -> String {
    let mut reported = Vec::new();
    for at_start in
        ["inject_vidioc_reqbufs_error", "inject_vidioc_qbuf_error", "inject_vidioc_streamon_error"]
    {
        let mut camera = camera(options(VIVID, Some("YUYV")));
        press(VIVID, &format!("{at_start}=1"));
        let error = camera.open().map(|_| ()).unwrap_err();
        assert!(error.to_string().contains("the driver answers: "), "{at_start}: {error}");
        assert!(matches!(error, CaptureError::Lost { .. }), "{at_start}");
        camera.open().unwrap().next_frame(PATIENCE).unwrap();
    }
    let mut opener = camera(options(VIVID, Some("YUYV")));
    let mut source = opener.open().unwrap();
    for _ in 0..3 {
        press(VIVID, "inject_v4l2_buf_flag_error=1");
        source.next_frame(PATIENCE).unwrap();
        source.next_frame(PATIENCE).unwrap();
    }
    let damaged = source.losses().damaged;
    assert!((1..=3).contains(&damaged), "{damaged} damaged frames");
    reported.push(format!("{damaged} of 3 damaged frames counted"));
    press(VIVID, "percentage_of_dropped_buffers=50");
    // Which ones are dropped is chance: of 200 frames, fewer than 5 would be one case in 10^50.
    let before = source.losses().missed;
    let counted = (0..200).any(|_| {
        source.next_frame(PATIENCE).unwrap();
        source.losses().missed >= before + 5
    });
    press(VIVID, "percentage_of_dropped_buffers=0");
    let missed = source.losses().missed;
    assert!(counted, "{missed} missed frames, {before} of them before any was dropped");
    reported.push(format!("{missed} missed frames counted"));
    press(VIVID, "inject_fatal_streaming_error=1");
    let (_, error) = frames_until_error(&mut *source);
    assert!(matches!(error, CaptureError::Lost { .. }), "{error}");
    reported.push(error.to_string());
    drop(source);
    let mut source = opener.open().unwrap();
    source.next_frame(PATIENCE).unwrap();
    press(VIVID, "disconnect=1");
    let (_, error) = frames_until_error(&mut *source);
    assert_eq!(error.to_string(), format!("{VIVID} was lost: it was unplugged"));
    drop(source);
    opener.open().unwrap().next_frame(PATIENCE).unwrap();
    reported.join("; ")
}

/// A device that gives nothing: the wait is as long as was asked for, and costs nothing.
pub fn a_stalled_device_never_blocks() -> String {
    let mut slow = options(VIVID, Some("YUYV"));
    slow.mode.fps = Some(1.0);
    let mut source = camera(slow).open().unwrap();
    source.next_frame(PATIENCE).unwrap();
    let wait = Duration::from_millis(50);
    let (began, busy) = (Instant::now(), processor_time("self"));
    let mut timeouts = 0;
    while timeouts < 10 {
        let timed_out = CaptureError::TimedOut { waited: wait };
        timeouts += usize::from(source.next_frame(wait).is_err_and(|error| error == timed_out));
    }
    let (elapsed, busy) = (began.elapsed(), processor_time("self") - busy);
    assert!(elapsed < PATIENCE, "10 waits of 50 ms took {elapsed:?}");
    assert!(busy < elapsed / 2, "{busy:?} of {elapsed:?} were spent computing");
    format!(
        "10 waits of 50 ms: {} ms, of which {} ms computing",
        elapsed.as_millis(),
        busy.as_millis()
    )
}
