//! The solve problem: correspondences in, for `plumb solve` and `POST /v1/solve`.

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::SolveMethod;
use crate::document::error::DocumentError;
use crate::document::image_sensor::image_size;
use crate::document::lens_model::LensRequest;
use crate::estimation::camera::CameraOptions;
use crate::estimation::given_range::check_given_range;
use crate::estimation::problem::{
    BoardShape, BoardView, CameraProblem, Correspondence, GivenParameter, Shutter,
};
use crate::geometry::pixel::{ImageSize, Pixel};

/// Correspondences of one camera and what to do with them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProblemDocument {
    /// Width and height of the images, in pixels.
    #[schema(value_type = Vec<u32>, min_items = 2, max_items = 2)]
    pub image_size: [u32; 2],
    /// What was seen, image by image.
    #[schema(min_items = 1)]
    pub views: Vec<ProblemViewDocument>,
    /// The lens model to fit; default: `auto`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens: Option<LensRequest>,
    /// How to solve; default: `calibrate`.
    #[serde(default)]
    pub method: Method,
    /// Whether skew is estimated; else it is 0.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub skew: bool,
    /// Whether fx = fy.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub square_pixels: bool,
    /// Lens parameters that are known, by name, with their values: `{"fx": 600, "fy": 600, "k3":
    /// 0}`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub given: BTreeMap<String, f64>,
    /// Always estimate the board's shape: the same as `board_shape` `free`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub warp: bool,
    /// The board's shape; default: `auto`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board_shape: Option<BoardShapeRequest>,
    /// How the sensor reads its rows; default: `auto`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<ShutterRequest>,
}

impl ProblemDocument {
    /// What is to be estimated.
    pub fn options(&self) -> CameraOptions {
        CameraOptions {
            lens: self.lens.unwrap_or_default().into(),
            skew: self.skew,
            square_pixels: self.square_pixels,
            board_shape: match self.board_shape {
                _ if self.warp => BoardShape::Free,
                None | Some(BoardShapeRequest::Auto) => BoardShape::Auto,
                Some(BoardShapeRequest::Flat) => BoardShape::Flat,
                Some(BoardShapeRequest::Free) => BoardShape::Free,
            },
            shutter: match self.shutter {
                None | Some(ShutterRequest::Auto) => Shutter::Auto,
                Some(ShutterRequest::Global) => Shutter::Global,
                Some(ShutterRequest::Rolling) => Shutter::Rolling,
            },
            given: self
                .given
                .iter()
                .map(|(name, value)| GivenParameter { name: name.clone(), value: *value })
                .collect(),
            ..CameraOptions::default()
        }
    }
}

/// What shape a flat board may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BoardShapeRequest {
    /// As given by the object points, unless the views show deviations.
    Auto,
    /// As given by the object points.
    Flat,
    /// Estimated, whatever the views show.
    Free,
}

/// How the rows of an image are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShutterRequest {
    /// All at once, unless the views show that the board moved from row to row.
    Auto,
    /// All at once.
    Global,
    /// One after another.
    Rolling,
}

/// How to solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Lens and poses from several views of a flat target, with uncertainty.
    #[default]
    Calibrate,
    /// The direct linear transform: the projection matrix from one view of at least six points that
    /// are not in a plane.
    Dlt,
}

impl From<Method> for SolveMethod {
    fn from(method: Method) -> Self {
        match method {
            Method::Calibrate => Self::BundleAdjustment,
            Method::Dlt => Self::LinearTransform,
        }
    }
}

/// How far outside the image a pixel may be for noise, and what part of all may be farther as
/// outliers. Chosen, not swept.
const NOISE_PX: f64 = 1.0;
const MOST_OUTSIDE: f64 = 0.05;
/// As many are taken as outliers however few there are.
const ALWAYS_OUTSIDE: usize = 2;

/// One image's correspondences: as many pixels as object points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProblemViewDocument {
    /// What it is called in errors and in the result; default: its index.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Points of the object, in meters: `[X, Y, Z]`.
    pub object: Vec<[f64; 3]>,
    /// Where each was seen, in pixels: `[u, v]`.
    pub image: Vec<[f64; 2]>,
}

impl TryFrom<&ProblemDocument> for CameraProblem {
    type Error = DocumentError;
    fn try_from(document: &ProblemDocument) -> Result<Self, DocumentError> {
        let image_size = image_size(document.image_size)?;
        if document.views.is_empty() {
            return Err(DocumentError::field("views", "is empty; give at least one view"));
        }
        let views = document.views.iter().enumerate().map(|(i, view)| board_view(i, view));
        let problem = Self { image_size, views: views.collect::<Result<_, _>>()? };
        // A projection matrix has no image size.
        if document.method == Method::Calibrate {
            check_inside(&problem)?;
        }
        let CameraOptions { given, .. } = document.options();
        check_given_range(&given, image_size)
            .map_err(|error| DocumentError::field("given", error.to_string()))?;
        Ok(problem)
    }
}

/// Pixels that are farther outside the image than noise puts them: of another size than stated, or
/// with rows and columns exchanged.
///
/// # Errors
/// [`DocumentError::Field`] where they are more than outliers.
fn check_inside(problem: &CameraProblem) -> Result<(), DocumentError> {
    let CameraProblem { image_size: ImageSize { width, height }, views } = problem;
    let most = [*width, *height].map(|side| f64::from(side) - 0.5 + NOISE_PX);
    let least = -0.5 - NOISE_PX;
    let pixels = || views.iter().flat_map(|view| &view.correspondences).map(|it| it.pixel);
    let is_outside = |p: &Pixel| p.x < least || p.y < least || p.x > most[0] || p.y > most[1];
    let (outside, all) = (pixels().filter(is_outside).count(), pixels().count());
    if outside <= ALWAYS_OUTSIDE.max((MOST_OUTSIDE * all as f64) as usize) {
        return Ok(());
    }
    let range = |of: fn(Pixel) -> f64| {
        let least = pixels().map(of).fold(f64::INFINITY, f64::min);
        let most = pixels().map(of).fold(f64::NEG_INFINITY, f64::max);
        format!("from {least:.1} to {most:.1}")
    };
    let problem = format!(
        "{outside} of {all} pixels are outside the {width}x{height} image (u {}, v {}): give image_size as [width, height], and pixels as [u, v] from the top-left pixel",
        range(|p| p.x),
        range(|p| p.y)
    );
    Err(DocumentError::field("image_size", problem))
}

fn board_view(index: usize, view: &ProblemViewDocument) -> Result<BoardView, DocumentError> {
    let (points, pixels) = (view.object.len(), view.image.len());
    if points != pixels {
        let problem =
            format!("{pixels} pixels for {points} object points; each point needs its pixel");
        return Err(DocumentError::field(format!("views[{index}].image"), problem));
    }
    let correspondence = |(&[x, y, z], &[u, v]): (&[f64; 3], &[f64; 2])| Correspondence {
        point_in_board: Point3::new(x, y, z),
        pixel: Pixel::new(u, v),
        std_px: 1.0,
    };
    Ok(BoardView {
        name: view.name.clone().unwrap_or_else(|| index.to_string()),
        correspondences: view.object.iter().zip(&view.image).map(correspondence).collect(),
    })
}

impl From<&CameraProblem> for ProblemDocument {
    /// Weights are not part of the document: they are lost.
    fn from(problem: &CameraProblem) -> Self {
        let view = |view: &BoardView| ProblemViewDocument {
            name: Some(view.name.clone()),
            object: view.correspondences.iter().map(|c| c.point_in_board.into()).collect(),
            image: view.correspondences.iter().map(|c| [c.pixel.x, c.pixel.y]).collect(),
        };
        Self {
            image_size: [problem.image_size.width, problem.image_size.height],
            views: problem.views.iter().map(view).collect(),
            lens: None,
            method: Method::Calibrate,
            skew: false,
            square_pixels: false,
            given: BTreeMap::new(),
            warp: false,
            board_shape: None,
            shutter: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::reading::{from_json, to_json};

    #[test]
    fn a_problem_survives_to_the_bit() {
        let json = r#"{"image_size":[640,480],"views":[{"name":"a","object":[[0.1,0.2,0]],"image":[[1e-3,2.7]]}]}"#;
        let problem =
            CameraProblem::try_from(&from_json::<ProblemDocument>(json.as_bytes()).unwrap())
                .unwrap();
        let written = to_json(&ProblemDocument::from(&problem)).unwrap();
        assert_eq!(
            CameraProblem::try_from(&from_json::<ProblemDocument>(written.as_bytes()).unwrap()),
            Ok(problem)
        );
    }

    #[test]
    fn what_is_known_reaches_the_estimate() {
        let json = r#"{"image_size":[640,480],"views":[],"lens":"brown","square_pixels":true,"warp":true,"given":{"k3":0,"cx":320}}"#;
        let options = from_json::<ProblemDocument>(json.as_bytes()).unwrap().options();
        let given = |name: &str, value| GivenParameter { name: name.to_owned(), value };
        assert_eq!(options.given, [given("cx", 320.0), given("k3", 0.0)]);
        assert_eq!(options.board_shape, BoardShape::Free);
        assert!(options.square_pixels && !options.skew);
    }

    #[test]
    fn a_few_pixels_outside_the_image_are_outliers() {
        let solved_as = |method: &str, outside: usize| {
            let image: Vec<[f64; 2]> =
                (0..100).map(|k| if k < outside { [640.6, 5.0] } else { [639.0, 5.0] }).collect();
            let object = vec![[0.0; 3]; 100];
            let problem = serde_json::json!({
                "image_size": [640, 480], "method": method,
                "views": [{ "object": object, "image": image }],
            });
            let document: ProblemDocument = from_json(problem.to_string().as_bytes()).unwrap();
            CameraProblem::try_from(&document)
        };
        assert!(solved_as("calibrate", 5).is_ok());
        assert!(solved_as("dlt", 100).is_ok());
        let refused = solved_as("calibrate", 6).unwrap_err().to_string();
        assert!(refused.contains("6 of 100 pixels are outside"), "{refused}");
    }

    #[test]
    fn impossible_problems_are_refused_by_field() {
        let one = r#"{"object":[[0,0,0]],"image":[[1,2]]}"#;
        let table = [
            (r#"{"image_size":[0,480],"views":[]}"#.into(), "image_size"),
            (r#"{"image_size":[640,480],"views":[]}"#.into(), "views"),
            (
                format!(
                    r#"{{"image_size":[640,480],"views":[{one},{{"object":[[0,0,0]],"image":[]}}]}}"#
                ),
                "views[1].image",
            ),
            // Of an image of 480 x 640.
            (
                r#"{"image_size":[640,480],"views":[{"object":[[0,0,0],[1,0,0],[1,1,0]],"image":[[9,600],[9,610],[9,620]]}]}"#.into(),
                "image_size",
            ),
        ];
        for (json, field) in table {
            let document: ProblemDocument = from_json(json.as_bytes()).unwrap();
            assert_eq!(
                CameraProblem::try_from(&document).unwrap_err().path(),
                Some(field),
                "{json}"
            );
        }
    }
}
