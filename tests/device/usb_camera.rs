//! A USB camera made of software: the kernel's own USB core and `uvcvideo` see it on the virtual
//! bus of USB/IP (vhci-hcd).
//!
//! A gadget on dummy_hcd cannot be one: a UVC gadget streams isochronously, and dummy_hcd refuses
//! such transfers. This camera streams in bulk, which the UVC class knows too (USB Video Class 1.0,
//! section 2.4.3). The kernel is given one end of a socket pair; the other is answered here,
//! request by request (Documentation/usb/usbip_protocol.rst).

use std::collections::VecDeque;
use std::fs;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Condvar, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use plumb::imaging::decode;
use plumb::imaging::frame::Frame;
use plumb::imaging::gray::GrayImage;

use crate::loopback::yuyv_of;

const BUS: &str = "/sys/devices/platform/vhci_hcd.0";
const PORT: u32 = 0;
const HIGH_SPEED: u32 = 3;
const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const RETURNED: u32 = 3;
const UNLINKED: u32 = 4;
const STALL: i32 = -32;
const CONNECTION_RESET: i32 = -104;
/// The most that one bulk transfer carries: 32 packets, which is what uvcvideo asks for at once.
const PAYLOAD: usize = 32 * 512;

/// What the camera shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VideoFormat {
    Mjpg,
    Yuyv,
    Gray,
}

impl VideoFormat {
    /// A frame of a recording of JPEG images, in this format.
    pub fn of(self, frame: &Frame, luma: &mut GrayImage) -> Vec<u8> {
        match self {
            Self::Mjpg => frame.bytes.to_vec(),
            Self::Yuyv => yuyv_of(frame, luma),
            Self::Gray => {
                decode::luma(frame, luma).unwrap();
                luma.pixels().to_vec()
            }
        }
    }
}

/// What the camera is.
#[derive(Debug, Clone)]
pub struct CameraModel {
    pub serial: &'static str,
    pub size: [u16; 2],
    pub fps: u32,
}

/// Transfers that uvcvideo keeps under way while it streams (its `UVC_URBS`).
const TRANSFERS: usize = 5;
/// How long unplugging waits for them.
const SETTLING: Duration = Duration::from_secs(5);

/// A camera that is plugged in; unplugged with this value.
///
/// vhci-hcd of Linux 6.1 loses a transfer that it has not sent yet when its unlinking and the end
/// of the connection meet: `VIDIOC_STREAMOFF` then waits for that transfer for ever, and the hub
/// with it. So the connection ends when every transfer of the stream has been sent.
pub struct UsbCamera {
    connection: UnixStream,
    link: Arc<Link>,
}

impl UsbCamera {
    /// Plugs it in. `image` makes its frames, one after the other.
    pub fn plug_in(
        model: CameraModel,
        image: impl FnMut(VideoFormat) -> Vec<u8> + Send + 'static,
    ) -> Self {
        let (ours, kernels) = UnixStream::pair().unwrap();
        let link = Arc::new(Link::default());
        let streaming = (ours.try_clone().unwrap(), Arc::clone(&link), model.fps);
        thread::spawn(move || stream(&streaming.0, &streaming.1, streaming.2, image));
        let (answering, answered) = (ours.try_clone().unwrap(), Arc::clone(&link));
        thread::spawn(move || answer_all(answering, &answered, &model));
        let attach = format!("{PORT} {} {} {HIGH_SPEED}", kernels.as_raw_fd(), 0x1_0001);
        fs::write(format!("{BUS}/attach"), attach).unwrap();
        Self { connection: ours, link }
    }
}

impl Drop for UsbCamera {
    fn drop(&mut self) {
        let mut state = self.link.state.lock().unwrap();
        state.unplugging = true;
        let settles = |state: &mut State| {
            state.image.is_some() && state.waiting.len() < TRANSFERS && !state.ended
        };
        state = self.link.changed.wait_timeout_while(state, SETTLING, settles).unwrap().0;
        let _ = self.connection.shutdown(Shutdown::Both);
        drop(state);
    }
}

/// What both threads know.
#[derive(Default)]
struct Link {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Sequence numbers and lengths of the bulk transfers that wait for an image.
    waiting: VecDeque<(u32, usize)>,
    /// What is streamed.
    image: Option<VideoFormat>,
    /// No transfer of the stream is answered any more.
    unplugging: bool,
    ended: bool,
}

/// One request of the kernel.
struct Request {
    command: u32,
    sequence: u32,
    inward: bool,
    endpoint: u32,
    /// Of the transfer; of an unlinking, the sequence number of what is unlinked.
    length: u32,
    setup: [u8; 8],
    data: Vec<u8>,
}

fn read_request(stream: &mut UnixStream) -> Option<Request> {
    let mut header = [0; 48];
    stream.read_exact(&mut header).ok()?;
    let word = |k: usize| {
        u32::from_be_bytes([header[4 * k], header[4 * k + 1], header[4 * k + 2], header[4 * k + 3]])
    };
    let (command, inward) = (word(0), word(3) == 1);
    let length = if command == SUBMIT { word(6) } else { word(5) };
    let mut data = vec![0; if command == SUBMIT && !inward { length as usize } else { 0 }];
    stream.read_exact(&mut data).ok()?;
    let setup = header[40..48].try_into().unwrap();
    Some(Request { command, sequence: word(1), inward, endpoint: word(4), length, setup, data })
}

fn reply(
    mut stream: &UnixStream,
    command: u32,
    sequence: u32,
    status: i32,
    length: usize,
    data: &[u8],
) {
    let mut message = Vec::with_capacity(48 + data.len());
    for word in [command, sequence, 0, 0, 0, status as u32, length as u32, 0, 0, 0, 0, 0] {
        message.extend(word.to_be_bytes());
    }
    message.extend(data);
    // A kernel that is gone has no use for it.
    let _ = stream.write_all(&message);
}

fn answer_all(mut stream: UnixStream, link: &Link, model: &CameraModel) {
    let mut controls = Controls::new(model);
    while let Some(request) = read_request(&mut stream) {
        match request.command {
            SUBMIT if request.endpoint == 0 => {
                let answer = controls.answer(&request);
                let mut state = link.state.lock().unwrap();
                state.image = controls.streams;
                match answer {
                    Some(data) => {
                        let data = &data[..data.len().min(request.length as usize)];
                        let length = if request.inward { data.len() } else { request.data.len() };
                        reply(&stream, RETURNED, request.sequence, 0, length, data);
                    }
                    None => reply(&stream, RETURNED, request.sequence, STALL, 0, &[]),
                }
            }
            SUBMIT => link
                .state
                .lock()
                .unwrap()
                .waiting
                .push_back((request.sequence, request.length as usize)),
            UNLINK => {
                let mut state = link.state.lock().unwrap();
                let at = state.waiting.iter().position(|(sequence, _)| *sequence == request.length);
                let status =
                    at.and_then(|at| state.waiting.remove(at)).map_or(0, |_| CONNECTION_RESET);
                reply(&stream, UNLINKED, request.sequence, status, 0, &[]);
            }
            other => panic!("the kernel asks for {other}"),
        }
        link.changed.notify_all();
    }
    link.state.lock().unwrap().ended = true;
    link.changed.notify_all();
}

/// Answers bulk transfers with one payload each: two bytes of header, then a part of the image.
fn stream(
    stream: &UnixStream,
    link: &Link,
    fps: u32,
    mut image: impl FnMut(VideoFormat) -> Vec<u8>,
) {
    let mut frame: Vec<u8> = Vec::new();
    let (mut sent, mut parity, mut due) = (0, 0, Instant::now());
    let mut shown = None;
    loop {
        let mut state = link.state.lock().unwrap();
        while !state.ended
            && (state.unplugging || state.image.is_none() || state.waiting.is_empty())
        {
            state = link.changed.wait(state).unwrap();
        }
        if state.ended {
            return;
        }
        if sent == frame.len() || shown != state.image {
            shown = state.image;
            drop(state);
            frame = image(shown.unwrap());
            (sent, parity) = (0, parity ^ 1);
            thread::sleep(due.saturating_duration_since(Instant::now()));
            due = due.max(Instant::now() - Duration::from_secs(1)) + Duration::from_secs(1) / fps;
            continue;
        }
        let Some((sequence, length)) = state.waiting.pop_front() else { continue };
        let part = &frame[sent..(sent + length.min(PAYLOAD) - 2).min(frame.len())];
        sent += part.len();
        let is_last = u8::from(sent == frame.len());
        let mut payload = vec![2, 0x80 | (is_last << 1) | parity];
        payload.extend(part);
        // Under the lock: an unlinking comes before or after an answer, never between.
        reply(stream, RETURNED, sequence, 0, payload.len(), &payload);
    }
}

/// The control endpoint.
struct Controls {
    device: Vec<u8>,
    configuration: Vec<u8>,
    strings: [&'static str; 3],
    /// The negotiated stream: the class's probe and commit structure.
    probe: [u8; 26],
    streams: Option<VideoFormat>,
    camera: [CameraControl; 4],
    fps: u32,
    size: [u16; 2],
}

/// A control of the camera terminal: its selector, its size in bytes, its limits and its value.
struct CameraControl {
    selector: u8,
    bytes: usize,
    /// GET_MIN, GET_MAX, GET_RES, GET_DEF.
    limits: [u32; 4],
    value: u32,
}

impl Controls {
    fn new(model: &CameraModel) -> Self {
        let control = |selector, bytes, limits: [u32; 4]| CameraControl {
            selector,
            bytes,
            limits,
            value: limits[3],
        };
        Self {
            device: device_descriptor(),
            configuration: configuration_descriptor(model),
            strings: ["Plumb", "Software camera", model.serial],
            probe: probe_of(1, model.size, model.fps),
            streams: None,
            // Exposure mode (a resolution that is the set of modes: manual and automatic),
            // exposure, focus, autofocus.
            camera: [
                control(0x02, 1, [1, 8, 9, 8]),
                control(0x04, 4, [1, 10_000, 1, 156]),
                control(0x06, 2, [0, 250, 5, 50]),
                control(0x08, 1, [0, 1, 1, 1]),
            ],
            fps: model.fps,
            size: model.size,
        }
    }

    /// The answer's data; `None` is a stall.
    fn answer(&mut self, request: &Request) -> Option<Vec<u8>> {
        let [kind, code, value_low, value_high, index_low, index_high, ..] = request.setup;
        match (kind, code) {
            (0x80, 6) => match value_high {
                1 => Some(self.device.clone()),
                2 => Some(self.configuration.clone()),
                3 => self.string(value_low),
                _ => None,
            },
            (0x80..=0x82, 0) => Some(vec![0, 0]),
            (0x80, 8) => Some(vec![1]),
            // A bulk camera is stopped by clearing its endpoint's halt.
            (0x02, 1) => {
                self.streams = None;
                Some(Vec::new())
            }
            (0x00..=0x02, _) => Some(Vec::new()),
            (0x81, 10) => Some(vec![0]),
            (0x21 | 0xa1, _) if index_low == 1 => self.streaming(code, value_high, &request.data),
            (0x21 | 0xa1, _) if index_high == 1 => {
                self.camera_control(code, value_high, &request.data)
            }
            _ => None,
        }
    }

    fn string(&self, index: u8) -> Option<Vec<u8>> {
        let text = match index {
            0 => return Some(vec![4, 3, 9, 4]),
            _ => self.strings.get(usize::from(index) - 1)?,
        };
        let mut bytes = vec![2 + 2 * text.len() as u8, 3];
        bytes.extend(text.encode_utf16().flat_map(u16::to_le_bytes));
        Some(bytes)
    }

    /// Selector 1 proposes a stream, selector 2 begins it.
    fn streaming(&mut self, code: u8, selector: u8, data: &[u8]) -> Option<Vec<u8>> {
        match code {
            0x01 => {
                let format = *data.get(2)?;
                self.probe = probe_of(format.clamp(1, 3), self.size, self.fps);
                if selector == 2 {
                    self.streams = Some(match format {
                        2 => VideoFormat::Yuyv,
                        3 => VideoFormat::Gray,
                        _ => VideoFormat::Mjpg,
                    });
                }
                Some(Vec::new())
            }
            0x85 => Some(vec![26, 0]),
            0x86 => Some(vec![3]),
            0x81..=0x84 | 0x87 => Some(self.probe.to_vec()),
            _ => None,
        }
    }

    fn camera_control(&mut self, code: u8, selector: u8, data: &[u8]) -> Option<Vec<u8>> {
        let control = self.camera.iter_mut().find(|control| control.selector == selector)?;
        let bytes = |value: u32| Some(value.to_le_bytes()[..control.bytes].to_vec());
        match code {
            0x01 => {
                let mut value = [0; 4];
                value[..control.bytes].copy_from_slice(data.get(..control.bytes)?);
                control.value = u32::from_le_bytes(value);
                Some(Vec::new())
            }
            0x81 => bytes(control.value),
            0x82..=0x84 => bytes(control.limits[usize::from(code - 0x82)]),
            0x85 => Some(vec![control.bytes as u8, 0]),
            0x86 => Some(vec![3]),
            0x87 => bytes(control.limits[3]),
            _ => None,
        }
    }
}

fn interval(fps: u32) -> [u8; 4] {
    (10_000_000 / fps).to_le_bytes()
}

fn frame_bytes([width, height]: [u16; 2], bytes_per_pixel: u32) -> [u8; 4] {
    (u32::from(width) * u32::from(height) * bytes_per_pixel).to_le_bytes()
}

fn probe_of(format: u8, size: [u16; 2], fps: u32) -> [u8; 26] {
    let mut probe = [0; 26];
    probe[2] = format;
    probe[3] = 1;
    probe[4..8].copy_from_slice(&interval(fps));
    let bytes_per_pixel = if format == 3 { 1 } else { 2 };
    probe[18..22].copy_from_slice(&frame_bytes(size, bytes_per_pixel));
    probe[22..26].copy_from_slice(&(PAYLOAD as u32).to_le_bytes());
    probe
}

fn device_descriptor() -> Vec<u8> {
    vec![18, 1, 0, 2, 0xef, 2, 1, 64, 0x6b, 0x1d, 0x02, 0x01, 0, 1, 1, 2, 3, 1]
}

/// One camera terminal, one output, one streaming interface with MJPG, YUY2 and Y800 (which Linux
/// calls GREY) over one bulk endpoint.
fn configuration_descriptor(model: &CameraModel) -> Vec<u8> {
    let mut control = vec![13, 0x24, 1, 0, 1, 40, 0, 0x80, 0x8d, 0x5b, 0, 1, 1];
    control.extend([18, 0x24, 2, 1, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x2a, 0, 0x02]);
    control.extend([9, 0x24, 3, 2, 0x01, 0x01, 0, 1, 0]);
    let mut formats = vec![11, 0x24, 6, 1, 1, 1, 1, 0, 0, 0, 0];
    formats.extend(frame_descriptor(7, model, 2));
    formats.extend([6, 0x24, 0x0d, 1, 1, 4]);
    for (index, code, bytes_per_pixel) in [(2, b"YUY2", 2), (3, b"Y800", 1)] {
        formats.extend([27, 0x24, 4, index, 1]);
        formats.extend(code);
        formats.extend(b"\0\0\x10\0\x80\0\0\xaa\0\x38\x9b\x71");
        formats.extend([8 * bytes_per_pixel as u8, 1, 0, 0, 0, 0]);
        formats.extend(frame_descriptor(5, model, bytes_per_pixel));
        formats.extend([6, 0x24, 0x0d, 1, 1, 4]);
    }
    let mut body = vec![8, 11, 0, 2, 14, 3, 0, 0];
    body.extend([9, 4, 0, 0, 0, 14, 1, 0, 0]);
    body.extend(control);
    body.extend([9, 4, 1, 0, 1, 14, 2, 0, 0]);
    let header = 13 + 3;
    let [low, high] = (header + formats.len() as u16).to_le_bytes();
    body.extend([header as u8, 0x24, 1, 3, low, high, 0x81, 0, 2, 0, 0, 0, 1, 0, 0, 0]);
    body.extend(formats);
    body.extend([7, 5, 0x81, 2, 0, 2, 0]);
    let mut whole = vec![9, 2];
    whole.extend((9 + body.len() as u16).to_le_bytes());
    whole.extend([2, 1, 0, 0x80, 250]);
    whole.extend(body);
    whole
}

fn frame_descriptor(kind: u8, model: &CameraModel, bytes_per_pixel: u32) -> Vec<u8> {
    let mut frame = vec![30, 0x24, kind, 1, 0];
    model.size.iter().for_each(|side| frame.extend(side.to_le_bytes()));
    frame.extend(10_000_000_u32.to_le_bytes());
    frame.extend(100_000_000_u32.to_le_bytes());
    frame.extend(frame_bytes(model.size, bytes_per_pixel));
    frame.extend(interval(model.fps));
    frame.push(1);
    frame.extend(interval(model.fps));
    frame
}
