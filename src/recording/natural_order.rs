//! File names in the order that people mean: `frame2` before `frame10`.

use std::cmp::Ordering;

/// Compares names with their runs of digits taken as numbers; equal numbers with different leading
/// zeros, and anything else equal, are put in the order of their bytes, so that the order is total.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut rest_a, mut rest_b) = (a.as_bytes(), b.as_bytes());
    loop {
        let (digits_a, after_a) = split_digits(rest_a);
        let (digits_b, after_b) = split_digits(rest_b);
        let order = match (digits_a.is_empty(), digits_b.is_empty()) {
            (false, false) => {
                (rest_a, rest_b) = (after_a, after_b);
                compare_numbers(digits_a, digits_b)
            }
            _ => match (rest_a.split_first(), rest_b.split_first()) {
                (None, None) => return a.cmp(b),
                (Some((first_a, after_a)), Some((first_b, after_b))) => {
                    (rest_a, rest_b) = (after_a, after_b);
                    first_a.cmp(first_b)
                }
                (one, other) => return one.is_some().cmp(&other.is_some()),
            },
        };
        if order != Ordering::Equal {
            return order;
        }
    }
}

fn split_digits(text: &[u8]) -> (&[u8], &[u8]) {
    text.split_at(text.iter().take_while(|byte| byte.is_ascii_digit()).count())
}

fn compare_numbers(a: &[u8], b: &[u8]) -> Ordering {
    let significant =
        |digits: &[u8]| digits.iter().position(|digit| *digit != b'0').unwrap_or(digits.len());
    let (a, b) = (&a[significant(a)..], &b[significant(b)..]);
    a.len().cmp(&b.len()).then(a.cmp(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_count_as_numbers() {
        let sorted = [
            "1.png", "2.png", "10.png", "a", "a1b2", "a01b2x", "a1b10", "a2", "b", "left01",
            "left2", "left10",
        ];
        let mut names = sorted;
        names.reverse();
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, sorted);
    }

    #[test]
    fn the_order_is_total() {
        assert_eq!(natural_order("a1", "a01"), "a1".cmp("a01"));
        assert_eq!(natural_order("", ""), Ordering::Equal);
        assert_eq!(natural_order("", "0"), Ordering::Less);
        assert_eq!(
            natural_order("99999999999999999999999998", "99999999999999999999999999"),
            Ordering::Less
        );
    }
}
