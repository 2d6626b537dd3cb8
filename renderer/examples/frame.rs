//! Renders one frame of a task from the `paper` rig: the robot in its resting pose before the object.
//!
//!     cargo run --release -p akrobat-renderer --example frame -- TASK.toml OUT_FOLDER [ASSET_FOLDER...]
//!
//! Writes `<camera>_{rgb,depth,segmentation}.png` and a top view of the fused cloud, and prints the time
//! an image takes.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

use akrobat_cameras::{CameraFrame, CloudPoint, Rig};
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::Task;
use akrobat_model::trajectory::{Grasp, PathSample};
use akrobat_model::{Phase, Pose};
use akrobat_renderer::handle::{Handle, handle_visibility};
use akrobat_renderer::placement::PlacedRig;
use akrobat_renderer::pointcloud::{CloudConfig, CloudPlace, fuse};
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{Backend, FrameState, RenderScene, SoftBackend};
use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Vector3};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(task), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err("expected TASK.toml OUT_FOLDER [ASSET_FOLDER...]".into());
    };
    let task = load::task(&task, &AssetSearch { folders: arguments.collect() })?;
    let scene = RenderScene::from_task(&task)?;
    println!("{}: {} bodies, {} triangles", scene.name, scene.bodies.len(), scene.triangle_count());

    let grasp = grasp_from_outside(&task);
    let replay = Replay::new(&task, &scene);
    let handle = Handle::new(&task, &grasp)?;
    let frame = before_the_object(&task, &replay, &handle);
    let rig = PlacedRig::new(
        &Rig::preset("paper")?,
        &task,
        &scene,
        &handle,
        std::slice::from_ref(&frame),
    )?;
    let cameras = rig.at(&frame);
    let mut backend = SoftBackend::new();
    let images = backend.render(&scene, &frame, &cameras)?;
    std::fs::create_dir_all(&out)?;
    for (image, visibility) in
        images.iter().zip(handle_visibility(&images, &handle.position(&frame)))
    {
        println!("{}: handle {visibility:?}", image.name);
        write_images(image, &out)?;
    }
    time_renderings(&mut backend, &scene, &frame, &cameras)?;
    let start = Instant::now();
    let place =
        CloudPlace { handle: handle.position(&frame), world_from_base: frame.world_from_base };
    let cloud = fuse(&images, &place, &CloudConfig::default()).points;
    println!("cloud of {} points: {:.1} ms", cloud.len(), 1e3 * start.elapsed().as_secs_f64());
    top_view(&cloud).save(out.join("cloud_top.png"))?;
    Ok(())
}

/// A grasp at the middle of the handle's geometry, approaching horizontally from outside the object.
fn grasp_from_outside(task: &Task) -> Grasp {
    let object = &task.object;
    let poses = object.tree.link_poses(&object.world_from_root, &object.start);
    let bounds = |link: usize, handle_only: bool| {
        let parts = object.tree.links()[link].visuals.iter().filter(move |part| {
            let matches = |p: &String| akrobat_model::task::matches_pattern(p, &part.name);
            !handle_only || object.handle_parts.iter().any(matches)
        });
        let world_from_link = poses[link];
        parts
            .flat_map(akrobat_model::Part::triangulate)
            .flat_map(|mesh| mesh.positions)
            .map(move |p| world_from_link * Point3::from(p).cast::<f64>())
            .collect::<Vec<_>>()
    };
    let everything: Vec<_> =
        (0..object.tree.links().len()).flat_map(|link| bounds(link, false)).collect();
    let handle = middle(&bounds(object.handle_link, true));
    let center = middle(&everything);
    let yaw = (object.world_from_root.rotation * Vector3::x()).xy();
    // The object's axis along which the handle stands out most.
    let out = (handle - center).xy();
    let axis = [yaw, nalgebra::Vector2::new(-yaw.y, yaw.x)]
        .into_iter()
        .flat_map(|axis| [axis, -axis])
        .max_by(|a, b| a.dot(&out).total_cmp(&b.dot(&out)))
        .unwrap_or(out);
    let look = Isometry3::face_towards(&handle, &(handle - axis.push(0.0)), &Vector3::z());
    Grasp {
        id: 0,
        link: object.tree.links()[object.handle_link].name.clone(),
        link_from_tool: poses[object.handle_link].inverse() * look,
        width_m: 0.02,
    }
}

fn middle(points: &[Point3<f64>]) -> Point3<f64> {
    let low = points.iter().fold(Point3::from([f64::INFINITY; 3]), |low, p| low.inf(p));
    let high = points.iter().fold(Point3::from([f64::NEG_INFINITY; 3]), |high, p| high.sup(p));
    nalgebra::center(&low, &high)
}

/// The robot in its resting pose, its base 1 m before the handle and facing it.
fn before_the_object(task: &Task, replay: &Replay<'_>, handle: &Handle) -> FrameState {
    let rest = replay.at_rest();
    let grasp: Pose = handle.world_from_grasp(&rest);
    let forward = grasp * Vector3::z();
    let stand = grasp.translation.vector - forward * 1.0;
    let mut robot = rest.robot;
    if task.robot.base_joints.len() == 3 {
        robot[..3].copy_from_slice(&[stand.x, stand.y, forward.y.atan2(forward.x)]);
    }
    let object = task.object.start.clone();
    replay.at_sample(0, 0.0, PathSample { robot, object, phase: Phase::Approach })
}

fn time_renderings(
    backend: &mut SoftBackend,
    scene: &RenderScene,
    frame: &FrameState,
    cameras: &[akrobat_renderer::PlacedCamera],
) -> Result<(), Box<dyn Error>> {
    const REPEATS: u32 = 40;
    for camera in cameras {
        let mut best_ms = f64::INFINITY;
        let mut sum_ms = 0.0;
        for _ in 0..REPEATS {
            let start = Instant::now();
            backend.render(scene, frame, std::slice::from_ref(camera))?;
            let ms = 1e3 * start.elapsed().as_secs_f64();
            best_ms = best_ms.min(ms);
            sum_ms += ms;
        }
        let mean_ms = sum_ms / f64::from(REPEATS);
        println!("{}: {mean_ms:.2} ms an image, {best_ms:.2} at best", camera.name);
    }
    Ok(())
}

fn write_images(image: &CameraFrame, out: &Path) -> Result<(), Box<dyn Error>> {
    let (width, height) = (image.intrinsics.width, image.intrinsics.height);
    let path = |what: &str| out.join(format!("{}_{what}.png", image.name));
    let draw = |color: &dyn Fn(usize) -> [u8; 3]| {
        RgbImage::from_fn(width, height, |u, v| Rgb(color((v * width + u) as usize)))
    };
    draw(&|at| [image.rgb[3 * at], image.rgb[3 * at + 1], image.rgb[3 * at + 2]])
        .save(path("rgb"))?;
    let farthest = image.depth_m.iter().fold(0.0f32, |far, &depth| far.max(depth));
    draw(&|at| depth_color(image.depth_m[at] / farthest)).save(path("depth"))?;
    draw(&|at| segment_color(image.segmentation[at])).save(path("segmentation"))?;
    Ok(())
}

/// Black for nothing, then warm for near and cold for far.
fn depth_color(fraction: f32) -> [u8; 3] {
    if fraction <= 0.0 {
        return [0; 3];
    }
    let bump = |center: f32| (1.5 - (4.0 * fraction - center).abs()).clamp(0.0, 1.0);
    [bump(1.0), bump(2.0), bump(3.0)].map(|v| (v * 255.0) as u8)
}

fn segment_color(id: u16) -> [u8; 3] {
    let hash = u32::from(id).wrapping_mul(0x9E37_79B1);
    if id == 0 { [0; 3] } else { [24, 16, 8].map(|shift| 64 + ((hash >> shift) as u8) / 4 * 3) }
}

/// The cloud from above, 1 cm a pixel.
fn top_view(cloud: &[CloudPoint]) -> RgbImage {
    let points: Vec<Point3<f64>> =
        cloud.iter().map(|p| Point3::new(p[0], p[1], p[2]).cast()).collect();
    let center = middle(&points);
    let mut image = RgbImage::new(600, 600);
    for (point, &[.., r, g, b]) in points.iter().zip(cloud) {
        let (u, v) = (300.0 + (point.x - center.x) * 100.0, 300.0 - (point.y - center.y) * 100.0);
        if (0.0..600.0).contains(&u) && (0.0..600.0).contains(&v) {
            image.put_pixel(u as u32, v as u32, Rgb([r as u8, g as u8, b as u8]));
        }
    }
    image
}
