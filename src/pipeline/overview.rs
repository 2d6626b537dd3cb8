//! Pictures of scenes and objects as a whole, by the `soft` renderer.

use std::path::Path;
use std::sync::Arc;

use akrobat_assets::import::floor;
use akrobat_cameras::Intrinsics;
use akrobat_model::mesh_io::gltf;
use akrobat_model::{KinematicTree, Link, Material, Part, Pose, Shape, TriMesh};
use akrobat_renderer::scene::UnnumberedBody;
use akrobat_renderer::{Backend, BodyGroup, FrameState, PlacedCamera, RenderScene, SoftBackend};
use image::{RgbImage, imageops};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::Error;
use crate::report::picture;

/// Size that is drawn, and the size that is kept: the difference smooths edges.
const DRAWN: [u32; 2] = [640, 480];
const KEPT: [u32; 2] = [320, 240];
const FIELD_OF_VIEW_RAD: f64 = 0.75;
/// What reaches higher is not drawn of imported rooms, metres.
const CUT_M: f64 = 2.05;
/// Walls that stand between the camera and the room, and what hangs in them.
const LEFT_OUT: [&str; 3] = ["wall_3", "wall_4", "door_1"];

/// A generated scene from above, from the south-east; the walls before it are left out.
pub fn scene_picture(glb: &Path) -> Result<RgbImage, Error> {
    let scene = gltf::load_scene(glb)?;
    let nodes = scene.nodes.into_iter().filter(|node| !LEFT_OUT.contains(&node.name.as_str()));
    let bodies = nodes
        .map(|node| {
            (node.name, node.world_from_node, node.meshes.into_iter().map(Arc::new).collect())
        })
        .collect();
    draw(bodies, Vector3::new(0.75, -0.85, 1.15))
}

/// An imported scene from above; ceilings, roofs and walls are cut away.
pub fn room_picture(
    bodies: impl Iterator<Item = (String, Pose, Vec<Part>)>,
) -> Result<RgbImage, Error> {
    let body = |(name, pose, parts): (String, Pose, Vec<Part>)| {
        let meshes = parts.iter().flat_map(Part::triangulate).map(|mesh| cut(mesh, &pose));
        let meshes: Vec<_> = meshes.filter(|m| !m.triangles.is_empty()).map(Arc::new).collect();
        (name, pose, meshes)
    };
    let bodies = bodies.map(body);
    draw(
        bodies.filter(|(_, _, meshes)| !meshes.is_empty()).collect(),
        Vector3::new(0.45, -0.6, 1.3),
    )
}

/// A mesh without the triangles that reach above [`CUT_M`], and without what only those need.
fn cut(mesh: TriMesh, world_from_mesh: &Pose) -> TriMesh {
    let low = |index: u32| {
        let position = mesh.positions[index as usize].map(f64::from);
        (world_from_mesh * Point3::from(position)).z < CUT_M
    };
    let kept: Vec<[u32; 3]> =
        mesh.triangles.iter().copied().filter(|corners| corners.iter().all(|&c| low(c))).collect();
    floor::with_triangles(&mesh, &kept)
}

/// A gripper's outline with its tool frame's origin between the pads, z along the approach, y along the closing
/// direction: two fingers, a palm and a wrist, as boxes of size and middle, metres.
const GRIPPER: [[[f64; 3]; 2]; 4] = [
    [[0.008, 0.006, 0.05], [0.0, 0.043, -0.015]],
    [[0.008, 0.006, 0.05], [0.0, -0.043, -0.015]],
    [[0.008, 0.092, 0.008], [0.0, 0.0, -0.044]],
    [[0.008, 0.008, 0.05], [0.0, 0.0, -0.073]],
];

/// An object from its front with a gripper at every grasp, closed; the best ones greenest.
pub fn grasps_picture(
    tree: &KinematicTree,
    handle_link: usize,
    grasps: &[Pose],
) -> Result<RgbImage, Error> {
    let q = tree.neutral();
    let poses = tree.link_poses(&Pose::identity(), &q);
    let mut bodies = object_bodies(tree, &poses);
    for (index, link_from_tool) in grasps.iter().enumerate() {
        let share = index as f32 / grasps.len().max(1) as f32;
        let material = Material {
            base_color: [0.1 + 0.8 * share, 0.75 - 0.5 * share, 0.2, 1.0],
            ..Material::default()
        };
        let shapes = GRIPPER.iter().flat_map(|[size, [x, y, z]]| {
            let part = Part {
                name: "gripper".into(),
                link_from_part: Pose::translation(*x, *y, *z),
                shape: Shape::Box { size: *size },
                material: Some(material.clone()),
            };
            part.triangulate()
        });
        let meshes = shapes.map(Arc::new).collect();
        bodies.push((format!("grasp_{index}"), poses[handle_link] * link_from_tool, meshes));
    }
    draw(bodies, Vector3::new(1.0, -0.75, 0.55))
}

/// An object from its front, its joints at a configuration.
pub fn object_picture(tree: &KinematicTree, q: &[f64]) -> Result<RgbImage, Error> {
    let poses = tree.link_poses(&Pose::identity(), q);
    draw(object_bodies(tree, &poses), Vector3::new(1.0, -0.75, 0.55))
}

fn object_bodies(tree: &KinematicTree, poses: &[Pose]) -> Vec<(String, Pose, Vec<Arc<TriMesh>>)> {
    let body = |(link, pose): (&Link, &Pose)| {
        let parts = if link.visuals.is_empty() { &link.collisions } else { &link.visuals };
        let meshes = parts.iter().flat_map(Part::triangulate);
        (link.name.clone(), *pose, meshes.map(Arc::new).collect())
    };
    tree.links().iter().zip(poses).map(body).collect()
}

/// Bodies by name, with poses and meshes, seen from a direction at the distance that holds all of them.
fn draw(
    bodies: Vec<(String, Pose, Vec<Arc<TriMesh>>)>,
    from: Vector3<f64>,
) -> Result<RgbImage, Error> {
    let points = bodies.iter().flat_map(|(_, pose, meshes)| {
        let vertices = meshes.iter().flat_map(|mesh| mesh.positions.iter());
        vertices.map(move |p| pose * Point3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])))
    });
    let world_from_camera = framing(&points.collect::<Vec<_>>(), from);
    let world_from_body = bodies.iter().map(|(_, pose, _)| *pose).collect();
    let unnumbered: Vec<UnnumberedBody> = bodies
        .into_iter()
        .enumerate()
        .map(|(index, (name, _, meshes))| (BodyGroup::Scene, name.clone(), name, index, meshes))
        .collect();
    let scene = RenderScene::new("overview".into(), unnumbered)?;
    let camera = PlacedCamera {
        name: "overview".into(),
        intrinsics: Intrinsics::from_horizontal_fov(DRAWN[0], DRAWN[1], FIELD_OF_VIEW_RAD),
        near_m: 0.05,
        far_m: 60.0,
        world_from_camera,
        normals: false,
    };
    let frames =
        SoftBackend::new().render(&scene, &FrameState::of_bodies(world_from_body), &[camera])?;
    let drawn = frames.first().map(picture::color).unwrap_or_default();
    Ok(imageops::resize(&drawn, KEPT[0], KEPT[1], imageops::FilterType::Triangle))
}

/// Pose of a camera (x right, y down, z forward) that looks at the points' middle and sees them all.
fn framing(points: &[Point3<f64>], from: Vector3<f64>) -> Pose {
    let fold = |pick: fn(f64, f64) -> f64, start: f64| {
        Vector3::from_fn(|axis, _| points.iter().map(|p| p[axis]).fold(start, pick))
    };
    let (low, high) = (fold(f64::min, f64::INFINITY), fold(f64::max, f64::NEG_INFINITY));
    let middle = (low + high) / 2.0;
    let z = -from.normalize();
    let x = z.cross(&Vector3::z()).normalize();
    let y = z.cross(&x);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    let tangent = (FIELD_OF_VIEW_RAD / 2.0).tan();
    let aspect = f64::from(DRAWN[1]) / f64::from(DRAWN[0]);
    let needed = |p: &Point3<f64>| {
        let offset = p.coords - middle;
        let across =
            (offset.dot(&x).abs() / tangent).max(offset.dot(&y).abs() / (tangent * aspect));
        across - offset.dot(&z)
    };
    let distance = points.iter().map(needed).fold(0.1, f64::max) * 1.04;
    let eye = middle - z * distance;
    Pose::from_parts(Translation3::from(eye), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Pictures of one size side by side, about as wide as high.
pub fn sheet(pictures: &[RgbImage], columns: usize) -> RgbImage {
    let [width, height] = pictures.first().map_or([1, 1], |p| [p.width(), p.height()]);
    let rows = pictures.len().div_ceil(columns.max(1)).max(1);
    let mut sheet = RgbImage::new(width * columns as u32, height * rows as u32);
    for (index, picture) in pictures.iter().enumerate() {
        let (column, row) = (index % columns, index / columns);
        imageops::replace(
            &mut sheet,
            picture,
            i64::from(width) * column as i64,
            i64::from(height) * row as i64,
        );
    }
    sheet
}

/// A contact sheet; pictures become smaller where there are many.
pub fn write_sheet(path: &Path, pictures: &[RgbImage]) -> Result<(), Error> {
    let columns = (pictures.len() as f64).sqrt().ceil() as usize;
    let width = (2560 / columns.max(1) as u32).clamp(96, KEPT[0]);
    let height = width * KEPT[1] / KEPT[0];
    let small: Vec<RgbImage> = pictures
        .iter()
        .map(|p| imageops::resize(p, width, height, imageops::FilterType::Triangle))
        .collect();
    sheet(&small, columns)
        .save(path)
        .map_err(|e| Error::Failed(format!("{}: cannot write: {e}", path.display())))
}
