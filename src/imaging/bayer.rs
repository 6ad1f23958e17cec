//! Color filter mosaics as red, green and blue.

use crate::geometry::pixel::ImageSize;

/// Which color the filters of the first two rows pass: red 0, green 1, blue 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BayerPattern([[u8; 2]; 2]);

impl BayerPattern {
    /// The pattern and the bytes per pixel of a ROS encoding, as `bayer_rggb8`.
    pub fn from_name(encoding: &str) -> Option<(Self, usize)> {
        let name = encoding.strip_prefix("bayer_")?;
        let (pattern, bits) = name.split_at_checked(4)?;
        let pattern = match pattern {
            "rggb" => [[0, 1], [1, 2]],
            "bggr" => [[2, 1], [1, 0]],
            "gbrg" => [[1, 2], [0, 1]],
            "grbg" => [[1, 0], [2, 1]],
            _ => return None,
        };
        let bytes_per_pixel = match bits {
            "8" => 1,
            "16" => 2,
            _ => return None,
        };
        Some((Self(pattern), bytes_per_pixel))
    }
}

/// Red, green and blue, interleaved, of a mosaic of width × height bytes: each color of a pixel is
/// the rounded mean of the filters of that color in its 3 × 3 neighborhood (bilinear), its own
/// filter's where it has one.
pub fn rgb_from_bayer(mosaic: &[u8], size: ImageSize, pattern: BayerPattern) -> Vec<u8> {
    let (width, height) = (size.width as usize, size.height as usize);
    if width == 0 || mosaic.len() != width * height {
        return Vec::new();
    }
    let mut rgb = Vec::with_capacity(3 * mosaic.len());
    for y in 0..height {
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        for x in 0..width {
            let (mut sums, mut counts) = ([0_u32; 3], [0_u32; 3]);
            for row in rows.clone() {
                for column in x.saturating_sub(1)..(x + 2).min(width) {
                    let color = usize::from(pattern.0[row % 2][column % 2]);
                    sums[color] += u32::from(mosaic[row * width + column]);
                    counts[color] += 1;
                }
            }
            let own = usize::from(pattern.0[y % 2][x % 2]);
            (sums[own], counts[own]) = (u32::from(mosaic[y * width + x]), 1);
            let mean = |color: usize| {
                let count = counts[color].max(1);
                ((sums[color] + count / 2) / count) as u8
            };
            rgb.extend([mean(0), mean(1), mean(2)]);
        }
    }
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pattern_gives_its_colors() {
        let size = ImageSize::new(6, 5);
        for name in ["bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg16"] {
            let (pattern, bytes) = BayerPattern::from_name(name).unwrap();
            assert_eq!(bytes, if name.ends_with("16") { 2 } else { 1 });
            let color = |x: usize, y: usize| [200, 120, 40][usize::from(pattern.0[y % 2][x % 2])];
            let mosaic: Vec<u8> = (0..30).map(|k| color(k % 6, k / 6)).collect();
            let rgb = rgb_from_bayer(&mosaic, size, pattern);
            assert_eq!(rgb, [200, 120, 40].repeat(30), "{name}");
        }
        assert!(BayerPattern::from_name("bayer_rgbg8").is_none());
        let (pattern, _) = BayerPattern::from_name("bayer_rggb8").unwrap();
        assert!(rgb_from_bayer(&[0; 7], size, pattern).is_empty());
    }
}
