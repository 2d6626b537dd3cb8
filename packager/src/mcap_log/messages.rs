//! Observations as ROS 2 messages.

use akrobat_cameras::{CameraFrame, CloudPoint, Distortion, Intrinsics};
use akrobat_model::Pose;

use super::cdr::CdrWriter;
use crate::episode::millimetres;

/// Name of the world frame.
pub(crate) const WORLD: &str = "world";

/// `FLOAT32` and `UINT32` of `sensor_msgs/msg/PointField`.
const FLOAT32: u8 = 7;
const UINT32: u8 = 6;

/// Name of a camera's optical frame (x right, y down, z forward).
pub(crate) fn optical_frame(camera: &str) -> String {
    format!("{camera}_optical_frame")
}

fn header(cdr: &mut CdrWriter, time_ns: u64, frame: &str) {
    const NS_PER_S: u64 = 1_000_000_000;
    cdr.i32(i32::try_from(time_ns / NS_PER_S).unwrap_or(i32::MAX));
    cdr.u32((time_ns % NS_PER_S) as u32);
    cdr.string(frame);
}

/// `sensor_msgs/msg/CompressedImage`; `format` is `png` or `jpeg`.
pub(crate) fn compressed_image(time_ns: u64, camera: &str, format: &str, data: &[u8]) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    header(&mut cdr, time_ns, &optical_frame(camera));
    cdr.string(format);
    cdr.byte_sequence(data);
    cdr.finish()
}

/// `sensor_msgs/msg/Image` of encoding `16UC1`: millimetres, 0 where invalid (REP 118).
pub(crate) fn depth_image(time_ns: u64, images: &CameraFrame) -> Vec<u8> {
    let data: Vec<u8> = images.depth_m.iter().flat_map(|&d| millimetres(d).to_le_bytes()).collect();
    let Intrinsics { width, height, .. } = images.intrinsics;
    let mut cdr = CdrWriter::new();
    header(&mut cdr, time_ns, &optical_frame(&images.name));
    cdr.u32(height);
    cdr.u32(width);
    cdr.string("16UC1");
    cdr.u8(0);
    cdr.u32(2 * width);
    cdr.byte_sequence(&data);
    cdr.finish()
}

/// Name and coefficients of a lens as `sensor_msgs/msg/CameraInfo` has them.
fn ros_distortion(lens: &Distortion) -> (&'static str, Vec<f64>) {
    match lens {
        Distortion::Pinhole => ("plumb_bob", vec![0.0; 5]),
        Distortion::BrownConrady(_) => ("rational_polynomial", lens.coefficients()),
        Distortion::KannalaBrandt(_) => ("equidistant", lens.coefficients()),
    }
}

/// `sensor_msgs/msg/CameraInfo`.
///
/// ROS places pixel centres at integers, this project at integer + 0.5: the principal point differs
/// by half a pixel.
pub(crate) fn camera_info(time_ns: u64, images: &CameraFrame) -> Vec<u8> {
    let Intrinsics { width, height, fx, fy, cx, cy } = images.intrinsics;
    let (cx, cy) = (cx - 0.5, cy - 0.5);
    let mut cdr = CdrWriter::new();
    header(&mut cdr, time_ns, &optical_frame(&images.name));
    cdr.u32(height);
    cdr.u32(width);
    let (model, coefficients) = ros_distortion(&images.distortion);
    cdr.string(model);
    cdr.f64_sequence(coefficients.into_iter());
    cdr.f64_array(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    cdr.f64_array(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    cdr.f64_array(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // Binning and region of interest: the whole image.
    for _ in 0..6 {
        cdr.u32(0);
    }
    cdr.bool(false);
    cdr.finish()
}

/// `sensor_msgs/msg/PointCloud2`: `x y z` f32 metres and `rgb` packed as `0x00RRGGBB`.
pub(crate) fn point_cloud(time_ns: u64, frame: &str, cloud: &[CloudPoint]) -> Vec<u8> {
    const POINT_BYTES: u32 = 16;
    let pack = |[x, y, z, r, g, b]: CloudPoint| {
        // Colours are 0..255; casts saturate.
        let [r, g, b] = [r, g, b].map(|c| u32::from(c.round() as u8));
        [x.to_le_bytes(), y.to_le_bytes(), z.to_le_bytes(), (r << 16 | g << 8 | b).to_le_bytes()]
    };
    let data: Vec<u8> = cloud.iter().flat_map(|&p| pack(p)).flatten().collect();
    let mut cdr = CdrWriter::new();
    header(&mut cdr, time_ns, frame);
    cdr.u32(1);
    cdr.length(cloud.len());
    cdr.length(4);
    for (index, (name, datatype)) in
        [("x", FLOAT32), ("y", FLOAT32), ("z", FLOAT32), ("rgb", UINT32)].into_iter().enumerate()
    {
        cdr.string(name);
        cdr.u32(4 * index as u32);
        cdr.u8(datatype);
        cdr.u32(1);
    }
    cdr.bool(false);
    cdr.u32(POINT_BYTES);
    cdr.length(data.len());
    cdr.byte_sequence(&data);
    cdr.bool(true);
    cdr.finish()
}

/// `tf2_msgs/msg/TFMessage` of frames below the world.
pub(crate) fn transforms(time_ns: u64, world_from_frame: &[(String, Pose)]) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    cdr.length(world_from_frame.len());
    for (name, pose) in world_from_frame {
        header(&mut cdr, time_ns, WORLD);
        cdr.string(name);
        let (t, q) = (pose.translation.vector, pose.rotation.into_inner());
        cdr.f64_array(&[t.x, t.y, t.z, q.i, q.j, q.k, q.w]);
    }
    cdr.finish()
}

/// `sensor_msgs/msg/JointState` with positions alone.
pub(crate) fn joint_state(time_ns: u64, names: &[&str], positions: &[f64]) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    header(&mut cdr, time_ns, WORLD);
    cdr.length(names.len());
    names.iter().for_each(|name| cdr.string(name));
    cdr.f64_sequence(positions.iter().copied());
    cdr.length(0);
    cdr.length(0);
    cdr.finish()
}
