//! Given lens parameters that the images contradict, in words that a person can act on.

use crate::calibration::rounded::value_with_std;
use crate::estimation::given_misfit::{GivenDifference, GivenMisfit};

/// What is off, and what to do. `images` is what contradicts it: `views` or `images`.
pub(in crate::calibration) fn contradiction(misfit: &GivenMisfit, images: &str) -> String {
    let each = |GivenDifference { name, given, estimated, std }: &GivenDifference| {
        let estimated = value_with_std(*estimated, *std);
        format!("{name} {given} (without it, they determine {estimated})")
    };
    if misfit.is_whole_lens {
        let of_lens = |GivenDifference { name, given, estimated, std }: &GivenDifference| {
            let estimated = value_with_std(*estimated, *std);
            format!(": its {name} is {given:.2}, and without it they determine {estimated}")
        };
        let (off, ratio) = (misfit.parameters.first().map(of_lens), misfit.ratio);
        let off = off.unwrap_or_default();
        return format!(
            "the given lens contradicts the {images}{off}; projections differ by {ratio:.0} times their predicted uncertainty: it is of another camera, image size, focus or zoom; give this camera's, or none"
        );
    }
    let all: Vec<String> = misfit.parameters.iter().map(each).collect();
    let all = all.join(" and ");
    format!(
        "the {images} contradict the given {all}: give the value of this camera at this image size, focus and zoom, or none"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_has_its_estimate() {
        let fx = GivenDifference { name: "fx", given: 541.0, estimated: 534.4, std: 0.6 };
        let misfit = GivenMisfit { parameters: vec![fx], is_whole_lens: false, ratio: 11.0 };
        let said = contradiction(&misfit, "views");
        assert!(
            said.starts_with(
                "the views contradict the given fx 541 (without it, they determine 534.40 ± 0.60)"
            ),
            "{said}"
        );
        let whole = contradiction(&GivenMisfit { is_whole_lens: true, ..misfit }, "views");
        assert!(whole.contains("views: its fx is 541.00, and without it they"), "{whole}");
        assert!(whole.contains("differ by 11 times"), "{whole}");
    }
}
