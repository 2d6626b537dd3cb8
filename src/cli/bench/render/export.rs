//! The benchmark's scene in files that other renderers read.

use std::fmt::Write as _;
use std::path::Path;

use akrobat_model::pose::to_xyz_wxyz;
use akrobat_renderer::{Backend, FrameState, PlacedCamera, RenderBody, RenderScene, SoftBackend};
use serde_json::json;

use crate::Error;

/// Writes `body_<segment id>.obj` for each body, in its frame, `frames.json`, and `depth_<frame>_<camera>.f32` for each
/// image (little-endian, metres). Returns the number of triangles.
pub fn write(
    folder: &Path,
    scene: &RenderScene,
    frames: &[(FrameState, Vec<PlacedCamera>)],
) -> Result<usize, Error> {
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, &e))?;
    let mut triangles = 0;
    for body in scene.bodies.iter() {
        let path = folder.join(format!("body_{}.obj", body.segment_id));
        std::fs::write(&path, obj(body)).map_err(|e| Error::write(&path, &e))?;
        triangles += body.meshes.iter().map(|mesh| mesh.triangles.len()).sum::<usize>();
    }
    let bodies: Vec<_> = scene
        .bodies
        .iter()
        .map(|body| {
            let color = body.meshes.first().map_or([0.7; 4], |mesh| mesh.material.base_color);
            json!({ "segment_id": body.segment_id, "name": body.name, "color": color })
        })
        .collect();
    let instants: Vec<_> = frames
        .iter()
        .map(|(frame, cameras)| {
            let cameras: Vec<_> = cameras
                .iter()
                .map(|camera| {
                    json!({
                        "name": camera.name,
                        "width": camera.intrinsics.width,
                        "height": camera.intrinsics.height,
                        "K": camera.intrinsics.matrix(),
                        "near_m": camera.near_m,
                        "far_m": camera.far_m,
                        "world_from_camera": to_xyz_wxyz(&camera.world_from_camera),
                    })
                })
                .collect();
            let poses: Vec<_> = frame.world_from_body.iter().map(to_xyz_wxyz).collect();
            json!({ "world_from_body": poses, "cameras": cameras })
        })
        .collect();
    let mut backend = SoftBackend::new();
    for (number, (frame, cameras)) in frames.iter().enumerate() {
        for (camera, image) in backend.render(scene, frame, cameras)?.iter().enumerate() {
            let path = folder.join(format!("depth_{number}_{camera}.f32"));
            let bytes: Vec<u8> = image.depth_m.iter().flat_map(|d| d.to_le_bytes()).collect();
            std::fs::write(&path, bytes).map_err(|e| Error::write(&path, &e))?;
        }
    }
    let path = folder.join("frames.json");
    let text = json!({ "scene": scene.name, "bodies": bodies, "frames": instants }).to_string();
    std::fs::write(&path, text).map_err(|e| Error::write(&path, &e))?;
    Ok(triangles)
}

/// All meshes of a body, without materials.
fn obj(body: &RenderBody) -> String {
    let mut text = String::new();
    let mut first = 1;
    // Writing into a string cannot fail.
    for mesh in &body.meshes {
        for [x, y, z] in &mesh.positions {
            let _ = writeln!(text, "v {x} {y} {z}");
        }
        for [a, b, c] in &mesh.triangles {
            let _ = writeln!(text, "f {} {} {}", a + first, b + first, c + first);
        }
        first += mesh.positions.len() as u32;
    }
    text
}
