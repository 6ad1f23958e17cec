//! Parts of a scene: groups of neighboring points, such as those of an object or a surface.

use nalgebra::Point3;

/// How often the scene is halved into parts, whose points are one cluster each. 32 parts are enough
/// to estimate the scatter between them, and each is large enough to hold an object or a surface.
const HALVINGS: u32 = 5;

/// The number of parts.
pub(super) const PARTS: usize = 1 << HALVINGS;

/// The part of the scene that contains each point. The scene is halved at the median along its
/// longest extent, and so is each half, and so on.
pub(super) fn scene_parts(points: &[Point3<f64>]) -> Vec<usize> {
    let mut parts = vec![0; points.len()];
    let mut split: Vec<Vec<usize>> = vec![(0..points.len()).collect()];
    for _ in 0..HALVINGS {
        split = split.into_iter().flat_map(|part| halved(points, part)).collect();
    }
    for (number, part) in split.iter().enumerate() {
        part.iter().for_each(|point| parts[*point] = number);
    }
    parts
}

/// The two halves of a part of the scene.
fn halved(points: &[Point3<f64>], mut part: Vec<usize>) -> [Vec<usize>; 2] {
    let extent = |axis: &usize| {
        let (low, high) = part
            .iter()
            .map(|k| points[*k][*axis])
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            });
        high - low
    };
    let longest = (0..3).max_by(|a, b| extent(a).total_cmp(&extent(b))).unwrap_or(0);
    part.sort_by(|a, b| points[*a][longest].total_cmp(&points[*b][longest]).then(a.cmp(b)));
    let upper = part.split_off(part.len() / 2);
    [part, upper]
}
