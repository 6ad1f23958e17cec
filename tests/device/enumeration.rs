//! `plumb devices` on real nodes.

use std::process::Command;

use serde_json::Value;

use crate::guest::PLUMB;

pub fn every_camera_is_listed_with_its_names_and_formats() -> String {
    let output = Command::new(PLUMB).args(["devices", "--json"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let backends = document["backends"].as_array().unwrap();
    let v4l2 = backends.iter().find(|backend| backend["backend"] == "v4l2").unwrap();
    assert_eq!(v4l2["missing"], Value::Null);
    let devices = v4l2["devices"].as_array().unwrap();
    let vivid: Vec<&Value> = devices.iter().filter(|device| device["driver"] == "vivid").collect();
    assert_eq!(vivid.len(), 2, "{document}");
    assert_eq!(vivid[0]["bus"], "platform/vivid.0");
    assert_eq!(vivid[0]["name"], "vivid-000-vid-cap");
    let formats = vivid[0]["formats"].as_array().unwrap();
    let read: Vec<&str> = formats
        .iter()
        .filter(|f| f["read"] == true)
        .map(|format| format["name"].as_str().unwrap())
        .collect();
    assert_eq!(read, ["YUYV", "UYVY", "NV12", "GREY", "Y10", "Y12", "Y16", "RGB3", "BGR3"]);
    let yuyv = formats[0]["sizes"].as_array().unwrap();
    let small = yuyv.iter().find(|size| size["size"] == serde_json::json!([640, 360])).unwrap();
    assert!(small["fps"].as_array().unwrap().iter().any(|fps| fps == 30.0), "{small}");
    let controls = vivid[0]["controls"].as_array().unwrap();
    assert!(
        controls.iter().any(|control| control["name"] == "brightness" && control["value"] == 128)
    );
    let text = Command::new(PLUMB).arg("devices").output().unwrap();
    assert!(String::from_utf8(text.stdout).unwrap().contains("device = \"/dev/video0\""));
    format!(
        "{} devices, {} formats of vivid of which {} are read, {} controls",
        devices.len(),
        formats.len(),
        read.len(),
        controls.len()
    )
}
