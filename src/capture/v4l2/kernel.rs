//! The V4L2 calls that the `v4l` crate lacks, or answers with a panic on devices it does not
//! expect: a name cut inside a character, a control of a newer type. The only unsafe code of this
//! source.
#![expect(unsafe_code, reason = "V4L2 is a set of ioctls")]

use std::ffi::c_void;
use std::io;
use std::mem;
use std::os::fd::RawFd;

use v4l::Device;
use v4l::v4l_sys::{v4l2_capability, v4l2_control, v4l2_query_ext_ctrl};
#[cfg(feature = "nokhwa")]
use v4l::v4l_sys::{v4l2_format, v4l2_streamparm};
use v4l::v4l2;
use v4l::v4l2::vidioc;
#[cfg(feature = "nokhwa")]
use v4l::video::capture::Parameters;
#[cfg(feature = "nokhwa")]
use v4l::{Format, FourCC, buffer};

#[cfg(feature = "nokhwa")]
use crate::geometry::pixel::ImageSize;

const NEXT_CONTROL: u32 = 0x8000_0000;
const CAP_VIDEO_CAPTURE: u32 = 0x0000_0001;
const CAP_VIDEO_CAPTURE_MULTIPLANAR: u32 = 0x0000_1000;
const CAP_STREAMING: u32 = 0x0400_0000;

/// What a device says it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Capability {
    pub driver: String,
    pub card: String,
    pub bus: String,
    flags: u32,
}

impl Capability {
    /// Whether it gives frames in the way that is read here.
    pub fn streams_video(&self) -> bool {
        self.flags & CAP_VIDEO_CAPTURE != 0 && self.flags & CAP_STREAMING != 0
    }

    /// Whether it gives frames only as several planes, as the image pipelines of phones do.
    pub fn is_multiplanar(&self) -> bool {
        self.flags & CAP_VIDEO_CAPTURE_MULTIPLANAR != 0
    }
}

/// What kind of value a control has; those that are not one number have none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ControlKind {
    Integer,
    Boolean,
    Menu,
}

/// One control of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ControlRange {
    pub id: u32,
    pub name: String,
    pub kind: ControlKind,
    pub minimum: i64,
    pub maximum: i64,
    pub default: i64,
    flags: u32,
}

impl ControlRange {
    /// Whether it can be set at all (perhaps not at this moment).
    pub fn is_writable(&self) -> bool {
        const DISABLED: u32 = 0x0001;
        const READ_ONLY: u32 = 0x0004;
        self.flags & (DISABLED | READ_ONLY) == 0
    }
}

/// Asks the device what it is.
pub(super) fn capability(device: &Device) -> io::Result<Capability> {
    // SAFETY: all zeros is a valid `v4l2_capability`: it is integers and arrays of bytes.
    let mut answer: v4l2_capability = unsafe { mem::zeroed() };
    call(device, vidioc::VIDIOC_QUERYCAP, &mut answer)?;
    Ok(Capability {
        driver: text(&answer.driver),
        card: text(&answer.card),
        bus: text(&answer.bus_info),
        flags: answer.device_caps,
    })
}

/// Every control whose value is one number, in the device's order.
pub(super) fn controls(device: &Device) -> Vec<ControlRange> {
    let mut found = Vec::new();
    let mut id = 0;
    loop {
        // SAFETY: all zeros is a valid `v4l2_query_ext_ctrl`: it is integers and arrays of them.
        let mut query: v4l2_query_ext_ctrl = unsafe { mem::zeroed() };
        query.id = id | NEXT_CONTROL;
        // A driver that answers with an id that does not rise would be asked for ever.
        if call(device, vidioc::VIDIOC_QUERY_EXT_CTRL, &mut query).is_err() || query.id <= id {
            return found;
        }
        id = query.id;
        let Some(kind) = control_kind(query.type_) else { continue };
        let name: Vec<u8> = query.name.iter().map(|byte| byte.cast_unsigned()).collect();
        found.push(ControlRange {
            id,
            name: text(&name),
            kind,
            minimum: query.minimum,
            maximum: query.maximum,
            default: query.default_value,
            flags: query.flags,
        });
    }
}

/// A control's present value.
pub(super) fn control_value(device: &Device, id: u32) -> io::Result<i32> {
    let mut control = v4l2_control { id, value: 0 };
    call(device, vidioc::VIDIOC_G_CTRL, &mut control)?;
    Ok(control.value)
}

/// Sets a control.
pub(super) fn set_control_value(device: &Device, id: u32, value: i32) -> io::Result<()> {
    call(device, vidioc::VIDIOC_S_CTRL, &mut v4l2_control { id, value })
}

/// Sets the format of an open descriptor, and gives the one it has then.
#[cfg(feature = "nokhwa")]
pub(super) fn set_format(descriptor: RawFd, size: ImageSize, code: FourCC) -> io::Result<Format> {
    // SAFETY: all zeros is a valid `v4l2_format`: it is integers, and a union of structures of
    // them.
    let mut argument: v4l2_format = unsafe { mem::zeroed() };
    argument.type_ = buffer::Type::VideoCapture as u32;
    argument.fmt.pix = Format::new(size.width, size.height, code).into();
    call_descriptor(descriptor, vidioc::VIDIOC_S_FMT, &mut argument)?;
    // SAFETY: `pix` is the union's member for this type, and any bytes are integers.
    Ok(Format::from(unsafe { argument.fmt.pix }))
}

/// Sets the rate of an open descriptor, frames a second.
#[cfg(feature = "nokhwa")]
pub(super) fn set_rate(descriptor: RawFd, fps: u32) -> io::Result<()> {
    // SAFETY: all zeros is a valid `v4l2_streamparm`, as for `v4l2_format`.
    let mut argument: v4l2_streamparm = unsafe { mem::zeroed() };
    argument.type_ = buffer::Type::VideoCapture as u32;
    argument.parm.capture = Parameters::with_fps(fps).into();
    call_descriptor(descriptor, vidioc::VIDIOC_S_PARM, &mut argument)
}

fn control_kind(code: u32) -> Option<ControlKind> {
    match code {
        1 => Some(ControlKind::Integer),
        2 => Some(ControlKind::Boolean),
        3 | 9 => Some(ControlKind::Menu),
        _ => None,
    }
}

/// One ioctl on an open device.
fn call<T>(device: &Device, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
    call_descriptor(device.handle().fd(), request, argument)
}

/// One ioctl; again when a signal came between. `argument` must be of the type that `request` is
/// for.
fn call_descriptor<T>(
    descriptor: RawFd,
    request: vidioc::_IOC_TYPE,
    argument: &mut T,
) -> io::Result<()> {
    loop {
        // SAFETY: every caller in this file passes the structure that its request is defined for,
        // exclusively borrowed, so the kernel writes inside it and nowhere else; a descriptor that
        // is closed or is no video device is refused.
        let outcome = unsafe {
            v4l2::ioctl(descriptor, request, std::ptr::from_mut(argument).cast::<c_void>())
        };
        match outcome {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            outcome => return outcome,
        }
    }
}

/// The text up to the first zero; what is not UTF-8, such as a character cut in two, is replaced.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}
