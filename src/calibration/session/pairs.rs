//! The information about the relative poses of a rig's cameras, pair by pair, and the shared view
//! to request next.
//!
//! The pairs form a minimum spanning tree: each camera is joined by the pair of least uncertainty.
//! The other pairs are ignored, so the true uncertainty is rather smaller than the stated one.

use crate::calibration::guidance::Guidance;
use crate::calibration::information::camera_information::{CameraInformation, ViewInformation};
use crate::calibration::information::camera_pair_information::CameraPairInformation;
use crate::calibration::information::next_shared_view::SharedView;
use crate::calibration::information::next_view::SuggestedView;
use crate::calibration::session::action::{CameraFrame, KeptView};
use crate::calibration::session::board_part::BoardPart;
use crate::calibration::session::camera::CameraPart;
use crate::calibration::session::sharing::Sharing;

/// Two cameras that share views.
#[derive(Debug, Clone)]
pub(super) struct Link {
    cameras: [usize; 2],
    pub(super) information: CameraPairInformation,
}

/// The view that lowers the greatest uncertainty between two cameras most.
#[derive(Debug, Clone)]
struct NextShared {
    cameras: [usize; 2],
    view: SharedView,
    /// No other view adds as much information about the rig.
    is_requested: bool,
}

/// A rig's cameras, pair by pair.
#[derive(Debug, Clone, Default)]
pub(super) struct Pairs {
    pub(super) links: Vec<Link>,
    next: Option<NextShared>,
    /// Every camera is joined to the first.
    is_whole: bool,
}

impl Pairs {
    /// The information in the `kept` views about the relative poses of `cameras`, with the
    /// uncertainty to reach.
    pub(super) fn of(cameras: &[CameraPart], kept: &[KeptView], goal_px: Option<f64>) -> Self {
        let mut links: Vec<Link> = Vec::new();
        let all = (0..cameras.len()).flat_map(|b| (0..b).map(move |a| [a, b]));
        let mut open: Vec<Link> = all
            .filter_map(|pair| {
                let information = CameraPairInformation::of(
                    information_of_both(cameras, pair)?,
                    &shared(kept, pair),
                )?;
                Some(Link { cameras: pair, information })
            })
            .collect();
        let mut joined = vec![false; cameras.len()];
        if let Some(first) = joined.first_mut() {
            *first = true;
        }
        while let Some(best) = (open.iter().enumerate())
            .filter(|(_, link)| joined[link.cameras[0]] != joined[link.cameras[1]])
            .min_by(|a, b| {
                a.1.information.uncertainty_px().total_cmp(&b.1.information.uncertainty_px())
            })
            .map(|(at, _)| at)
        {
            let link = open.swap_remove(best);
            link.cameras.iter().for_each(|camera| joined[*camera] = true);
            links.push(link);
        }
        let next = next_shared(&links, cameras, goal_px);
        let is_whole = joined.iter().all(|joined| *joined);
        Self { links, next, is_whole }
    }

    /// Whether every camera's pose is known to `goal_px`. A pair's uncertainty is multiplied by the
    /// factor by which the solve finds its cameras' own uncertainty greater than predicted.
    pub(super) fn reach(&self, cameras: &[CameraPart], goal_px: f64) -> bool {
        let reaches = |link: &Link| {
            let uncertainty_ratio = link
                .cameras
                .iter()
                .filter_map(|at| Some(cameras[*at].board()?.uncertainty_ratio()));
            link.information.uncertainty_px() * uncertainty_ratio.fold(1.0, f64::max) <= goal_px
        };
        cameras.len() < 2 || (self.is_whole && self.links.iter().all(reaches))
    }

    /// Asks each of the two cameras for its part of the shared view, and every other camera for its
    /// own suggestion again.
    pub(super) fn request_shared(&self, cameras: &mut [CameraPart]) {
        for (camera, part) in cameras.iter_mut().enumerate() {
            let requested = part.board().and_then(|part| self.requested_of(camera, part));
            part.request_shared(requested);
        }
    }

    /// Whether this camera and another one share, among the `usable` views of a frame set, a view
    /// that adds enough information about the pair.
    pub(super) fn share_informative_view(
        &self,
        sharing: Sharing<'_>,
        frame_set: &[Option<CameraFrame>],
        usable: &[bool],
        first: usize,
        simultaneous: impl Fn(usize, usize) -> bool,
    ) -> bool {
        self.second_of(first).any(|second| {
            let pair = [first, second];
            let is_new = |camera: usize| {
                let seen = frame_set[camera].as_ref();
                seen.is_some_and(|seen| sharing.is_held_anew(camera, seen))
            };
            let parts = pair.map(|camera| sharing.cameras[camera].board());
            let [Some(a), Some(b)] = parts else { return false };
            let (Some(of_a), Some(of_b)) = (a.newest(), b.newest()) else { return false };
            pair.iter().all(|camera| usable[*camera])
                && simultaneous(first, second)
                && pair.into_iter().any(is_new)
                && self.is_worth_keeping(pair, [of_a, of_b], a.worth())
        })
    }

    /// The cameras that form a pair with this one as its first.
    fn second_of(&self, first: usize) -> impl Iterator<Item = usize> {
        let links = self.links.iter().filter(move |link| link.cameras[0] == first);
        links.map(|link| link.cameras[1])
    }

    /// Whether a shared view is worth keeping for its information about the pair: at least `worth`
    /// times half of what the pair's shared views added on average.
    fn is_worth_keeping(&self, pair: [usize; 2], views: [&ViewInformation; 2], worth: f64) -> bool {
        self.links.iter().filter(|link| link.cameras == pair).any(|link| {
            let share = 0.5 * worth / link.information.shared().max(1) as f64;
            link.information.gain(views) >= share
        })
    }

    /// The two cameras that are asked for a shared view.
    pub(super) fn requested_pair(&self) -> Option<[usize; 2]> {
        self.next.as_ref().filter(|next| next.is_requested).map(|next| next.cameras)
    }

    /// The part of one camera in the shared view that is asked for.
    fn requested_of(&self, camera: usize, part: &BoardPart) -> Option<SuggestedView> {
        let next = self.next.as_ref().filter(|next| next.is_requested)?;
        let at = next.cameras.iter().position(|requested| *requested == camera)?;
        let views_to_go = part.own_suggestion().and_then(|own| own.views_to_go);
        let view = &next.view;
        part.information()?.suggested(view.camera_from_board[at], &view.normals[at], views_to_go)
    }

    /// The uncertainty after the suggested shared view, and how many views the rig still needs,
    /// including those of each camera's own guidance in `members`; `None` where unknown.
    pub(super) fn figures<'a>(
        &self,
        members: impl Iterator<Item = &'a Guidance>,
    ) -> (Option<f64>, Option<[u32; 2]>) {
        let Some(next) = &self.next else { return (None, None) };
        let expected = next.is_requested.then_some(next.view.expected_uncertainty_px);
        let most = |one: [u32; 2], other: [u32; 2]| [one[0].max(other[0]), one[1].max(other[1])];
        let of_pair = next.view.views_to_go.filter(|_| self.is_whole);
        let views_to_go = members.fold(of_pair, |so_far, guidance| {
            so_far.zip(guidance.views_to_go).map(|(one, other)| most(one, other))
        });
        (expected, views_to_go)
    }
}

fn information_of_both(
    cameras: &[CameraPart],
    pair: [usize; 2],
) -> Option<[&CameraInformation; 2]> {
    let information = |camera: usize| cameras.get(camera)?.board()?.information();
    Some([information(pair[0])?, information(pair[1])?])
}

/// The frame sets of which both cameras kept a view, as the view's number in each camera.
fn shared(kept: &[KeptView], [a, b]: [usize; 2]) -> Vec<[u32; 2]> {
    let of_a = kept.iter().filter(|view| view.camera == a);
    of_a.filter_map(|own| {
        let is_other = |other: &&KeptView| other.camera == b && other.frame_set == own.frame_set;
        Some([own.view, kept.iter().find(is_other)?.view])
    })
    .collect()
}

/// The shared view that most lowers the greatest uncertainty between two cameras. It is asked for
/// if that uncertainty is at least that of the lenses, and no view of one camera alone lowers it
/// more.
fn next_shared(links: &[Link], cameras: &[CameraPart], goal_px: Option<f64>) -> Option<NextShared> {
    let uncertainty_px = |link: &&Link| link.information.uncertainty_px();
    let weakest = links.iter().max_by(|a, b| uncertainty_px(a).total_cmp(&uncertainty_px(b)))?;
    let parts = [cameras[weakest.cameras[0]].board()?, cameras[weakest.cameras[1]].board()?];
    let view =
        weakest.information.suggest(information_of_both(cameras, weakest.cameras)?, goal_px)?;
    let is_least_known = parts.iter().all(|part| {
        let own_px = part.information().and_then(CameraInformation::uncertainty_px);
        own_px.is_some_and(|own_px| own_px <= weakest.information.uncertainty_px())
    });
    let alone = |(at, part): (usize, &&BoardPart)| {
        let own = part.own_suggestion();
        own.map_or(0.0, |own| weakest.information.drop_of_one(at, &own.information))
    };
    let is_requested =
        is_least_known && parts.iter().enumerate().all(|each| alone(each) <= view.drop);
    Some(NextShared { cameras: weakest.cameras, view, is_requested })
}
