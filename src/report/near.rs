//! What of a scene is near enough to the robot's way to be worth showing.

use std::sync::Arc;

use akrobat_model::Pose;
use akrobat_renderer::{BodyGroup, FrameState, RenderBody, RenderScene};
use nalgebra::{Point3, Vector3};

/// Distance from the way of tool and base within which bodies count as near, metres.
const NEAR_M: f64 = 1.2;
/// Triangles of the scene that go into a GLB.
pub const GLB_TRIANGLES: usize = 120_000;
/// Classes of bodies that would hide everything else from a viewer outside.
const ENCLOSURES: [&str; 3] = ["wall", "ceiling", "exterior"];

/// Places of the scene's bodies near the way of tool and base, nearest first, as far as their triangles
/// are at most `triangles`.
pub fn bodies(scene: &RenderScene, states: &[FrameState], triangles: usize) -> Vec<usize> {
    let way: Vec<Point3<f64>> = states
        .iter()
        .step_by(5)
        .flat_map(|state| [state.world_from_tool, state.world_from_base])
        .map(|pose| pose.translation.vector.into())
        .collect();
    let mut ranked: Vec<(f64, usize)> = scene
        .bodies
        .iter()
        .enumerate()
        .filter(|(_, body)| body.group == BodyGroup::Scene && !encloses(body))
        .map(|(place, body)| (distance(body, &states[0].world_from_body[place], &way), place))
        .filter(|(distance_m, _)| *distance_m <= NEAR_M)
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut left = triangles;
    let mut near = Vec::new();
    for (_, place) in ranked {
        let own: usize = scene.bodies[place].meshes.iter().map(|m| m.triangles.len()).sum();
        if own <= left {
            left -= own;
            near.push(place);
        }
    }
    near
}

fn encloses(body: &RenderBody) -> bool {
    let class = body.class.to_lowercase();
    ENCLOSURES.iter().any(|enclosure| class.contains(enclosure))
}

/// Least distance of the way from the body's box in its own frame, metres.
fn distance(body: &RenderBody, world_from_body: &Pose, way: &[Point3<f64>]) -> f64 {
    let bounds: Vec<_> =
        body.meshes.iter().map(Arc::as_ref).filter_map(akrobat_model::TriMesh::bounds).collect();
    let to_box = |point: &Point3<f64>, (low, high): &([f32; 3], [f32; 3])| {
        let beyond =
            |i: usize| (f64::from(low[i]) - point[i]).max(point[i] - f64::from(high[i])).max(0.0);
        Vector3::new(beyond(0), beyond(1), beyond(2)).norm()
    };
    way.iter()
        .map(|point| world_from_body.inverse_transform_point(point))
        .flat_map(|point| bounds.iter().map(move |bounds| to_box(&point, bounds)))
        .fold(f64::INFINITY, f64::min)
}
