//! Images as cameras really send them.

use std::fs;

use plumb::imaging::decode;
use plumb::imaging::frame::{Frame, SensorKind};
use plumb::imaging::gray::GrayImage;
use plumb::imaging::image_file::frame_from_file;

use crate::shared_data::shared_data;

fn luma(frame: &Frame) -> GrayImage {
    let mut image = GrayImage::default();
    decode::luma(frame, &mut image).unwrap();
    image
}

#[test]
fn motion_jpeg_without_huffman_tables_and_with_stray_bytes_decodes_as_its_twin() {
    let Some(folder) = shared_data("mjpeg-nodht") else { return };
    let frame = frame_from_file(SensorKind::Color, fs::read(folder.join("mjpeg.jpg")).unwrap());
    let twin = frame_from_file(SensorKind::Color, fs::read(folder.join("mjpeg.png")).unwrap());
    assert_eq!((frame.size.width, frame.size.height), (960, 720));
    let total =
        |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
    // The twin's colors were clipped, and its luma comes from them.
    let (gray, gray_twin) = (luma(&frame), luma(&twin));
    assert_eq!(gray.size(), gray_twin.size());
    let difference = total(gray.pixels(), gray_twin.pixels());
    assert!(
        2 * difference < gray.pixels().len() as u64,
        "{difference} over {} pixels",
        gray.pixels().len()
    );
    // Colors differ where decoders interpolate the halved chroma differently; luma does not.
    let (colors, color_twin) = (decode::rgb(&frame).unwrap(), decode::rgb(&twin).unwrap());
    let difference = total(colors.as_raw(), color_twin.as_raw());
    assert!(difference < 2 * colors.len() as u64, "{difference} over {} values", colors.len());
}

#[test]
fn the_same_frame_cut_short_is_refused_in_one_line() {
    let Some(folder) = shared_data("mjpeg-nodht") else { return };
    let whole = fs::read(folder.join("mjpeg.jpg")).unwrap();
    for percent in [10, 50, 90, 99] {
        let cut = whole[..whole.len() * percent / 100].to_vec();
        let frame = frame_from_file(SensorKind::Color, cut);
        let line = decode::luma(&frame, &mut GrayImage::default()).unwrap_err().to_string();
        assert!(line.contains("ends too early") && !line.contains('\n'), "{percent} %: {line}");
    }
}

#[test]
fn every_real_image_decodes() {
    let sets = [
        "opencv-samples",
        "boofcv-sony-chess",
        "pora",
        "photon-lifecam/480",
        "sceaux",
        "temple-ring",
        "kinect1-herrera",
    ];
    for folder in sets.into_iter().filter_map(shared_data) {
        let mut recording =
            plumb::recording::Recording::open(&folder, &plumb::recording::ReadOptions::default())
                .unwrap();
        let mut images = 0;
        while let Some(set) = recording.next_frame_set().unwrap() {
            let frame = &set.frames[0];
            let image = luma(frame);
            assert_eq!(image.size(), frame.size, "{:?}", set.name);
            images += 1;
        }
        assert!(images > 10 || folder.ends_with("sceaux"), "{}: {images}", folder.display());
    }
}
