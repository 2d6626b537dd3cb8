//! A small synthetic dataset: two cameras look at a ball that rolls over a checkered floor.

use std::path::Path;

use akrobat_cameras::{
    CameraFrame, CameraMount, CameraSpec, Intrinsics, Modality, Observation, Rig, SegmentLabel,
};
use akrobat_model::robot::BaseKind;
use akrobat_model::{Phase, Pose, pose};
use akrobat_packager::dataset::{Container, Licence, Status};
use akrobat_packager::error::Result;
use akrobat_packager::{
    Attachment, CloudLayout, DatasetConfig, DatasetWriter, EpisodeInfo, StorageConfig,
};
use nalgebra::{Point3, Vector3};

/// Episodes that are stored.
pub const EPISODES: u32 = 5;

/// Frames of every episode: more than are encoded together.
pub const FRAMES: u32 = 11;

const CLOUD_POINTS: usize = 256;
const BALL_RADIUS_M: f64 = 0.3;
const FLOOR_ID: u16 = 1;
const BALL_ID: u16 = 2;

/// Shards of two episodes.
pub fn config(container: Container) -> DatasetConfig {
    DatasetConfig {
        container,
        storage: StorageConfig { episodes_per_shard: 2, ..StorageConfig::default() },
        licences: vec![Licence {
            asset: "ball".into(),
            license: "CC0-1.0".into(),
            source: "synthetic".into(),
        }],
        provenance: serde_json::json!({"generator": "sample"}),
        ..DatasetConfig::new("sample", rig())
    }
}

fn rig() -> Rig {
    let camera = |name: &str, width, height| CameraSpec {
        width,
        height,
        ..CameraSpec::new(name, 18.0, CameraMount::LookAtHandle { offset: [2.0, 0.0, 1.5] })
    };
    Rig { name: "two".into(), cameras: vec![camera("fixed", 64, 48), camera("wrist", 32, 24)] }
}

/// What is known of episode `index`.
pub fn info(index: u32) -> EpisodeInfo {
    let label = |id, name: &str| SegmentLabel {
        id,
        group: "scene".into(),
        name: name.into(),
        class: name.into(),
    };
    EpisodeInfo {
        id: format!("episode-{index:04}"),
        success: true,
        seed: u64::MAX - u64::from(index),
        traj_index: index,
        frames: FRAMES,
        frame_rate_hz: 30.0,
        grasp_id: 3,
        grasp_link: "door joint_0".into(),
        link_from_tool: pose::from_xyz_rpy([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
        start: 0.0,
        goal: 1.25,
        scene_id: "floor".into(),
        object_id: "ball".into(),
        robot_id: "robot".into(),
        base_kind: BaseKind::Holonomic,
        robot_joints: ["base_x", "base_y", "base_theta", "arm", "finger_1", "finger_2"]
            .map(String::from)
            .into(),
        finger_joints: 2,
        object_joints: vec!["roll".into()],
        active_joint: "roll".into(),
        world_from_robot_root: Pose::identity(),
        rig: rig(),
        modalities: Modality::DEFAULT.to_vec(),
        cloud_points: CLOUD_POINTS,
        cloud: CloudLayout::default(),
        labels: vec![label(FLOOR_ID, "floor"), label(BALL_ID, "ball")],
        task_toml: "name = \"sample\"\n".into(),
        provenance: serde_json::json!({"index": index}),
        attachments: vec![Attachment {
            name: "robot.urdf".into(),
            media_type: "application/xml".into(),
            content: b"<robot name=\"robot\"/>".to_vec(),
        }],
    }
}

/// Frame `frame` of episode `index`.
pub fn observation(index: u32, frame: u32) -> Observation {
    let time_s = f64::from(frame) / 30.0;
    let phase = if frame < 4 { Phase::Approach } else { Phase::Manipulate };
    let ball = Point3::new(1.5 * time_s - 0.3, 0.1 * f64::from(index), BALL_RADIUS_M);
    let cameras = vec![
        camera_frame("fixed", 64, 48, Point3::new(2.0, 0.3, 1.2), ball),
        camera_frame("wrist", 32, 24, Point3::new(1.2 - time_s, -0.8, 0.9), ball),
    ];
    let cloud = cloud(&cameras[0]);
    Observation {
        frame,
        time_s,
        phase,
        cameras,
        cloud,
        cloud_normals: Vec::new(),
        robot: (0..6).map(|c| (time_s * f64::from(c + 1) + f64::from(index)).sin()).collect(),
        object: vec![time_s],
        world_from_tool: pose::from_xyz_rpy([time_s, 0.0, 1.0], [3.0, 0.1, time_s]),
        world_from_base: pose::from_xyz_rpy([time_s, 0.5, 0.0], [0.0, 0.0, time_s]),
        world_from_object: Pose::translation(0.5, 0.0, 0.0),
    }
}

/// Traces one ray a pixel: exact depth, colours and segments.
fn camera_frame(
    name: &str,
    width: u32,
    height: u32,
    eye: Point3<f64>,
    ball: Point3<f64>,
) -> CameraFrame {
    let intrinsics = Intrinsics::from_focal_length(width, height, 18.0, 20.955);
    let world_from_camera = looking(eye, ball);
    let mut images = CameraFrame::new(name, intrinsics, world_from_camera);
    for (v, u) in (0..height).flat_map(|v| (0..width).map(move |u| (v, u))) {
        // With z = 1 in the camera frame, the ray's parameter is the z-depth.
        let ray = world_from_camera.rotation * Vector3::from(intrinsics.unproject(u, v, 1.0));
        let (depth, color, id) = trace(eye, ray, ball);
        images.depth_m.push(depth as f32);
        images.rgb.extend(color);
        images.segmentation.push(id);
    }
    images
}

fn looking(eye: Point3<f64>, target: Point3<f64>) -> Pose {
    // `face_towards` points z at the target and y along `up`; the camera's y points down.
    Pose::face_towards(&eye, &target, &-Vector3::z())
}

fn trace(eye: Point3<f64>, ray: Vector3<f64>, ball: Point3<f64>) -> (f64, [u8; 3], u16) {
    let (to_ball, a) = (eye - ball, ray.norm_squared());
    let b = to_ball.dot(&ray);
    let discriminant = b * b - a * (to_ball.norm_squared() - BALL_RADIUS_M * BALL_RADIUS_M);
    if discriminant > 0.0 {
        let depth = (-b - discriminant.sqrt()) / a;
        let shade = ((eye + ray * depth - ball).z / BALL_RADIUS_M * 60.0 + 150.0) as u8;
        return (depth, [shade, 40, 30], BALL_ID);
    }
    let depth = -eye.z / ray.z;
    if depth <= 0.0 || depth > 20.0 {
        return (0.0, [120, 160, 220], 0);
    }
    let hit = eye + ray * depth;
    let dark = (hit.x.floor() + hit.y.floor()).rem_euclid(2.0) < 1.0;
    (depth, if dark { [70, 70, 75] } else { [190, 190, 180] }, FLOOR_ID)
}

fn cloud(images: &CameraFrame) -> Vec<[f32; 6]> {
    let width = images.intrinsics.width as usize;
    let seen: Vec<usize> = (0..images.depth_m.len()).filter(|&i| images.depth_m[i] > 0.0).collect();
    let point = |k: usize| {
        let pixel = seen[k * seen.len() / CLOUD_POINTS];
        let (u, v) = ((pixel % width) as u32, (pixel / width) as u32);
        let depth_m = f64::from(images.depth_m[pixel]);
        let in_camera = Point3::from(images.intrinsics.unproject(u, v, depth_m));
        let p = (images.world_from_camera * in_camera).cast::<f32>();
        let [r, g, b] = [0, 1, 2].map(|c| f32::from(images.rgb[3 * pixel + c]));
        [p.x, p.y, p.z, r, g, b]
    };
    (0..CLOUD_POINTS).map(point).collect()
}

/// Writes or resumes the whole dataset; `pause` is called before every frame.
pub fn write(folder: &Path, container: Container, pause: impl Fn()) -> Result<()> {
    let mut writer = DatasetWriter::resume(folder, config(container))?;
    for index in 0..EPISODES {
        let info = info(index);
        if index == 3 && !writer.contains("refused") {
            writer.skip_episode("refused", Status::Filtered, "position_limit: joint arm")?;
        }
        if writer.contains(&info.id) {
            continue;
        }
        writer.begin_episode(info)?;
        for frame in 0..FRAMES {
            pause();
            writer.push(observation(index, frame))?;
        }
        writer.finish_episode()?;
    }
    writer.close()
}
