//! Points with colors, as a PLY file that every viewer opens.

/// A measured point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudPoint {
    /// Where it is, in meters.
    pub point_m: [f32; 3],
    /// Its color: red, green, blue; black where no color is known.
    pub color: [u8; 3],
}

/// The points as binary little-endian PLY; `units` says what lengths are in, and `frame` in which
/// camera's frame the points are.
pub fn to_ply(points: &[CloudPoint], units: &str, frame: &str) -> Vec<u8> {
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment {units} in the {frame} camera's frame: x right, y down, z forward\n\
         element vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        points.len()
    );
    let mut file = header.into_bytes();
    file.reserve(15 * points.len());
    for CloudPoint { point_m, color } in points {
        point_m.iter().for_each(|coordinate| file.extend(coordinate.to_le_bytes()));
        file.extend(color);
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_fifteen_bytes_after_the_header() {
        let points = [
            CloudPoint { point_m: [0.5, -1.0, 2.0], color: [1, 2, 3] },
            CloudPoint { point_m: [0.0; 3], color: [255, 0, 9] },
        ];
        let file = to_ply(&points, "meters", "color");
        let start = file.windows(11).position(|bytes| bytes == b"end_header\n").unwrap() + 11;
        assert!(String::from_utf8_lossy(&file[..start]).contains("element vertex 2\n"));
        let body = &file[start..];
        assert_eq!(body.len(), 30);
        assert_eq!(
            (&body[..4], &body[8..15]),
            (&0.5f32.to_le_bytes()[..], &[0, 0, 0, 64, 1, 2, 3][..])
        );
        assert_eq!(body[27..], [255, 0, 9]);
    }
}
