//! From a rig to cameras at their places.

use akrobat_cameras::{CameraMount, CameraSpec, Jitter, PoseValues, Reference, Rig};
use akrobat_model::task::Task;
use akrobat_model::{ModelError, Pose};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::backend::PlacedCamera;
use crate::handle::{HANDLE_DEPTH_TOLERANCE_M, Handle};
use crate::raycast::first_hit;
use crate::replay::base_link;
use crate::seed::{Normal, Seed};
use crate::{FrameState, RenderError, RenderScene};

/// A frame of the robot that can carry a camera.
#[derive(Debug, Clone, Copy)]
enum Carrier {
    /// The tool frame.
    Tool,
    /// A link of the robot's tree.
    Link(usize),
}

impl Carrier {
    fn world_from_carrier(self, frame: &FrameState) -> Pose {
        match self {
            Self::Tool => frame.world_from_tool,
            Self::Link(link) => frame.world_from_robot_link[link],
        }
    }
}

/// What a camera moves with.
#[derive(Debug, Clone, Copy)]
enum Anchor {
    /// A frame of the robot, and the camera in it.
    Rigid(Carrier, Pose),
    /// What carries a pan-tilt head, and the camera's place on it.
    LookAtTool(Carrier, Point3<f64>),
    /// The world, and the camera in it.
    World(Pose),
}

/// One camera of a rig on a robot, in a world.
#[derive(Debug, Clone)]
struct MountedCamera {
    spec: CameraSpec,
    anchor: Anchor,
    /// Error of the mounting: the camera as it is, in the frame of the camera as it should be.
    jitter: Pose,
}

/// A rig's cameras on a robot, in a world.
#[derive(Debug, Clone)]
pub struct PlacedRig {
    cameras: Vec<MountedCamera>,
}

impl PlacedRig {
    /// Mounts a rig for one trajectory.
    ///
    /// `keyframes` are some frames of the trajectory, in order: cameras that look at the handle are placed so that
    /// they see it in as many of them as possible.
    ///
    /// # Errors
    /// [`RenderError::Rig`] where the rig is invalid or names a link that the robot does not have.
    ///
    /// # Panics
    /// Without keyframes.
    pub fn new(
        rig: &Rig,
        task: &Task,
        scene: &RenderScene,
        handle: &Handle,
        keyframes: &[FrameState],
    ) -> Result<Self, RenderError> {
        rig.validate(&rig.name)?;
        rig.validate_links(task.robot.tree.links().iter().map(|link| link.name.as_str()))?;
        let anchor = |camera: &CameraSpec| -> Result<Anchor, RenderError> {
            Ok(match &camera.mount {
                CameraMount::Link { link, link_from_camera } => {
                    Anchor::Rigid(carrier(task, link)?, pose_of(camera, link_from_camera)?)
                }
                CameraMount::LookAtTool { link, position } => {
                    Anchor::LookAtTool(carrier(task, link)?, Point3::from(*position))
                }
                CameraMount::World { world_from_camera } => {
                    Anchor::World(pose_of(camera, world_from_camera)?)
                }
                CameraMount::LookAt { relative_to, position, target } => {
                    let world_from_reference = match relative_to {
                        Reference::World => Pose::identity(),
                        Reference::Object => task.object.world_from_root,
                        Reference::Handle => world_from_handle_frame(handle, keyframes),
                    };
                    let [eye, target] =
                        [position, target].map(|p| world_from_reference * Point3::from(*p));
                    Anchor::World(look_at(&eye, &target))
                }
                CameraMount::LookAtHandle { offset } => {
                    Anchor::World(look_at_handle(scene, handle, keyframes, *offset))
                }
            })
        };
        let mounted = |camera: &CameraSpec| -> Result<MountedCamera, RenderError> {
            let (spec, jitter) = (camera.clone(), Pose::identity());
            Ok(MountedCamera { spec, anchor: anchor(camera)?, jitter })
        };
        Ok(Self { cameras: rig.cameras.iter().map(mounted).collect::<Result<_, _>>()? })
    }

    /// Draws the errors of the mountings for one episode.
    #[must_use]
    pub fn jittered(mut self, episode: Seed) -> Self {
        for camera in &mut self.cameras {
            if let Some(jitter) = &camera.spec.jitter {
                let seed = episode.name(&camera.spec.name).name("jitter");
                camera.jitter = drawn(jitter, seed);
            }
        }
        self
    }

    /// The error of each camera's mounting, in the rig's order: its pose in the frame of the camera as
    /// specified.
    pub fn jitter(&self) -> impl Iterator<Item = (&CameraSpec, &Pose)> {
        self.cameras.iter().map(|camera| (&camera.spec, &camera.jitter))
    }

    /// The cameras at one frame, in the rig's order.
    pub fn at(&self, frame: &FrameState) -> Vec<PlacedCamera> {
        let place = |MountedCamera { spec: camera, anchor, jitter }: &MountedCamera| PlacedCamera {
            name: camera.name.clone(),
            intrinsics: camera.intrinsics(),
            near_m: camera.near_m,
            far_m: camera.far_m,
            world_from_camera: match *anchor {
                Anchor::Rigid(carrier, carrier_from_camera) => {
                    carrier.world_from_carrier(frame) * carrier_from_camera
                }
                Anchor::LookAtTool(carrier, position) => {
                    let eye = carrier.world_from_carrier(frame) * position;
                    look_at(&eye, &Point3::from(frame.world_from_tool.translation.vector))
                }
                Anchor::World(world_from_camera) => world_from_camera,
            } * jitter,
            normals: false,
        };
        self.cameras.iter().map(place).collect()
    }
}

fn drawn(jitter: &Jitter, seed: Seed) -> Pose {
    let (mut random, mut normal) = (seed.stream(), Normal::default());
    let mut vector = |deviation: f64| Vector3::from_fn(|_, _| deviation * normal.next(&mut random));
    let (position, rotation) = (vector(jitter.position_m), vector(jitter.rotation_rad));
    Pose::from_parts(position.into(), UnitQuaternion::from_scaled_axis(rotation))
}

fn pose_of(camera: &CameraSpec, values: &PoseValues) -> Result<Pose, ModelError> {
    values.to_pose().map_err(|message| ModelError::bad_value(&camera.name, message))
}

fn carrier(task: &Task, link: &str) -> Result<Carrier, ModelError> {
    let robot = &task.robot;
    Ok(match link {
        "tool" => Carrier::Tool,
        "base" => Carrier::Link(base_link(task)),
        "mount" => {
            let first = robot.arm_joints.first();
            let mount = first.map_or(robot.tree.root(), |&joint| robot.tree.joints()[joint].parent);
            Carrier::Link(mount)
        }
        name => Carrier::Link(robot.tree.link_index(name)?),
    })
}

/// Offsets that are tried, as factors of the one asked for (out, sideways, up) and metres added on top:
/// as asked, to the other side, nearer, higher, in front.
const ALTERNATIVES: [([f64; 3], f64); 14] = [
    ([1.0, 1.0, 1.0], 0.0),
    ([1.0, -1.0, 1.0], 0.0),
    ([0.75, 0.75, 0.75], 0.0),
    ([0.75, -0.75, 0.75], 0.0),
    ([1.0, 1.0, 1.0], 0.5),
    ([1.0, -1.0, 1.0], 0.5),
    ([0.75, 1.5, 1.0], 0.0),
    ([0.75, -1.5, 1.0], 0.0),
    ([0.5, 1.5, 1.0], 0.3),
    ([0.5, -1.5, 1.0], 0.3),
    ([0.5, 0.5, 0.5], 0.0),
    ([0.5, -0.5, 0.5], 0.0),
    ([1.0, 0.0, 1.0], 0.5),
    ([0.5, 0.0, 1.0], 0.5),
];

/// A pose from which the handle is seen in most of the keyframes: of equally good ones the first.
fn look_at_handle(
    scene: &RenderScene,
    handle: &Handle,
    keyframes: &[FrameState],
    offset: [f64; 3],
) -> Pose {
    let positions: Vec<Point3<f64>> = keyframes.iter().map(|f| handle.position(f)).collect();
    let target = middle(&positions);
    let outward = outward_yaw(handle, &keyframes[0]);
    let mut best = (0, Point3::origin());
    for (index, (factor, raised)) in ALTERNATIVES.iter().enumerate() {
        let [out, side, up]: [f64; 3] = std::array::from_fn(|i| offset[i] * factor[i]);
        let eye = target + outward * Vector3::new(out, side, up + raised);
        let sees = |(frame, position): &(&FrameState, &Point3<f64>)| {
            first_hit(scene, &frame.world_from_body, &eye, position)
                .is_none_or(|hit| hit >= (*position - eye).norm() - HANDLE_DEPTH_TOLERANCE_M)
        };
        let seen = keyframes.iter().zip(&positions).filter(sees).count();
        if index == 0 || seen > best.0 {
            best = (seen, eye);
        }
        if seen == keyframes.len() {
            break;
        }
    }
    look_at(&best.1, &target)
}

/// The frame at the middle of the handle's way: z up, x horizontally out of the object.
fn world_from_handle_frame(handle: &Handle, keyframes: &[FrameState]) -> Pose {
    let positions: Vec<Point3<f64>> = keyframes.iter().map(|f| handle.position(f)).collect();
    let outward = outward_yaw(handle, &keyframes[0]);
    Pose::from_parts(
        Translation3::from(middle(&positions).coords),
        UnitQuaternion::from_rotation_matrix(&outward),
    )
}

/// Centre of the bounding box of some points.
fn middle(points: &[Point3<f64>]) -> Point3<f64> {
    let (mut low, mut high) = (points[0], points[0]);
    for point in points {
        low = low.inf(point);
        high = high.sup(point);
    }
    nalgebra::center(&low, &high)
}

/// Rotation about the vertical that takes x to the horizontal direction out of the object: against the tool's
/// approach; where that is vertical, from the handle to the robot's base.
fn outward_yaw(handle: &Handle, frame: &FrameState) -> Rotation3<f64> {
    let grasp = handle.world_from_grasp(frame);
    let against_approach = -(grasp * Vector3::z());
    let to_base = frame.world_from_base.translation.vector - grasp.translation.vector;
    let level = against_approach.xy().norm() > 0.3;
    let outward = if level { against_approach } else { to_base };
    Rotation3::from_axis_angle(&Vector3::z_axis(), outward.y.atan2(outward.x))
}

/// Camera pose at `eye` looking at `target`, upright.
fn look_at(eye: &Point3<f64>, target: &Point3<f64>) -> Pose {
    let forward = (target - eye).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let right = forward.cross(&Vector3::z()).try_normalize(1e-9).unwrap_or_else(Vector3::y);
    let down = forward.cross(&right);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
    Pose::from_parts(
        Translation3::from(eye.coords),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}
