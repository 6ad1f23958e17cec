//! Results on the graph of ROS 2, beside HTTP: what is calibrated, as the robot's own topics say
//! it. Uses dds, geometry, recording, calibration, store and pipeline.
//!
//! | name | type | what |
//! | --- | --- | --- |
//! | `/plumb/<camera>/camera_info` | `sensor_msgs/msg/CameraInfo`, latched | the current calibration; of other sensors `/plumb/<camera>/depth/camera_info` and so on |
//! | `/plumb/<rig>/<camera>/camera_info` | the same | that of a rig; of two cameras rectified, R and P of both |
//! | `/tf_static` | `tf2_msgs/msg/TFMessage`, latched | where a camera's sensors are in its color sensor's optical frame |
//! | `/diagnostics` | `diagnostic_msgs/msg/DiagnosticArray` | each camera once a second, and when it changes |
//! | `/plumb/<camera>/state`, `/plumb/<rig>/state` | `std_msgs/msg/String`, latched | of the session: idle, collecting, solving, finished, failed, aborted |
//! | `/plumb/<camera>/start`, `…/stop`, `/plumb/<rig>/start`, `…/stop` | `std_srvs/srv/Trigger` | begin a session, as configured; end and solve it |
//! | `<driver>/set_camera_info` | `sensor_msgs/srv/SetCameraInfo` | called when a calibration becomes current, so that the driver keeps it |

mod camera;
mod diagnosis;
mod driver;
mod publish;
mod results;

pub use publish::{CameraOnGraph, GraphPlan, InstrumentsOnGraph, publish};
