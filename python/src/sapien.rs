//! The SAPIEN renderer: hands scenes and poses to `akrobat.sapien_backend` as arrays.

use std::sync::Arc;

use akrobat::SapienShaders;
use akrobat_cameras::CameraFrame;
use akrobat_model::{Material, Pose, TriMesh, pose};
use akrobat_renderer::lighting::{Light, Reflection, Shadow};
use akrobat_renderer::{
    Backend, FrameState, Lighting, PlacedCamera, RenderBody, RenderError, RenderScene,
};
use numpy::{PyArray, PyArrayMethods, PyReadonlyArray3, PyReadonlyArray4};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

/// Renders with SAPIEN, which keeps the last scene it was given.
pub struct SapienBackend {
    shaders: SapienShaders,
    loaded: Option<Loaded>,
}

impl SapienBackend {
    /// A backend without a scene.
    ///
    /// # Errors
    /// Where SAPIEN is not installed.
    pub fn new(shaders: SapienShaders) -> Result<Self, RenderError> {
        Python::attach(|py| {
            py.import("akrobat.sapien_backend")?.call_method0("require_sapien").map(drop)
        })
        .map_err(|error| device_error(shaders, error))?;
        Ok(Self { shaders, loaded: None })
    }
}

struct Loaded {
    bodies: Arc<[RenderBody]>,
    lighting: Lighting,
    cameras: Vec<CameraKey>,
    renderer: Py<PyAny>,
}

/// What makes SAPIEN's cameras differ besides their poses: size, K, near and far plane.
type CameraKey = (akrobat_cameras::Intrinsics, f64, f64);

fn camera_key(camera: &PlacedCamera) -> CameraKey {
    (camera.intrinsics, camera.near_m, camera.far_m)
}

impl Backend for SapienBackend {
    fn name(&self) -> &str {
        self.shaders.backend()
    }

    fn render(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, RenderError> {
        let batch = self.render_batch(scene, &[(frame.clone(), cameras.to_vec())])?;
        Ok(batch.into_iter().flatten().collect())
    }

    fn render_batch(
        &mut self,
        scene: &RenderScene,
        frames: &[(FrameState, Vec<PlacedCamera>)],
    ) -> Result<Vec<Vec<CameraFrame>>, RenderError> {
        let Some((_, cameras)) = frames.first() else { return Ok(Vec::new()) };
        Python::attach(|py| {
            let renderer = self.renderer(py, scene, cameras)?;
            render_batch(&renderer, frames)
        })
        .map_err(|error| device_error(self.shaders, error))
    }
}

impl SapienBackend {
    fn renderer<'py>(
        &mut self,
        py: Python<'py>,
        scene: &RenderScene,
        cameras: &[PlacedCamera],
    ) -> PyResult<Bound<'py, PyAny>> {
        let cameras: Vec<CameraKey> = cameras.iter().map(camera_key).collect();
        let current = self.loaded.take().filter(|loaded| {
            Arc::ptr_eq(&loaded.bodies, &scene.bodies)
                && loaded.lighting == scene.lighting
                && loaded.cameras == cameras
        });
        let loaded = match current {
            Some(loaded) => loaded,
            None => Loaded {
                renderer: open_renderer(py, scene, &cameras, self.shaders)?.unbind(),
                bodies: Arc::clone(&scene.bodies),
                lighting: scene.lighting.clone(),
                cameras,
            },
        };
        let renderer = loaded.renderer.bind(py).clone();
        self.loaded = Some(loaded);
        Ok(renderer)
    }
}

fn open_renderer<'py>(
    py: Python<'py>,
    scene: &RenderScene,
    cameras: &[CameraKey],
    shaders: SapienShaders,
) -> PyResult<Bound<'py, PyAny>> {
    let bodies = body_list(py, scene)?;
    let camera_list = PyList::empty(py);
    for (intrinsics, near_m, far_m) in cameras {
        let entry = PyDict::new(py);
        entry.set_item("width", intrinsics.width)?;
        entry.set_item("height", intrinsics.height)?;
        entry.set_item("K", intrinsics.matrix())?;
        entry.set_item("near_m", near_m)?;
        entry.set_item("far_m", far_m)?;
        camera_list.append(entry)?;
    }
    let lighting = lighting_values(py, scene)?;
    py.import("akrobat.sapien_backend")?.getattr("SapienRenderer")?.call1((
        bodies,
        camera_list,
        lighting,
        shaders.pack(),
    ))
}

/// The bodies of a scene as `akrobat.sapien_backend.Body` dictionaries.
pub fn body_list<'py>(py: Python<'py>, scene: &RenderScene) -> PyResult<Bound<'py, PyList>> {
    let bodies = PyList::empty(py);
    for body in scene.bodies.iter() {
        let meshes = PyList::empty(py);
        for (mesh, material) in body.meshes.iter().zip(&body.materials) {
            meshes.append(mesh_arrays(py, mesh, material, scene.lighting.reflection)?)?;
        }
        let entry = PyDict::new(py);
        entry.set_item("name", &body.name)?;
        entry.set_item("segment_id", body.segment_id)?;
        entry.set_item("meshes", meshes)?;
        bodies.append(entry)?;
    }
    Ok(bodies)
}

/// Lights, ambient light and background as an `akrobat.sapien_backend.Lighting` dictionary.
pub fn lighting_values<'py>(py: Python<'py>, scene: &RenderScene) -> PyResult<Bound<'py, PyDict>> {
    let lighting = PyDict::new(py);
    let lights = PyList::empty(py);
    for light in &scene.lighting.lights {
        lights.append(light_values(py, light)?)?;
    }
    lighting.set_item("lights", lights)?;
    let [sky_rgb, ground_rgb] = scene.lighting.environment.sky_and_ground();
    lighting.set_item("sky_rgb", sky_rgb)?;
    lighting.set_item("ground_rgb", ground_rgb)?;
    // As numbers: Python would take u8 for bytes.
    lighting.set_item("background_rgb", scene.lighting.background_rgb.map(u32::from))?;
    Ok(lighting)
}

/// A light (world frame) as a dictionary.
fn light_values<'py>(py: Python<'py>, light: &Light) -> PyResult<Bound<'py, PyDict>> {
    let entry = PyDict::new(py);
    let (kind, rgb, shadow) = match light {
        Light::Directional { direction, rgb, shadow, .. } => {
            entry.set_item("direction", direction)?;
            ("directional", rgb, shadow)
        }
        Light::Point { position, rgb, shadow, .. } => {
            entry.set_item("position", position)?;
            ("point", rgb, shadow)
        }
        Light::Spot { position, target, rgb, inner_deg, outer_deg, shadow, .. } => {
            entry.set_item("position", position)?;
            entry.set_item("target", target)?;
            entry.set_item("inner_deg", inner_deg)?;
            entry.set_item("outer_deg", outer_deg)?;
            ("spot", rgb, shadow)
        }
    };
    entry.set_item("kind", kind)?;
    entry.set_item("rgb", rgb)?;
    entry.set_item("shadow", *shadow != Shadow::None)?;
    Ok(entry)
}

/// A mesh as a dictionary of arrays; `normals`, `uvs` and `texture` are `None` where it has none. Surfaces are
/// matt where reflection is Lambert's.
fn mesh_arrays<'py>(
    py: Python<'py>,
    mesh: &TriMesh,
    material: &Material,
    reflection: Reflection,
) -> PyResult<Bound<'py, PyDict>> {
    let entry = PyDict::new(py);
    entry.set_item("positions", table(py, &mesh.positions)?)?;
    entry.set_item("triangles", table(py, &mesh.triangles)?)?;
    entry.set_item("normals", optional_table(py, &mesh.normals)?)?;
    entry.set_item("uvs", optional_table(py, &mesh.uvs)?)?;
    entry.set_item("base_color", material.base_color)?;
    let pbr = (reflection == Reflection::Pbr).then_some((material.metallic, material.roughness));
    entry.set_item("metallic_roughness", pbr)?;
    let texture = match &material.base_color_texture {
        Some(image) => {
            let shape = [image.height() as usize, image.width() as usize, 4];
            Some(PyArray::from_slice(py, image.as_raw()).reshape(shape)?)
        }
        None => None,
    };
    entry.set_item("texture", texture)?;
    Ok(entry)
}

fn table<'py, T: numpy::Element, const N: usize>(
    py: Python<'py>,
    rows: &[[T; N]],
) -> PyResult<Bound<'py, numpy::PyArray2<T>>> {
    PyArray::from_slice(py, rows.as_flattened()).reshape([rows.len(), N])
}

fn optional_table<'py, T: numpy::Element, const N: usize>(
    py: Python<'py>,
    rows: &[[T; N]],
) -> PyResult<Option<Bound<'py, numpy::PyArray2<T>>>> {
    if rows.is_empty() { Ok(None) } else { table(py, rows).map(Some) }
}

/// Poses as an array `[frames, N, 7]` of `x y z qw qx qy qz`.
fn pose_array<'a, 'py>(
    py: Python<'py>,
    frames: usize,
    poses: impl Iterator<Item = &'a Pose>,
) -> PyResult<Bound<'py, numpy::PyArray3<f64>>> {
    let values: Vec<f64> = poses.flat_map(pose::to_xyz_wxyz).collect();
    let count = values.len() / 7 / frames;
    PyArray::from_vec(py, values).reshape([frames, count, 7])
}

fn render_batch(
    renderer: &Bound<'_, PyAny>,
    frames: &[(FrameState, Vec<PlacedCamera>)],
) -> PyResult<Vec<Vec<CameraFrame>>> {
    let py = renderer.py();
    let bodies = frames.iter().flat_map(|(frame, _)| &frame.world_from_body);
    let cameras = frames.iter().flat_map(|(_, cameras)| cameras).map(|c| &c.world_from_camera);
    let images = renderer.call_method1(
        "render",
        (pose_array(py, frames.len(), bodies)?, pose_array(py, frames.len(), cameras)?),
    )?;
    // Per camera: colours [F, H, W, 3], depths and segment ids [F, H, W].
    type Images<'py> =
        Vec<(PyReadonlyArray4<'py, u8>, PyReadonlyArray3<'py, f32>, PyReadonlyArray3<'py, u16>)>;
    let images: Images<'_> = images.extract()?;
    let mut batch: Vec<Vec<CameraFrame>> = Vec::with_capacity(frames.len());
    for (number, (_, cameras)) in frames.iter().enumerate() {
        let mut shot = Vec::with_capacity(cameras.len());
        for (camera, (rgb, depth_m, segmentation)) in cameras.iter().zip(&images) {
            let pixels = camera.intrinsics.width as usize * camera.intrinsics.height as usize;
            shot.push(CameraFrame {
                rgb: rgb.as_slice()?[number * pixels * 3..][..pixels * 3].to_vec(),
                depth_m: depth_m.as_slice()?[number * pixels..][..pixels].to_vec(),
                segmentation: segmentation.as_slice()?[number * pixels..][..pixels].to_vec(),
                ..CameraFrame::new(&camera.name, camera.intrinsics, camera.world_from_camera)
            });
        }
        batch.push(shot);
    }
    Ok(batch)
}

fn device_error(shaders: SapienShaders, error: PyErr) -> RenderError {
    RenderError::Device { backend: shaders.backend(), message: error.to_string() }
}
