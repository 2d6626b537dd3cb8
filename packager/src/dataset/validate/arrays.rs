//! What may stand in an array, looked at a block of frames at a time.

use std::collections::HashSet;

use super::super::reader::{Array, Values};
use crate::quality::{CLOUD_RANGE_M, is_black};

/// Depth may exceed the camera's range by as much as rounding to millimetres does, metres.
const DEPTH_TOLERANCE_M: f32 = 0.001;

/// Largest deviation of a quaternion's length from 1, in single precision.
const UNIT_TOLERANCE: f32 = 1e-4;

/// Checks one array while its frames pass.
pub(super) struct ArrayCheck<'a> {
    name: &'a str,
    labels: &'a HashSet<u16>,
    /// Farthest depth of the camera, metres.
    far_m: Option<f32>,
    /// Number of the next block's first frame.
    first: usize,
    /// Each kind of problem is reported once, and every bad frame of those that name frames.
    problems: Vec<String>,
}

impl<'a> ArrayCheck<'a> {
    pub fn new(name: &'a str, labels: &'a HashSet<u16>, far_m: Option<f32>) -> Self {
        Self { name, labels, far_m, first: 0, problems: Vec::new() }
    }

    pub fn finish(self) -> Vec<String> {
        self.problems
    }

    /// Takes the next rows.
    pub fn push(&mut self, block: &Array) {
        let rows = block.shape.first().copied().unwrap_or(1).max(1);
        match &block.values {
            Values::U8(values) if self.is("_rgb") => {
                self.frames(values, rows, is_black, "is black");
            }
            Values::U16(values) if self.is("_depth") => {
                self.frames(values, rows, |frame| frame.iter().all(|&v| v == 0), "has no depth");
                let metres = values.iter().map(|&v| f32::from(v) / 1000.0);
                self.depth_range(metres);
            }
            Values::U16(values) if self.is("_segmentation") => {
                let unknown = values.iter().filter(|v| !self.labels.contains(v)).min();
                if let Some(id) = unknown {
                    self.once(format!("segment {id} has no label"));
                }
            }
            Values::F32(values) => self.floats(values, rows, block.shape.last().copied()),
            Values::F64(values) => self.doubles(values),
            Values::U8(_) | Values::U16(_) => {}
        }
        self.first += rows;
    }

    fn is(&self, ending: &str) -> bool {
        self.name.ends_with(ending)
    }

    fn once(&mut self, problem: String) {
        if !self.problems.contains(&problem) {
            self.problems.push(problem);
        }
    }

    fn frames<T>(&mut self, values: &[T], rows: usize, bad: impl Fn(&[T]) -> bool, what: &str) {
        for (index, frame) in values.chunks((values.len() / rows).max(1)).enumerate() {
            if bad(frame) {
                self.problems.push(format!("frame {} {what}", self.first + index));
            }
        }
    }

    fn depth_range(&mut self, metres: impl Iterator<Item = f32>) {
        let Some(far_m) = self.far_m else { return };
        let deepest = metres.fold(0.0, f32::max);
        if deepest > far_m + DEPTH_TOLERANCE_M {
            self.once(format!("has depths beyond the camera's {far_m} m"));
        }
    }

    fn floats(&mut self, values: &[f32], rows: usize, columns: Option<usize>) {
        if values.iter().any(|v| !v.is_finite()) {
            self.once("holds NaN or infinity".to_owned());
        }
        if self.is("_depth") {
            self.frames(values, rows, |frame| frame.iter().all(|&v| v == 0.0), "has no depth");
            if values.iter().any(|&v| v < 0.0) {
                self.once("has negative depths".to_owned());
            }
            self.depth_range(values.iter().copied());
        }
        if self.is("point_cloud") {
            let points = || values.chunks_exact(columns.unwrap_or(0).max(3));
            if points().any(|p| p[..3].iter().any(|v| v.abs() > CLOUD_RANGE_M)) {
                self.once(format!("has points beyond {CLOUD_RANGE_M} m"));
            }
            if points().any(|p| p[3..].iter().any(|v| !(0.0..=255.0).contains(v))) {
                self.once("has colours outside 0..255".to_owned());
            }
        }
        let quaternions = match () {
            () if self.is("eef_quat") => Some(values.chunks_exact(4)),
            () if self.is("root_pose") || self.is("base_pose") => Some(values.chunks_exact(7)),
            () => None,
        };
        let length = |q: &[f32]| q[q.len() - 4..].iter().map(|v| v * v).sum::<f32>().sqrt();
        if quaternions.is_some_and(|mut q| q.any(|q| (length(q) - 1.0).abs() > UNIT_TOLERANCE)) {
            self.once("has quaternions that are not of unit length".to_owned());
        }
    }

    fn doubles(&mut self, values: &[f64]) {
        if values.iter().any(|v| !v.is_finite()) {
            self.once("holds NaN or infinity".to_owned());
        }
        if self.is("_world_from_camera") && values.chunks_exact(16).any(|m| !is_pose(m)) {
            self.once("has matrices that are not rotation and translation".to_owned());
        }
        if self.is("_intrinsics") && values.chunks_exact(9).any(|k| !(k[0] > 0.0 && k[4] > 0.0)) {
            self.once("has focal lengths that are not positive".to_owned());
        }
    }
}

/// A row-major 4 x 4 matrix of a rotation and a translation.
fn is_pose(m: &[f64]) -> bool {
    const TOLERANCE: f64 = 1e-6;
    let row = |i: usize| &m[4 * i..4 * i + 3];
    let dot = |i: usize, j: usize| row(i).iter().zip(row(j)).map(|(a, b)| a * b).sum::<f64>();
    let orthonormal =
        (0..3).all(|i| (0..3).all(|j| (dot(i, j) - f64::from(u8::from(i == j))).abs() < TOLERANCE));
    let [a, b, c] = [row(0), row(1), row(2)];
    let determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0]);
    orthonormal && determinant > 0.0 && m[12..] == [0.0, 0.0, 0.0, 1.0]
}

/// What is wrong with an episode's times: frames come at the rate, the last interval may be shorter.
pub(super) fn time_problems(times_s: &[f64], frame_rate_hz: f64) -> Vec<String> {
    const GAP: f64 = 1.5;
    let mut problems = Vec::new();
    if times_s.windows(2).any(|w| w[1] <= w[0]) {
        problems.push("times do not increase".to_owned());
    }
    let gap = times_s.windows(2).position(|w| (w[1] - w[0]) * frame_rate_hz > GAP);
    problems.extend(gap.map(|frame| format!("there is a gap after frame {frame}")));
    problems
}
