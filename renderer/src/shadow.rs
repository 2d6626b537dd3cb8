//! Where the shadows of lights are drawn from: the part of shadow mapping that all backends share (Williams, *Casting
//! Curved Shadows on Curved Surfaces*, SIGGRAPH 1978).

use akrobat_cameras::Intrinsics;
use akrobat_model::Pose;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::lighting::{Shadow, Source, WorldLight};
use crate::{BodyGroup, FrameState, PlacedCamera, RenderScene};

/// Distance of directional lights when shadows are drawn, metres: rays to it are parallel to within a milliradian over
/// two metres, and single precision still tells a quarter of a millimetre apart.
const DISTANT_M: f64 = 2000.0;

/// Receivers are moved off their surface by this many texels of the map along the normal.
pub(crate) const NORMAL_OFFSET_TEXELS: f32 = 2.0;

/// Receivers are moved towards the light by this, metres.
pub(crate) const BIAS_M: f32 = 0.003;

/// The maps of one light: one, or six around a point light.
#[derive(Debug, Clone)]
pub(crate) struct LightMaps {
    /// Cameras at the light: square images, principal point in the middle.
    pub cameras: Vec<PlacedCamera>,
    /// Which bodies cast shadows.
    pub casters: Vec<bool>,
}

/// For each light of a scene (all in the world's frame) its maps; `None` where it casts no shadows.
pub(crate) fn light_maps(
    scene: &RenderScene,
    frame: &FrameState,
    lights: &[WorldLight],
) -> Vec<Option<LightMaps>> {
    lights.iter().map(|light| maps_of(scene, frame, light)).collect()
}

fn maps_of(scene: &RenderScene, frame: &FrameState, light: &WorldLight) -> Option<LightMaps> {
    let casts = |group: BodyGroup| match light.shadow {
        Shadow::None => false,
        Shadow::Moving => group != BodyGroup::Scene,
        Shadow::All => true,
    };
    let casters: Vec<bool> = scene.bodies.iter().map(|body| casts(body.group)).collect();
    let (center, radius_m) = bounds(scene, frame, &casters)?;
    let pixels = scene.lighting.shadow_map_pixels;
    let camera = |eye: Point3<f64>, forward: Vector3<f64>, focal: f64, near_m: f64| PlacedCamera {
        name: "light".into(),
        intrinsics: Intrinsics {
            width: pixels,
            height: pixels,
            fx: focal,
            fy: focal,
            cx: f64::from(pixels) / 2.0,
            cy: f64::from(pixels) / 2.0,
        },
        near_m,
        far_m: 1e5,
        world_from_camera: looking(&eye, &forward),
        normals: false,
    };
    let half = f64::from(pixels) / 2.0;
    let cameras = match light.source {
        Source::Directional(to_light) => {
            let eye = center + to_light * DISTANT_M;
            vec![camera(eye, -to_light, half * DISTANT_M / (1.01 * radius_m), 1.0)]
        }
        Source::Spot(eye, axis, [_, outer]) => {
            let tangent = (1.0 - outer * outer).sqrt() / outer;
            vec![camera(eye, axis, half / (1.02 * tangent), 0.02)]
        }
        Source::Point(eye) => [Vector3::x(), Vector3::y(), Vector3::z()]
            .into_iter()
            .flat_map(|axis| [axis, -axis])
            // A little wider than the cube's face, so that filtering finds neighbours at its edges.
            .map(|axis| camera(eye, axis, half / 1.02, 0.02))
            .collect(),
    };
    Some(LightMaps { cameras, casters })
}

/// A sphere around the casters in the world; `None` without any.
fn bounds(scene: &RenderScene, frame: &FrameState, casters: &[bool]) -> Option<(Point3<f64>, f64)> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let spheres = scene.body_spheres().iter().zip(&frame.world_from_body).zip(casters);
    for ((sphere, world_from_body), _) in spheres.filter(|(_, casts)| **casts) {
        let Some((center, radius_m)) = sphere else { continue };
        let center = world_from_body * center;
        for axis in 0..3 {
            low[axis] = low[axis].min(center[axis] - radius_m);
            high[axis] = high[axis].max(center[axis] + radius_m);
        }
    }
    let (low, high) = (Point3::from(low), Point3::from(high));
    (low.x <= high.x).then(|| (nalgebra::center(&low, &high), (high - low).norm() / 2.0))
}

/// A camera at `eye` that looks along a unit vector.
fn looking(eye: &Point3<f64>, forward: &Vector3<f64>) -> Pose {
    let up = if forward.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let right = forward.cross(&up).normalize();
    let down = forward.cross(&right);
    let rotation =
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, *forward]));
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    Pose::from_parts(Translation3::from(eye.coords), rotation)
}
