//! Projections and clouds as functions on arrays.

use std::path::Path;

use akrobat_cameras::{CameraFrame, CameraModel, Intrinsics, Rig};
use akrobat_model::Pose;
use akrobat_renderer::RenderError;
use akrobat_renderer::pointcloud::{self, CloudConfig, CloudPlace};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

use crate::errors::to_python;

/// Pixel positions `[N, 2]` of camera-frame points `[N, 3]`; see `akrobat.project`.
#[pyfunction]
pub fn project<'py>(
    py: Python<'py>,
    rig: &str,
    camera: &str,
    points: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let model = model(rig, camera)?;
    let rows = rows::<_, 3>(&points, "points")?;
    let pixels = rows.into_iter().flat_map(|p| model.project(p).unwrap_or([f64::NAN; 2]));
    PyArray1::from_vec(py, pixels.collect()).reshape([points.as_array().nrows(), 2])
}

/// Rays `(x, y, 1)`, as `[N, 2]`, of pixel positions `[N, 2]`; see `akrobat.unproject`.
#[pyfunction]
pub fn unproject<'py>(
    py: Python<'py>,
    rig: &str,
    camera: &str,
    pixels: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let model = model(rig, camera)?;
    let rows = rows::<_, 2>(&pixels, "pixels")?;
    let rays = rows.into_iter().flat_map(|p| model.ray(p).unwrap_or([f64::NAN; 2]));
    PyArray1::from_vec(py, rays.collect()).reshape([pixels.as_array().nrows(), 2])
}

/// Indices of farthest-point samples; see `akrobat.farthest_points`.
#[pyfunction]
pub fn farthest_points<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f32>,
    count: usize,
) -> PyResult<Bound<'py, PyArray1<usize>>> {
    let rows = rows::<_, 3>(&points, "points")?;
    let chosen = py.detach(|| pointcloud::farthest_indices(&rows, count));
    Ok(PyArray1::from_vec(py, chosen))
}

/// A cloud `[N, 3]` from the depth images of several cameras; see `akrobat.fuse`.
#[pyfunction]
pub fn fuse<'py>(
    py: Python<'py>,
    depth_m: PyReadonlyArray3<'py, f32>,
    intrinsics: PyReadonlyArray3<'py, f64>,
    world_from_camera: PyReadonlyArray3<'py, f64>,
    cloud: &str,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let usage = |message: String| to_python(akrobat::Error::Usage(message));
    let config: CloudConfig =
        serde_json::from_str(cloud).map_err(|e| usage(format!("cloud: {e}")))?;
    config.check().map_err(|e| usage(format!("cloud: {e}")))?;
    let (depth, k, poses) =
        (depth_m.as_array(), intrinsics.as_array(), world_from_camera.as_array());
    let [cameras, height, width] = [0, 1, 2].map(|axis| depth.shape()[axis]);
    if k.shape() != [cameras, 3, 3] || poses.shape() != [cameras, 4, 4] {
        return Err(usage(format!(
            "expected intrinsics [{cameras}, 3, 3] and poses [{cameras}, 4, 4], got {:?} and {:?}",
            k.shape(),
            poses.shape()
        )));
    }
    let frames: Vec<CameraFrame> = (0..cameras)
        .map(|camera| {
            let matrix = std::array::from_fn(|i| std::array::from_fn(|j| k[[camera, i, j]]));
            let intrinsics = Intrinsics::from_matrix(width as u32, height as u32, &matrix);
            let rotation = Matrix3::from_fn(|i, j| poses[[camera, i, j]]);
            let rotation = Rotation3::from_matrix_eps(&rotation, 1e-15, 100, Rotation3::identity());
            let position = [0, 1, 2].map(|i| poses[[camera, i, 3]]);
            let pose = Pose::from_parts(
                Translation3::from(position),
                UnitQuaternion::from_rotation_matrix(&rotation),
            );
            CameraFrame {
                depth_m: depth.outer_iter().nth(camera).into_iter().flatten().copied().collect(),
                ..CameraFrame::new("", intrinsics, pose)
            }
        })
        .collect();
    let place = CloudPlace { handle: Point3::origin(), world_from_base: Pose::identity() };
    let fused = py.detach(|| pointcloud::fuse(&frames, &place, &config));
    let positions: Vec<f32> = fused.points.iter().flat_map(|p| &p[..3]).copied().collect();
    PyArray1::from_vec(py, positions).reshape([fused.points.len(), 3])
}

fn model(rig: &str, camera: &str) -> PyResult<CameraModel> {
    let is_file = rig.ends_with(".toml") || Path::new(rig).components().count() > 1;
    let loaded = if is_file { Rig::load(Path::new(rig)) } else { Rig::preset(rig) };
    let loaded = loaded.map_err(|e| to_python(akrobat::Error::Render(RenderError::Rig(e))))?;
    match loaded.cameras.iter().find(|spec| spec.name == camera) {
        Some(spec) => Ok(spec.model()),
        None => {
            let names: Vec<&str> = loaded.cameras.iter().map(|spec| spec.name.as_str()).collect();
            let choices = names.join(", ");
            let message = format!("rig {rig}: no camera \"{camera}\"; valid choices: {choices}");
            Err(to_python(akrobat::Error::Usage(message)))
        }
    }
}

/// The rows of an array of N columns.
fn rows<T: numpy::Element + Copy, const N: usize>(
    array: &PyReadonlyArray2<'_, T>,
    what: &str,
) -> PyResult<Vec<[T; N]>> {
    let array = array.as_array();
    if array.ncols() != N {
        let message = format!("{what}: expected {N} columns, got {}", array.ncols());
        return Err(to_python(akrobat::Error::Usage(message)));
    }
    Ok(array.outer_iter().map(|row| std::array::from_fn(|column| row[column])).collect())
}
