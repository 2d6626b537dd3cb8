//! What the shaders read, byte for byte.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use nalgebra::{Matrix3, Vector3};

use crate::collision::RobotBody;
use crate::esdf::Esdf;
use crate::kernels::chain;
use crate::kinematics::{Frame, Kinematics, MAX_VARIABLES, Motion};
use crate::world::World;

/// Parent of a joint that hangs from the world.
pub(super) const NO_NODE: u32 = u32::MAX;
/// Entries of a symmetric matrix over the variables.
pub(super) const TRIANGLE: usize = MAX_VARIABLES * (MAX_VARIABLES + 1) / 2;
/// Most directions that a constraint of six rows leaves free.
pub(super) const MAX_FREE: usize = MAX_VARIABLES - 6;

/// `Frame` of `chain.wgsl`: columns x, y, z and the origin.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct DeviceFrame([[f32; 4]; 4]);

impl From<&Frame> for DeviceFrame {
    fn from(frame: &Frame) -> Self {
        let column = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32, 0.0];
        let rotation = |i: usize| column(frame.rotation.column(i).into_owned());
        Self([rotation(0), rotation(1), rotation(2), column(frame.translation)])
    }
}

impl From<&DeviceFrame> for Frame {
    fn from(frame: &DeviceFrame) -> Self {
        let column = |i: usize| Vector3::from_fn(|row, _| f64::from(frame.0[i][row]));
        Self {
            rotation: Matrix3::from_columns(&[column(0), column(1), column(2)]),
            translation: column(3),
        }
    }
}

/// `Joint` of `chain.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Joint {
    x: [f32; 3],
    parent: u32,
    y: [f32; 3],
    slides: u32,
    z: [f32; 3],
    lower: f32,
    origin: [f32; 3],
    upper: f32,
    moved_by: u32,
    pub(super) velocity_weight: f32,
    pub(super) acceleration_weight: f32,
    pub(super) mobility: f32,
}

/// `Problem` of `chain.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Problem {
    pub(super) node_from_end: DeviceFrame,
    pub(super) world_from_goal: DeviceFrame,
    pub(super) first_joint: u32,
    pub(super) dof: u32,
    pub(super) end_node: u32,
    pub(super) object_q: f32,
    pub(super) slot: u32,
    pub(super) round: u32,
    pub(super) iteration: u32,
    pub(super) done: u32,
    pub(super) failed: u32,
    pub(super) taken: u32,
    pub(super) damping: f32,
    pub(super) cost: f32,
}

/// `Configuration` of `chain.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Configuration {
    pub(super) x: [f32; MAX_VARIABLES],
    pub(super) squared: f32,
    pub(super) clearance: f32,
}

/// `Link` of `collision.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Link {
    center: [f32; 3],
    radius: f32,
    node: u32,
    first: u32,
    last: u32,
    flags: u32,
}

/// `Field` of `esdf.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Field {
    origin: [f32; 3],
    voxel_m: f32,
    size: [u32; 3],
    first: u32,
}

/// `Scene` of `collision.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Scene {
    resting: Field,
    moving: Field,
    world_from_joint: DeviceFrame,
    axis: [f32; 3],
    slides: u32,
    floor_z: f32,
    pub(super) links: u32,
    pub(super) pairs: u32,
    padding: u32,
}

/// `Waypoint` of `trajopt.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Waypoint {
    pub(super) x: [f32; MAX_VARIABLES],
    pub(super) gradient: [f32; MAX_VARIABLES],
    pub(super) hessian: [f32; TRIANGLE],
    pub(super) cost: f32,
    pub(super) largest: f32,
    held: u32,
}

/// `Reduced` of `trajopt.wgsl`: never looked at here.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Reduced {
    basis: [f32; MAX_FREE * MAX_VARIABLES],
    columns: u32,
    right: [f32; MAX_FREE],
    blocks: [[f32; MAX_FREE * MAX_FREE]; 3],
}

/// `Settings` of `trajopt.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Settings {
    pub(super) waypoints: u32,
    pub(super) iterations: u32,
    pub(super) clearance_m: f32,
    pub(super) min_clearance_m: f32,
}

fn single(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// A compiled tree for the device, whose axes are turned to z.
pub(super) struct Chain {
    pub(super) joints: Vec<Joint>,
    /// Rotation by which each node's frame has been turned.
    turned: Vec<Matrix3<f64>>,
}

impl Chain {
    pub(super) fn new(kinematics: &Kinematics) -> Self {
        let (compiled, turned) = chain::compile(kinematics);
        let limits = kinematics.lower().iter().zip(kinematics.upper());
        let joints = compiled.iter().zip(kinematics.nodes()).zip(limits).map(
            |((joint, node), (lower, upper))| Joint {
                x: joint.columns[0],
                parent: node.parent.map_or(NO_NODE, |parent| parent as u32),
                y: joint.columns[1],
                slides: u32::from(node.motion == Motion::Slide),
                z: joint.columns[2],
                lower: *lower as f32,
                origin: joint.columns[3],
                upper: *upper as f32,
                moved_by: node.moved_by,
                velocity_weight: 0.0,
                acceleration_weight: 0.0,
                mobility: 1.0,
            },
        );
        Self { joints: joints.collect(), turned }
    }

    /// A frame that hangs from a node, seen from the device's node.
    pub(super) fn hanging(&self, node: usize, node_from_end: &Frame) -> DeviceFrame {
        let back = Frame { rotation: self.turned[node].transpose(), translation: Vector3::zeros() };
        DeviceFrame::from(&back.compose(node_from_end))
    }

    /// The model's frame of a node from the device's.
    pub(super) fn restored(&self, node: usize, frame: &DeviceFrame) -> Frame {
        let frame = Frame::from(frame);
        Frame { rotation: frame.rotation * self.turned[node].transpose(), ..frame }
    }

    fn local(&self, node: usize, center: &Vector3<f64>) -> [f32; 3] {
        // What rests has no node; nothing on the device refers to it.
        let turned = self.turned.get(node);
        single(&turned.map_or(*center, |turned| turned.tr_mul(center)))
    }
}

/// A robot's spheres for the device.
pub(super) struct Body {
    pub(super) spheres: Vec<[f32; 4]>,
    pub(super) links: Vec<Link>,
    pub(super) pairs: Vec<[u32; 2]>,
}

impl Body {
    pub(super) fn new(body: &RobotBody, chain: &Chain) -> Self {
        let sphere = |s: &crate::collision::NodeSphere| {
            let [x, y, z] = chain.local(s.node, &s.center);
            [x, y, z, s.radius as f32]
        };
        let link = |(node, center, radius, range): (usize, Vector3<f64>, f64, Range<usize>)| {
            let first = &body.spheres[range.start];
            Link {
                center: chain.local(node, &center),
                radius: radius as f32,
                node: node as u32,
                first: range.start as u32,
                last: range.end as u32,
                flags: u32::from(first.on_base) | u32::from(first.on_tool) << 1,
            }
        };
        Self {
            spheres: body.spheres.iter().map(sphere).collect(),
            links: body.moving_links().map(link).collect(),
            pairs: body.moving_pairs().map(|(a, b)| [a as u32, b as u32]).collect(),
        }
    }
}

/// A world's fields: the values of both, and the scene that tells where each begins.
pub(super) fn scene(world: &World) -> (Scene, Vec<f32>) {
    let field = |field: &Esdf, first: usize| Field {
        origin: single(&field.low()),
        voxel_m: field.voxel_m() as f32,
        size: field.size().map(|count| count as u32),
        first: first as u32,
    };
    let values = [world.fixed.values(), world.moving.values()].concat();
    let scene = Scene {
        resting: field(&world.fixed, 0),
        moving: field(&world.moving, world.fixed.values().len()),
        world_from_joint: DeviceFrame::from(&world.joint.world_from_joint),
        axis: single(&world.joint.axis),
        slides: u32::from(world.joint.motion == Motion::Slide),
        floor_z: world.floor_z as f32,
        links: 0,
        pairs: 0,
        padding: 0,
    };
    (scene, values)
}
