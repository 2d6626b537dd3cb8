//! What tasks with the same robot or the same scene need not compute again.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::Vector3;
use sha2::{Digest, Sha256};

use crate::esdf::{Esdf, Triangles};
use crate::spheres::SphereModel;

/// Robots whose spheres are kept, at most.
const ROBOTS: usize = 8;
/// Distance fields that are kept, at most: those of two objects (60 MB each where the voxels are those of the paper).
const FIELDS: usize = 4;

/// Fitted spheres and distance fields by the geometry that they were made of, so that what comes out is
/// the same whether anything was kept or not. One serves any number of tasks, one after another.
#[derive(Debug)]
pub struct Reuse {
    spheres: Recent<SphereModel>,
    fields: Recent<Esdf>,
}

impl Default for Reuse {
    fn default() -> Self {
        Self { spheres: Recent::new(ROBOTS), fields: Recent::new(FIELDS) }
    }
}

impl Reuse {
    /// The spheres that `fit` makes, where none are kept for this geometry.
    pub(crate) fn spheres(
        &self,
        geometry: Fingerprint,
        fit: impl FnOnce() -> SphereModel,
    ) -> Arc<SphereModel> {
        self.spheres.get_or_make(geometry, fit)
    }

    /// The field that [`Esdf::build`] makes of the same arguments.
    pub(crate) fn field(
        &self,
        triangles: &Triangles,
        [low, high]: [Vector3<f64>; 2],
        voxel_m: f64,
        seeds: &[Vector3<f64>],
    ) -> Arc<Esdf> {
        let mut geometry = Fingerprint::default();
        geometry.triangles(triangles);
        geometry.numbers(&[voxel_m]);
        for point in [low, high].iter().chain(seeds) {
            geometry.numbers(point.as_slice());
        }
        self.fields.get_or_make(geometry, || Esdf::build(triangles, low, high, voxel_m, seeds))
    }
}

/// Hash of geometry, bit by bit.
#[derive(Debug, Default)]
pub(crate) struct Fingerprint(Sha256);

impl Fingerprint {
    pub fn numbers(&mut self, numbers: &[f64]) {
        for number in numbers {
            self.0.update(number.to_bits().to_le_bytes());
        }
    }

    /// Their number comes first, so that two lists cannot be taken for one.
    pub fn triangles(&mut self, triangles: &Triangles) {
        self.0.update((triangles.len() as u64).to_le_bytes());
        for corner in triangles.iter().flatten() {
            self.numbers(corner.as_slice());
        }
    }

    pub fn text(&mut self, text: &str) {
        self.0.update((text.len() as u64).to_le_bytes());
        self.0.update(text);
    }
}

/// The values that were wanted last, the newest in front.
#[derive(Debug)]
struct Recent<T> {
    most: usize,
    values: Mutex<VecDeque<([u8; 32], Arc<T>)>>,
}

impl<T> Recent<T> {
    fn new(most: usize) -> Self {
        Self { most, values: Mutex::default() }
    }

    /// Making it takes threads of the pool, so no lock is held meanwhile.
    fn get_or_make(&self, geometry: Fingerprint, make: impl FnOnce() -> T) -> Arc<T> {
        let key: [u8; 32] = geometry.0.finalize().into();
        let take = || {
            let mut values = self.values.lock().unwrap_or_else(PoisonError::into_inner);
            let place = values.iter().position(|(other, _)| *other == key)?;
            values.remove(place)
        };
        let value = take().map_or_else(|| Arc::new(make()), |(_, value)| value);
        let mut values = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        values.push_front((key, value.clone()));
        values.truncate(self.most);
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(number: f64) -> Fingerprint {
        let mut out = Fingerprint::default();
        out.numbers(&[number]);
        out
    }

    #[test]
    fn the_same_is_made_once_and_the_oldest_goes_first() {
        let recent = Recent::new(2);
        let made = std::cell::Cell::new(0);
        let get = |number: f64| {
            let make = || {
                made.set(made.get() + 1);
                number
            };
            *recent.get_or_make(key(number), make)
        };
        assert_eq!([get(1.0), get(2.0), get(1.0)], [1.0, 2.0, 1.0]);
        assert_eq!(made.get(), 2);
        assert_eq!([get(3.0), get(1.0)], [3.0, 1.0]);
        assert_eq!(made.get(), 3);
        assert_eq!(get(2.0), 2.0);
        assert_eq!(made.get(), 4);
    }

    #[test]
    fn fields_of_other_geometry_are_others() {
        let reuse = Reuse::default();
        let at = |z: f64| {
            vec![[Vector3::new(0.2, 0.2, z), Vector3::new(0.8, 0.2, z), Vector3::new(0.5, 0.8, z)]]
        };
        let bounds = [Vector3::zeros(), Vector3::repeat(1.0)];
        let low = reuse.field(&at(0.2), bounds, 0.05, &[]);
        let high = reuse.field(&at(0.8), bounds, 0.05, &[]);
        let point = Vector3::new(0.5, 0.4, 0.2);
        assert!(low.distance(&point) + 0.5 < high.distance(&point));
        assert!(Arc::ptr_eq(&low, &reuse.field(&at(0.2), bounds, 0.05, &[])));
        assert!(!Arc::ptr_eq(&low, &reuse.field(&at(0.2), bounds, 0.05, &[bounds[0]])));
        assert!(!Arc::ptr_eq(&low, &reuse.field(&at(0.2), bounds, 0.04, &[])));
    }
}
