//! The codes of a target's markers, arranged by payload cell, so that one cell of an image is
//! compared with all codes at once.

/// Codes that are compared together; their sums fit the processor's vector registers.
const BLOCK: usize = 32;

/// For each payload cell, its value in every code.
#[derive(Debug, Clone, Default)]
pub(super) struct CodeColumns {
    /// Column by column, each padded to a whole number of blocks.
    values: Vec<f32>,
    /// The number of codes.
    pub count: usize,
    /// The length of a padded column.
    pub room: usize,
}

impl CodeColumns {
    /// From `codes`, each of this many `cells`.
    pub(super) fn of(codes: &[f32], cells: usize) -> Self {
        let count = codes.len() / cells.max(1);
        let room = count.next_multiple_of(BLOCK);
        let mut values = vec![0.0; room * cells];
        for (slot, code) in codes.chunks_exact(cells.max(1)).enumerate() {
            for (cell, value) in code.iter().enumerate() {
                values[cell * room + slot] = *value;
            }
        }
        Self { values, count, room }
    }

    /// Appends the dot product of `payload` with each code.
    pub(super) fn compare(&self, payload: &[f32], sums: &mut Vec<f32>) {
        let start = sums.len();
        sums.resize(start + self.room, 0.0);
        pulp::Arch::new().dispatch(Compare { columns: self, payload, sums: &mut sums[start..] });
    }
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct Compare<'a> {
    columns: &'a CodeColumns,
    payload: &'a [f32],
    sums: &'a mut [f32],
}

impl pulp::NullaryFnOnce for Compare<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { columns: CodeColumns { values, room, .. }, payload, sums } = self;
        for (block, sums) in sums.chunks_exact_mut(BLOCK).enumerate() {
            let mut sum = [0.0_f32; BLOCK];
            for (cell, value) in payload.iter().enumerate() {
                let start = cell * room + block * BLOCK;
                let Some(codes) = values.get(start..).and_then(|it| it.first_chunk::<BLOCK>())
                else {
                    continue;
                };
                for k in 0..BLOCK {
                    sum[k] += codes[k] * value;
                }
            }
            sums.copy_from_slice(&sum);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_code_is_compared_by_itself() {
        let codes: Vec<f32> = (0..37 * 9).map(|k| ((k * 7919) % 23) as f32 / 23.0 - 0.4).collect();
        let payload: Vec<f32> = (0..9).map(|k| ((k * 31) % 11) as f32 / 11.0 - 0.5).collect();
        let columns = CodeColumns::of(&codes, 9);
        assert_eq!((columns.count, columns.room), (37, 64));
        let mut sums = vec![2.0];
        columns.compare(&payload, &mut sums);
        let expected =
            codes.chunks_exact(9).map(|code| code.iter().zip(&payload).map(|(a, b)| a * b).sum());
        assert_eq!(sums[1..38], expected.collect::<Vec<f32>>());
    }
}
