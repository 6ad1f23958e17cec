//! The products of many descriptors with many others: whole numbers below 2²⁴, the same on every
//! processor.

use crate::features::descriptor::{Descriptor, LENGTH};

/// Number of columns of descriptors that are multiplied together.
pub(super) const LANES: usize = 16;
/// Number of rows of descriptors that are multiplied together.
pub(super) const ROWS: usize = 6;

/// Two neighboring numbers of a descriptor, which processors multiply and add in one step.
type Pair = [i16; 2];

/// A descriptor, pair by pair.
pub(super) type Row = [Pair; LENGTH / 2];

/// `LANES` descriptors, pair by pair.
pub(super) type Block = [[Pair; LANES]; LENGTH / 2];

/// The numbers of `descriptor`, pair by pair.
pub(super) fn row(descriptor: &Descriptor) -> Row {
    std::array::from_fn(|k| [descriptor.0[2 * k], descriptor.0[2 * k + 1]].map(i16::from))
}

/// `rows` side by side, with the last block padded with 0.
pub(super) fn blocks(rows: &[Row]) -> Vec<Block> {
    let block = |rows: &[Row]| -> Block {
        std::array::from_fn(|pair| std::array::from_fn(|k| rows.get(k).map_or([0; 2], |r| r[pair])))
    };
    rows.chunks(LANES).map(block).collect()
}

/// How rows and a block are multiplied.
pub(super) trait Multiply: Copy {
    /// The product of each row with each of the block's descriptors.
    fn products(self, rows: [&Row; ROWS], block: &Block) -> [[i32; LANES]; ROWS];
}

/// On any processor.
#[derive(Clone, Copy)]
pub(super) struct Plain;

impl Multiply for Plain {
    #[inline(always)]
    fn products(self, rows: [&Row; ROWS], block: &Block) -> [[i32; LANES]; ROWS] {
        let mut products = [[0; LANES]; ROWS];
        for (pair, values) in block.iter().enumerate() {
            for (row, products) in rows.iter().zip(&mut products) {
                let [a, b] = row[pair].map(i32::from);
                for (product, [c, d]) in products.iter_mut().zip(values) {
                    *product += a * i32::from(*c) + b * i32::from(*d);
                }
            }
        }
        products
    }
}

/// With AVX2's product of 16-bit pairs: twice as many numbers per step as with a product of floats.
#[cfg(target_arch = "x86_64")]
impl Multiply for pulp::x86::V3 {
    #[inline(always)]
    fn products(self, rows: [&Row; ROWS], block: &Block) -> [[i32; LANES]; ROWS] {
        let mut products = [[self.splat_i32x8(0); 2]; ROWS];
        for (pair, values) in block.iter().enumerate() {
            let values: [pulp::i16x16; 2] = pulp::cast(*values);
            for (row, products) in rows.iter().zip(&mut products) {
                let factor = pulp::cast(self.splat_i32x8(pulp::cast(row[pair])));
                for (product, values) in products.iter_mut().zip(values) {
                    let more = self.multiply_wrapping_add_adjacent_i16x16(factor, values);
                    *product = self.wrapping_add_i32x8(*product, more);
                }
            }
        }
        pulp::cast(products)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest numbers and sums that occur, and beyond.
    #[test]
    #[cfg(target_arch = "x86_64")]
    fn all_processors_agree() {
        let Some(v3) = pulp::x86::V3::try_new() else { return };
        let rows: Vec<Row> = (0..LANES)
            .map(|k| row(&Descriptor(std::array::from_fn(|n| 255 - ((n * k * 37) % 256) as u8))))
            .collect();
        let block = &blocks(&rows)[0];
        let first: [&Row; ROWS] = std::array::from_fn(|k| &rows[k]);
        let products = Plain.products(first, block);
        assert_eq!(products, v3.products(first, block));
        assert_eq!(products[0][0], LENGTH as i32 * 255 * 255);
    }
}
