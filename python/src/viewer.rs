//! Hands what is to be shown to `akrobat.viewer` as arrays.

use akrobat::Error;
use akrobat::pipeline::{ViewBody, ViewJob};
use akrobat_model::pose;
use numpy::{PyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::export::usage_error;

/// Runs `akrobat.viewer.show`. Returns the names of the cameras.
pub fn view(job: &ViewJob<'_>) -> Result<Vec<String>, Error> {
    Python::attach(|py| {
        let request = job.request;
        let shown = PyDict::new(py);
        shown.set_item("title", &job.title)?;
        shown.set_item("times_s", PyArray::from_slice(py, &job.times_s))?;
        let bodies: Vec<_> = job.bodies.iter().map(|b| body(py, b)).collect::<PyResult<_>>()?;
        shown.set_item("bodies", PyList::new(py, bodies)?)?;
        let tables = PyDict::new(py);
        for table in &job.tables {
            let shape = [job.times_s.len(), table.columns.len()];
            let values = PyArray::from_slice(py, &table.values).reshape(shape)?;
            tables.set_item(table.name, (&table.columns, values))?;
        }
        shown.set_item("tables", tables)?;
        let dataset = request.input.is_dir().then_some(&request.input);
        let module = py.import("akrobat.viewer")?;
        let options = PyDict::new(py);
        options.set_item("dataset", dataset)?;
        options.set_item("episode", request.episode)?;
        options.set_item("every", request.every)?;
        options.set_item("save", &request.save)?;
        module.getattr("show")?.call((shown,), Some(&options))?.extract()
    })
    .map_err(usage_error)
}

fn body<'py>(py: Python<'py>, body: &ViewBody) -> PyResult<Bound<'py, PyDict>> {
    let entry = PyDict::new(py);
    entry.set_item("name", &body.name)?;
    let meshes = PyList::empty(py);
    for surface in body.meshes.iter().filter(|surface| !surface.mesh.triangles.is_empty()) {
        let (mesh, values) = (&surface.mesh, PyDict::new(py));
        for (name, rows) in [("positions", &mesh.positions), ("normals", &mesh.normals)] {
            let array = PyArray::from_slice(py, rows.as_flattened());
            values.set_item(name, array.reshape([rows.len(), 3])?)?;
        }
        let triangles = PyArray::from_slice(py, mesh.triangles.as_flattened());
        values.set_item("triangles", triangles.reshape([mesh.triangles.len(), 3])?)?;
        values.set_item("color", surface.color)?;
        meshes.append(values)?;
    }
    entry.set_item("meshes", meshes)?;
    let poses: Vec<[f64; 7]> = body.world_from_body.iter().map(pose::to_xyz_wxyz).collect();
    let array = PyArray::from_slice(py, poses.as_flattened());
    entry.set_item("world_from_body", array.reshape([poses.len(), 7])?)?;
    Ok(entry)
}
