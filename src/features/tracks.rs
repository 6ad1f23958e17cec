//! Tracks: the features of many images that show one scene point. Matches are joined, and
//! contradictory tracks dropped.

use std::collections::BTreeMap;

use crate::features::matching::Match;

/// A feature: the image, and the feature's index in it.
pub type FeatureIndex = (usize, usize);

/// The tracks over at least two images that `matches` (image, image, matches) form: each a list of
/// features, one per image, in the order of the images. A track with two features of one image has
/// joined two scene points at an unknown match, and is dropped. Ordered by their first feature.
pub fn join_tracks(matches: &[(usize, usize, Vec<Match>)]) -> Vec<Vec<FeatureIndex>> {
    let mut index: BTreeMap<FeatureIndex, usize> = BTreeMap::new();
    for (a, b, pairs) in matches {
        for pair in pairs {
            for feature in [(*a, pair.first), (*b, pair.second)] {
                let next = index.len();
                index.entry(feature).or_insert(next);
            }
        }
    }
    let mut parent: Vec<usize> = (0..index.len()).collect();
    for (a, b, pairs) in matches {
        for pair in pairs {
            let first = root(&mut parent, index[&(*a, pair.first)]);
            let second = root(&mut parent, index[&(*b, pair.second)]);
            parent[first.max(second)] = first.min(second);
        }
    }
    let mut tracks: BTreeMap<usize, Vec<FeatureIndex>> = BTreeMap::new();
    for (feature, k) in &index {
        tracks.entry(root(&mut parent, *k)).or_default().push(*feature);
    }
    let has_one_an_image =
        |track: &Vec<FeatureIndex>| track.windows(2).all(|pair| pair[0].0 != pair[1].0);
    let mut tracks: Vec<_> = tracks.into_values().filter(has_one_an_image).collect();
    tracks.sort();
    tracks
}

/// The root of the set that contains `k` (union–find with path halving).
fn root(parent: &mut [usize], mut k: usize) -> usize {
    while parent[k] != k {
        parent[k] = parent[parent[k]];
        k = parent[k];
    }
    k
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chains_join_and_contradictions_go() {
        let pair = |first, second| Match { first, second };
        let matches = vec![
            (0, 1, vec![pair(5, 7), pair(6, 8), pair(1, 1)]),
            (1, 2, vec![pair(7, 9), pair(8, 3)]),
            (0, 2, vec![pair(5, 9), pair(6, 4)]),
        ];
        let tracks = join_tracks(&matches);
        assert_eq!(tracks, vec![vec![(0, 1), (1, 1)], vec![(0, 5), (1, 7), (2, 9)]]);
    }
}
