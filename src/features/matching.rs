//! Matching the features of two images: each must be the other's nearest, and much nearer than the
//! second nearest (Lowe 2004, section 7.1).

use crate::features::descriptor::{Descriptor, LENGTH, UNIT};
use crate::features::products::{Block, LANES, Multiply, Plain, ROWS, Row, blocks, row};

/// A feature of one image and the corresponding feature of another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Match {
    /// Index in the first image.
    pub first: usize,
    /// Index in the second image.
    pub second: usize,
}

/// The largest ratio of the distance of the nearest to that of the second nearest (Lowe 2004,
/// figure 11).
const MOST_DISTANCE_RATIO: f32 = 0.8;

/// The least cosine between matching descriptors, whatever the ratio: a Euclidean distance of 0.7
/// at unit length, as in COLMAP.
const LEAST_PRODUCT: f32 = 1.0 - 0.7 * 0.7 / 2.0;

/// Descriptors arranged for products, singly and in blocks.
#[derive(Debug, Clone)]
pub struct DescriptorTable {
    len: usize,
    rows: Vec<Row>,
    blocks: Vec<Block>,
}

impl DescriptorTable {
    /// Of `descriptors`, in their order.
    pub fn new(descriptors: &[Descriptor]) -> Self {
        let mut rows: Vec<Row> = descriptors.iter().map(row).collect();
        let blocks = blocks(&rows);
        rows.resize(rows.len().next_multiple_of(ROWS), [[0; 2]; LENGTH / 2]);
        Self { len: descriptors.len(), rows, blocks }
    }
}

/// Two descriptors that both have at least this cosine with a third belong to a repeating texture.
/// Where the texture repeats, 77 to 89 % of the features of an image have two such in the next one;
/// in photographs of rooms, houses and things up to 12 %, of chessboards up to 27 % (OpenCV's SIFT,
/// pairs of images of eight sets).
const SAME_PRODUCT: f32 = 0.95;

/// The result of comparing the features of one image with those of another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Comparison {
    /// The matches, by the first image's index.
    pub matches: Vec<Match>,
    /// Number of features of the first image that match several places in the second.
    pub repeated: usize,
}

/// The matches between two images, by the first image's index.
pub fn match_descriptors(first: &DescriptorTable, second: &DescriptorTable) -> Vec<Match> {
    compare_descriptors(first, second).matches
}

/// The matches between two images, and how much of the first repeats in the second. The products of
/// descriptors are whole numbers below 2²⁴, so they are exact in any order of summation, and as
/// floats.
pub fn compare_descriptors(first: &DescriptorTable, second: &DescriptorTable) -> Comparison {
    let nearest = search(first, second);
    let (mut matches, mut repeated) = (Vec::new(), 0);
    for (index, row) in nearest.rows.iter().enumerate().take(first.len) {
        let distance = |product: i32| (2.0 - 2.0 * product as f32 / (UNIT * UNIT)).max(0.0);
        let is_near = row.best as f32 >= LEAST_PRODUCT * UNIT * UNIT;
        let is_distinct =
            distance(row.best) < MOST_DISTANCE_RATIO * MOST_DISTANCE_RATIO * distance(row.second);
        let is_mutual = nearest.column_rows.get(row.column) == Some(&(index as u32));
        if is_near && is_distinct && is_mutual {
            matches.push(Match { first: index, second: row.column });
        }
        let is_repeated = !is_distinct && row.second as f32 >= SAME_PRODUCT * UNIT * UNIT;
        repeated += usize::from(is_repeated);
    }
    Comparison { matches, repeated }
}

/// The largest products of a row in the table of products.
#[derive(Debug, Clone, Copy)]
struct Nearest {
    best: i32,
    second: i32,
    column: usize,
}

struct Search<'a, M> {
    first: &'a DescriptorTable,
    second: &'a DescriptorTable,
    multiply: M,
}

fn search(first: &DescriptorTable, second: &DescriptorTable) -> Found {
    #[cfg(target_arch = "x86_64")]
    if let Some(v3) = pulp::x86::V3::try_new() {
        return v3.vectorize(Search { first, second, multiply: v3 });
    }
    pulp::Arch::new().dispatch(Search { first, second, multiply: Plain })
}

struct Found {
    rows: Vec<Nearest>,
    /// For each column, the row with the largest product.
    column_rows: Vec<u32>,
}

/// Blocks of columns that stay in the nearest cache while the rows are processed.
const CACHED_BLOCKS: usize = 4;

#[derive(Clone, Copy)]
struct Lanes {
    best: [i32; LANES],
    second: [i32; LANES],
    block: [u32; LANES],
}

impl<M: Multiply> pulp::NullaryFnOnce for Search<'_, M> {
    type Output = Found;

    #[inline(always)]
    fn call(self) -> Found {
        let Self { first, second, multiply } = self;
        let nothing = Lanes { best: [-1; LANES], second: [-1; LANES], block: [0; LANES] };
        let mut lanes = vec![nothing; first.rows.len()];
        let mut column_best = vec![[-1_i32; LANES]; second.blocks.len()];
        let mut column_rows = vec![[0_u32; LANES]; second.blocks.len()];
        for start in (0..second.blocks.len()).step_by(CACHED_BLOCKS) {
            let end = (start + CACHED_BLOCKS).min(second.blocks.len());
            for (quad, rows) in first.rows.chunks_exact(ROWS).enumerate() {
                let rows: [&Row; ROWS] = std::array::from_fn(|k| &rows[k]);
                for block in start..end {
                    let products = multiply.products(rows, &second.blocks[block]);
                    for (k, products) in products.iter().enumerate() {
                        let row = quad * ROWS + k;
                        let lanes = &mut lanes[row];
                        let (best, at) = (&mut column_best[block], &mut column_rows[block]);
                        for j in 0..LANES {
                            let product = products[j];
                            let low = product.min(lanes.best[j]);
                            lanes.second[j] = lanes.second[j].max(low);
                            let better = product > lanes.best[j];
                            lanes.block[j] = if better { block as u32 } else { lanes.block[j] };
                            lanes.best[j] = product.max(lanes.best[j]);
                            let better = product > best[j];
                            at[j] = if better { row as u32 } else { at[j] };
                            best[j] = product.max(best[j]);
                        }
                    }
                }
            }
        }
        let rows = lanes.iter().map(|lanes| nearest(lanes, second.len)).collect();
        Found { rows, column_rows: column_rows.as_flattened()[..second.len].to_vec() }
    }
}

/// The best and second best over all lanes; the padding of the last block is skipped.
fn nearest(lanes: &Lanes, len: usize) -> Nearest {
    let mut nearest = Nearest { best: -1, second: -1, column: usize::MAX };
    for j in 0..LANES {
        let column = lanes.block[j] as usize * LANES + j;
        if column >= len {
            continue;
        }
        let better = lanes.best[j] > nearest.best
            || (lanes.best[j] == nearest.best && column < nearest.column);
        let (high, low) =
            if better { (lanes.best[j], nearest.best) } else { (nearest.best, lanes.best[j]) };
        if better {
            nearest.column = column;
        }
        nearest.best = high;
        nearest.second = nearest.second.max(low).max(lanes.second[j]);
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn descriptors(count: usize, seed: u32) -> Vec<Descriptor> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8 / 4
        };
        (0..count).map(|_| Descriptor(std::array::from_fn(|_| next()))).collect()
    }

    #[test]
    fn agrees_with_the_plain_search() {
        let (a, mut b) = (descriptors(53, 1), descriptors(41, 2));
        for k in 0..20 {
            b[2 * k] = a[k + 7];
            b[2 * k].0[k] ^= 3;
        }
        let product = |x: &Descriptor, y: &Descriptor| {
            x.0.iter().zip(y.0).map(|(x, y)| f32::from(*x) * f32::from(y)).sum::<f32>()
        };
        let nearest = |x: &Descriptor, of: &[Descriptor]| {
            (0..of.len())
                .max_by(|i, j| product(x, &of[*i]).total_cmp(&product(x, &of[*j])).then(j.cmp(i)))
        };
        let matches = match_descriptors(&DescriptorTable::new(&a), &DescriptorTable::new(&b));
        for Match { first, second } in &matches {
            assert_eq!(nearest(&a[*first], &b), Some(*second));
            assert_eq!(nearest(&b[*second], &a), Some(*first));
        }
        assert!(matches.len() <= 41);
        assert!(
            match_descriptors(&DescriptorTable::new(&a), &DescriptorTable::new(&[])).is_empty()
        );
    }

    #[test]
    fn what_is_at_two_places_is_repeated() {
        // Eight directions at right angles, of length UNIT: 16 numbers of UNIT / 4 each.
        let direction = |k: usize| {
            Descriptor(std::array::from_fn(|place| if place / 16 == k { 128 } else { 0 }))
        };
        let alone: Vec<Descriptor> = (0..8).map(direction).collect();
        let mut other = alone.clone();
        other.extend_from_slice(&alone[..3]);
        let compared =
            compare_descriptors(&DescriptorTable::new(&alone), &DescriptorTable::new(&other));
        assert_eq!((compared.repeated, compared.matches.len()), (3, 5));
        let compared =
            compare_descriptors(&DescriptorTable::new(&alone), &DescriptorTable::new(&alone));
        assert_eq!((compared.repeated, compared.matches.len()), (0, 8));
    }
}
