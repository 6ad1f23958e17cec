//! A device's controls: set by name, held still while calibrating, given back as they were.

use std::collections::BTreeMap;

use v4l::Device;

use crate::capture::device_list::ListedControl;
use crate::capture::v4l2::kernel::{self, ControlKind, ControlRange};

const EXPOSURE_AUTO: u32 = 0x009a_0901;
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
const EXPOSURE_AUTO_PRIORITY: u32 = 0x009a_0903;
const FOCUS_ABSOLUTE: u32 = 0x009a_090a;
const FOCUS_AUTO: u32 = 0x009a_090c;
const ZOOM_ABSOLUTE: u32 = 0x009a_090d;
const AUTO_WHITE_BALANCE: u32 = 0x0098_090c;
const WHITE_BALANCE_TEMPERATURE: u32 = 0x0098_091a;
const AUTO_GAIN: u32 = 0x0098_0912;
const GAIN: u32 = 0x0098_0913;
const POWER_LINE_FREQUENCY: u32 = 0x0098_0918;
/// The menu item of `EXPOSURE_AUTO` for an exposure that stays.
const EXPOSURE_MANUAL: i32 = 1;

/// Names that stay, whatever the kernel's release calls the control.
const NAMES: [(&str, u32); 15] = [
    ("focus_auto", FOCUS_AUTO),
    ("focus_absolute", FOCUS_ABSOLUTE),
    ("zoom_absolute", ZOOM_ABSOLUTE),
    ("exposure_auto", EXPOSURE_AUTO),
    ("auto_exposure", EXPOSURE_AUTO),
    ("exposure_absolute", EXPOSURE_ABSOLUTE),
    ("exposure_time_absolute", EXPOSURE_ABSOLUTE),
    ("exposure_auto_priority", EXPOSURE_AUTO_PRIORITY),
    ("gain_auto", AUTO_GAIN),
    ("gain", GAIN),
    ("white_balance_auto", AUTO_WHITE_BALANCE),
    ("white_balance_temperature_auto", AUTO_WHITE_BALANCE),
    ("white_balance_temperature", WHITE_BALANCE_TEMPERATURE),
    ("power_line_frequency", POWER_LINE_FREQUENCY),
    ("focus", FOCUS_ABSOLUTE),
];

/// What moves by itself, the value that stops it, and the control whose value then counts.
const AUTOMATICS: [(u32, i32, Option<u32>); 5] = [
    (FOCUS_AUTO, 0, Some(FOCUS_ABSOLUTE)),
    (EXPOSURE_AUTO_PRIORITY, 0, None),
    (EXPOSURE_AUTO, EXPOSURE_MANUAL, Some(EXPOSURE_ABSOLUTE)),
    (AUTO_GAIN, 0, Some(GAIN)),
    (AUTO_WHITE_BALANCE, 0, Some(WHITE_BALANCE_TEMPERATURE)),
];

/// What focus and exposure are held by: a change of one of them is a change of the camera.
const OPTICS: [u32; 3] = [FOCUS_ABSOLUTE, ZOOM_ABSOLUTE, EXPOSURE_ABSOLUTE];

/// Why a control cannot be set.
#[derive(Debug, thiserror::Error)]
pub(super) enum ControlError {
    /// The device has no control of this name.
    #[error("no control {name}; it has {}", known.join(", "))]
    Unknown { name: String, known: Vec<String> },
    /// The device has no control that can be set.
    #[error("no control {name}: the device has no controls; remove `controls`")]
    NoControls { name: String },
    /// The value is out of the control's range.
    #[error("control {name} takes {minimum} to {maximum}")]
    OutOfRange { name: String, minimum: i64, maximum: i64 },
    /// The device refused the value.
    #[error("control {name} cannot be set to {value}: {refusal}")]
    Refused { name: String, value: i32, refusal: std::io::Error },
}

/// The controls of an open device, and what they were before.
#[derive(Debug)]
pub(super) struct Controls {
    ranges: Vec<ControlRange>,
    /// What was there before, in the order of setting.
    before: Vec<(u32, i32)>,
    /// As `before`, for the time of a session.
    before_hold: Vec<(u32, i32)>,
    /// What focus, zoom and exposure were when a session last held them.
    held: Vec<(u32, i32)>,
}

impl Controls {
    /// Reads which controls there are; sets none.
    pub fn read(device: &Device) -> Self {
        Self {
            ranges: kernel::controls(device),
            before: Vec::new(),
            before_hold: Vec::new(),
            held: Vec::new(),
        }
    }

    /// Sets what `wanted` says: what switches automatics first, for it frees the values.
    ///
    /// # Errors
    /// [`ControlError`].
    pub fn set(
        &mut self,
        device: &Device,
        wanted: &BTreeMap<String, i64>,
    ) -> Result<(), ControlError> {
        let mut orders = Vec::new();
        for (name, value) in wanted {
            let range = self.named(name).ok_or_else(|| self.unknown(name))?;
            let allowed = range.minimum..=range.maximum;
            let value =
                i32::try_from(*value).ok().filter(|value| allowed.contains(&i64::from(*value)));
            let value = value.ok_or_else(|| ControlError::OutOfRange {
                name: name.clone(),
                minimum: range.minimum,
                maximum: range.maximum,
            })?;
            orders.push((range.kind == ControlKind::Integer, range.id, value, name));
        }
        orders.sort();
        for (_, id, value, name) in orders {
            let old = kernel::control_value(device, id);
            kernel::set_control_value(device, id, value)
                .map_err(|refusal| ControlError::Refused { name: name.clone(), value, refusal })?;
            self.before.extend(old.ok().map(|old| (id, old)));
        }
        Ok(())
    }

    /// Stops what moves by itself, each at its present value.
    pub fn hold(&mut self, device: &Device) {
        for (automatic, still, value) in AUTOMATICS {
            let Some(old) = self.value(device, automatic).filter(|old| *old != still) else {
                continue;
            };
            let present = value.and_then(|id| Some((id, self.value(device, id)?)));
            if kernel::set_control_value(device, automatic, still).is_err() {
                continue;
            }
            self.before_hold.push((automatic, old));
            if let Some((id, present)) = present {
                // Where the value is refused the device keeps its own, which stays as well.
                let _ = kernel::set_control_value(device, id, present);
            }
        }
        let optics = OPTICS.iter().filter_map(|id| Some((*id, self.value(device, *id)?)));
        self.held = optics.collect();
    }

    /// Gives back what [`Self::hold`] took.
    pub fn release(&mut self, device: &Device) {
        give_back(device, &mut self.before_hold);
    }

    /// Gives everything back: the device is as it was when it was opened.
    pub fn restore(&mut self, device: &Device) {
        self.release(device);
        give_back(device, &mut self.before);
    }

    /// What has changed of focus, zoom and exposure since a session last held them, in words.
    pub fn moved(&self, device: &Device) -> Option<String> {
        let changed = self.held.iter().filter_map(|(id, held)| {
            let now = self.value(device, *id)?;
            (now != *held).then(|| format!("{} from {held} to {now}", self.name_of(*id)))
        });
        let words: Vec<String> = changed.collect();
        (!words.is_empty()).then(|| words.join(", "))
    }

    /// Every control with its range and present value.
    pub fn listed(&self, device: &Device) -> Vec<ListedControl> {
        let listed = self.ranges.iter().map(|range| ListedControl {
            name: self.name_of(range.id),
            value: kernel::control_value(device, range.id).ok().map(i64::from),
            minimum: range.minimum,
            maximum: range.maximum,
            default: range.default,
        });
        listed.collect()
    }

    fn value(&self, device: &Device, id: u32) -> Option<i32> {
        let range = self.ranges.iter().find(|range| range.id == id && range.is_writable())?;
        kernel::control_value(device, range.id).ok()
    }

    fn named(&self, name: &str) -> Option<&ControlRange> {
        let known = NAMES.iter().find(|(known, _)| *known == name).map(|(_, id)| *id);
        let named = |range: &&ControlRange| Some(range.id) == known || plain(&range.name) == name;
        self.ranges.iter().filter(|range| range.is_writable()).find(named)
    }

    fn unknown(&self, name: &str) -> ControlError {
        let known: Vec<String> =
            self.ranges.iter().filter(|r| r.is_writable()).map(|r| self.name_of(r.id)).collect();
        let name = name.to_owned();
        match known.is_empty() {
            true => ControlError::NoControls { name },
            false => ControlError::Unknown { name, known },
        }
    }

    fn name_of(&self, id: u32) -> String {
        let known =
            NAMES.iter().find(|(_, known)| *known == id).map(|(name, _)| (*name).to_owned());
        let stated =
            || self.ranges.iter().find(|range| range.id == id).map(|range| plain(&range.name));
        known.or_else(stated).unwrap_or_default()
    }
}

fn give_back(device: &Device, values: &mut Vec<(u32, i32)>) {
    for (id, value) in values.drain(..).rev() {
        // A device that is gone has nothing to be given back.
        let _ = kernel::set_control_value(device, id, value);
    }
}

/// `Power Line Frequency` as `power_line_frequency`.
fn plain(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driver_names_become_keys() {
        assert_eq!(plain("Focus, Automatic Continuous"), "focus_automatic_continuous");
        assert_eq!(plain("White Balance Temperature, Auto"), "white_balance_temperature_auto");
        assert_eq!(plain("Integer 32 Bits"), "integer_32_bits");
    }
}
