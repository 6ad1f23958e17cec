//! `tf2_msgs/TFMessage`: how frames lie to each other.

use std::collections::BTreeMap;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::geometry::pose::Pose;
use crate::recording::bag::storage::{MessageEncoding, RosHeader};
use crate::recording::fields::TooShort;

/// More frames than any robot has.
const MOST_FRAMES: usize = 10_000;

/// The tree of frames, each with its parent.
#[derive(Debug, Default)]
pub(super) struct FrameTree {
    parents: BTreeMap<String, (String, Parent)>,
}

/// A child's pose in its parent.
#[derive(Debug, Clone, Copy)]
struct Parent {
    parent_from_child: Pose,
}

impl FrameTree {
    /// Takes in the transforms of a message, up to one that cannot be read.
    pub(super) fn read(&mut self, layout: MessageEncoding, message: &[u8]) -> Result<(), TooShort> {
        let mut fields = layout.fields(message)?;
        for _ in 0..fields.length()? {
            let parent = RosHeader::read(layout, &mut fields)?.frame_id;
            let child = fields.text()?;
            let [x, y, z] = [fields.f64()?, fields.f64()?, fields.f64()?];
            let [i, j, k, w] = [fields.f64()?, fields.f64()?, fields.f64()?, fields.f64()?];
            let quaternion = Quaternion::new(w, i, j, k);
            let length = quaternion.norm();
            let finite = [x, y, z].iter().all(|value| value.is_finite());
            if !finite || !(0.9..1.1).contains(&length) || self.parents.len() >= MOST_FRAMES {
                continue;
            }
            let rotation = UnitQuaternion::from_quaternion(quaternion);
            let parent_from_child = Pose::new(rotation, Vector3::new(x, y, z));
            self.parents.insert(plain(&child), (plain(&parent), Parent { parent_from_child }));
        }
        Ok(())
    }

    /// From frame `b` to frame `a`, where both are in one tree. Drivers that publish no tree give
    /// all their sensors one name: of a frame outside any tree nothing is known.
    pub(super) fn a_from_b(&self, a: &str, b: &str) -> Option<Pose> {
        let is_known = |frame: &str| {
            self.parents.contains_key(frame)
                || self.parents.values().any(|(parent, _)| parent == frame)
        };
        if !is_known(&plain(a)) || !is_known(&plain(b)) {
            return None;
        }
        let (root_of_a, root_from_a) = self.to_root(a);
        let (root_of_b, root_from_b) = self.to_root(b);
        (root_of_a == root_of_b).then(|| root_from_a.inverse() * root_from_b)
    }

    fn to_root(&self, frame: &str) -> (String, Pose) {
        let (mut frame, mut root_from_frame) = (plain(frame), Pose::identity());
        // A ring has no root: no more steps than there are frames.
        for _ in 0..self.parents.len() {
            let Some((parent, step)) = self.parents.get(&frame) else { break };
            root_from_frame = step.parent_from_child * root_from_frame;
            frame.clone_from(parent);
        }
        (frame, root_from_frame)
    }
}

/// ROS 1 wrote frames with a slash before them.
fn plain(frame: &str) -> String {
    frame.trim_start_matches('/').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(transforms: &[(&str, &str, [f64; 3])]) -> Vec<u8> {
        let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
        let mut bytes = (transforms.len() as u32).to_le_bytes().to_vec();
        for (parent, child, translation) in transforms {
            bytes.extend([0; 12]);
            bytes.extend(text(parent));
            bytes.extend(text(child));
            for value in translation.iter().chain(&[0.0, 0.0, 0.0, 1.0]) {
                bytes.extend(value.to_le_bytes());
            }
        }
        bytes
    }

    #[test]
    fn poses_follow_the_tree_and_a_ring_ends() {
        let mut tree = FrameTree::default();
        let links = [
            ("base", "color", [1.0, 0.0, 0.0]),
            ("base", "depth", [1.0, 0.0, 0.5]),
            ("depth", "/depth_optical", [0.0, 0.25, 0.0]),
        ];
        tree.read(MessageEncoding::Ros1, &message(&links)).unwrap();
        let color_from_depth = tree.a_from_b("color", "depth_optical").unwrap();
        assert_eq!(color_from_depth.translation(), Vector3::new(0.0, 0.25, 0.5));
        assert!(tree.a_from_b("color", "elsewhere").is_none());
        assert!(tree.a_from_b("elsewhere", "elsewhere").is_none());
        let ring = [("a", "b", [0.0; 3]), ("b", "a", [1.0, 0.0, 0.0])];
        tree.read(MessageEncoding::Ros1, &message(&ring)).unwrap();
        let _ends = tree.a_from_b("a", "b");
        assert!(tree.read(MessageEncoding::Ros1, b"\xff\xff\xff\xff").is_err());
    }
}
