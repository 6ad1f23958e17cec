//! The information in a session's views about a pair of cameras: their relative pose, and where the
//! second one sees what the first one sees. Like the information about each camera, it depends on
//! the frames alone.

use nalgebra::DMatrix;

use crate::calibration::information::camera_information::{CameraInformation, ViewInformation};
use crate::calibration::information::next_shared_view::{SharedView, suggest_shared_view};
use crate::calibration::information::pair_information::PairInformation;
use crate::calibration::information::transfer_goal::TransferGoal;
use crate::geometry::median::{median, median_pose};
use crate::geometry::pose::Pose;

/// The information in the views of two cameras about the pair.
#[derive(Debug, Clone)]
pub struct CameraPairInformation {
    known: PairInformation,
    goal: TransferGoal,
    /// The uncertainty of each transferred pixel.
    now_px: Vec<f64>,
    shared: usize,
}

impl CameraPairInformation {
    /// The information in the shared views of `cameras`; each view is given by its number in the
    /// first and in the second camera. `None` while a lens is not estimated, or no view is shared.
    pub fn of(cameras: [&CameraInformation; 2], shared: &[[u32; 2]]) -> Option<Self> {
        if !cameras.iter().all(|camera| camera.is_estimated()) {
            return None;
        }
        let view = |camera: usize, number: u32| {
            cameras[camera].views().iter().find(|view| view.number == number)
        };
        let views: Vec<[&ViewInformation; 2]> =
            shared.iter().filter_map(|[a, b]| Some([view(0, *a)?, view(1, *b)?])).collect();
        let b_from_a: Vec<Pose> = views
            .iter()
            .map(|[a, b]| b.camera_from_board * a.camera_from_board.inverse())
            .collect();
        let lenses = [cameras[0].known(), cameras[1].known()];
        let mut known = PairInformation::of_lenses(lenses, median_pose(&b_from_a)?);
        for [a, b] in &views {
            let beyond =
                known.beyond([a.normal(), b.normal()], [a.information(), b.information()])?;
            known.matrix += beyond;
        }
        let distances =
            views.iter().map(|[a, _]| a.normal().middle_in_camera.norm()).collect::<Vec<f64>>();
        let images = cameras.map(|camera| (camera.lens(), camera.size()));
        let goal = TransferGoal::new(&known, images, median(distances)?, cameras[0].figure())?;
        let now_px = goal.std_px(&known.matrix)?;
        Some(Self { known, goal, now_px, shared: views.len() })
    }

    /// How many views they share.
    pub fn shared(&self) -> usize {
        self.shared
    }

    /// What is known of both.
    pub fn known(&self) -> &PairInformation {
        &self.known
    }

    /// The 1-σ uncertainty of where the second camera sees what the first one sees, at the distance
    /// of the shared views: the session's figure over the image, in pixels of the second.
    pub fn uncertainty_px(&self) -> f64 {
        self.goal.figure_px(&self.now_px)
    }

    /// How much one more shared view would lower that uncertainty: the mean over the image of the
    /// relative drop of the standard deviation, 0 to 1.
    pub fn gain(&self, [a, b]: [&ViewInformation; 2]) -> f64 {
        let information = self.known.of_view([a.normal(), b.normal()]);
        let after = information.and_then(|view| self.goal.std_px(&(&self.known.matrix + view)));
        let Some(after) = after else { return 0.0 };
        let drops = self.now_px.iter().zip(&after).map(|(now, after)| 1.0 - after / now);
        drops.sum::<f64>() / self.now_px.len() as f64
    }

    /// The relative drop, as in [`SharedView::drop`], with one more view of only one of the
    /// cameras, 0 to 1.
    pub fn drop_of_one(&self, camera: usize, information: &DMatrix<f64>) -> f64 {
        if information.nrows() != self.known.free[camera].len() {
            return 0.0;
        }
        let matrix = &self.known.matrix + self.known.of_one(camera, information);
        let after = self.goal.std_px(&matrix);
        let now_px = self.goal.criterion_px(&self.now_px);
        after.map_or(0.0, |after| 1.0 - self.goal.criterion_px(&after) / now_px)
    }

    /// The next shared view to suggest, with `goal_px` as the uncertainty to reach. The search
    /// starts from the first camera's last view. `cameras` must be those that this was made of.
    pub fn suggest(
        &self,
        cameras: [&CameraInformation; 2],
        goal_px: Option<f64>,
    ) -> Option<SharedView> {
        let noises = cameras.map(CameraInformation::corner_noise);
        let spaces = [cameras[0].space(&noises[0], &[]), cameras[1].space(&noises[1], &[])];
        let from = cameras[0].views().last().map(|view| &view.camera_from_board);
        suggest_shared_view(&self.known, &self.goal, [&spaces[0], &spaces[1]], (from, goal_px))
    }
}
