//! Linear algebra of one Newton step on a manifold: bases of null spaces, and a banded system in them. Memory is kept from
//! one step to the next.

use crate::kinematics::MAX_VARIABLES;

/// A column of a basis; entries beyond the variables in use are zero.
pub(crate) type Column = [f64; MAX_VARIABLES];

/// Rows of a constraint's Jacobian, at most.
pub(crate) const MAX_ROWS: usize = 7;

/// Orthonormal columns that span a null space.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Basis {
    columns: [Column; MAX_VARIABLES],
    count: usize,
}

impl Basis {
    /// No columns.
    pub(crate) const EMPTY: Self =
        Self { columns: [[0.0; MAX_VARIABLES]; MAX_VARIABLES], count: 0 };

    /// The columns.
    pub(crate) fn columns(&self) -> &[Column] {
        &self.columns[..self.count]
    }

    /// Orthonormal basis of what is orthogonal to all `rows` among the first `dof` variables, by Householder reflections with
    /// pivoting (Golub and Van Loan, *Matrix Computations*, 2013, section 5.4).
    pub(crate) fn of_complement(rows: &mut [Column], dof: usize) -> Self {
        let mut reflectors = [[0.0; MAX_VARIABLES]; MAX_ROWS];
        let mut rank = 0;
        for column in 0..rows.len().min(dof) {
            let norm = |row: &Column| row[column..dof].iter().map(|v| v * v).sum::<f64>().sqrt();
            let longest = (column..rows.len())
                .max_by(|&a, &b| norm(&rows[a]).total_cmp(&norm(&rows[b])))
                .unwrap_or(column);
            rows.swap(column, longest);
            let length = norm(&rows[column]);
            if length < 1e-9 {
                break;
            }
            let v = &mut reflectors[rank];
            v[column..dof].copy_from_slice(&rows[column][column..dof]);
            v[column] += length.copysign(v[column]);
            let scale = 1.0 / dot(v, v).sqrt();
            v.iter_mut().for_each(|v| *v *= scale);
            for row in &mut rows[column..] {
                add_scaled(row, -2.0 * dot(v, row), v);
            }
            rank += 1;
        }
        let mut basis = Self { count: dof - rank, ..Self::EMPTY };
        for (c, column) in basis.columns[..dof - rank].iter_mut().enumerate() {
            column[rank + c] = 1.0;
            for v in reflectors[..rank].iter().rev() {
                let along = dot(v, column);
                add_scaled(column, -2.0 * along, v);
            }
        }
        basis
    }
}

/// Scalar product.
pub(crate) fn dot(a: &Column, b: &Column) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `a += factor * b`.
pub(crate) fn add_scaled(a: &mut Column, factor: f64, b: &Column) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += factor * b);
}

/// A symmetric positive definite band matrix (lower part, rows of `band + 1` entries) and a right side.
#[derive(Debug, Clone, Default)]
pub(crate) struct Banded {
    band: usize,
    values: Vec<f64>,
    /// The right side; after [`Self::solve`] the solution.
    pub(crate) right: Vec<f64>,
}

impl Banded {
    /// Zeroes a system of `size` rows; memory is asked for only where it is larger than all before it.
    pub(crate) fn reset(&mut self, size: usize, band: usize) {
        self.band = band;
        self.values.clear();
        self.values.resize(size * (band + 1), 0.0);
        self.right.clear();
        self.right.resize(size, 0.0);
    }

    /// Makes room for systems of up to `size` rows.
    pub(crate) fn reserve(&mut self, size: usize, band: usize) {
        self.values.reserve(size * (band + 1));
        self.right.reserve(size);
    }

    fn place(&self, row: usize, column: usize) -> usize {
        row * (self.band + 1) + column + self.band - row
    }

    /// Adds to an entry on or below the diagonal.
    pub(crate) fn add(&mut self, row: usize, column: usize, value: f64) {
        let place = self.place(row, column);
        self.values[place] += value;
    }

    /// Cholesky factorisation and solution in place; `None` if the matrix is not positive definite.
    pub(crate) fn solve(&mut self) -> Option<()> {
        let size = self.right.len();
        for i in 0..size {
            let first = i.saturating_sub(self.band);
            for j in first..=i {
                let start = first.max(j.saturating_sub(self.band));
                let (own, other) = (self.place(i, start), self.place(j, start));
                let before = |at: usize| &self.values[at..at + j - start];
                let known: f64 = before(own).iter().zip(before(other)).map(|(a, b)| a * b).sum();
                let place = self.place(i, j);
                let left = self.values[place] - known;
                self.values[place] = if i != j {
                    left / self.values[self.place(j, j)]
                } else if left > 0.0 && left.is_finite() {
                    left.sqrt()
                } else {
                    return None;
                };
            }
        }
        for i in 0..size {
            let first = i.saturating_sub(self.band);
            let row = &self.values[self.place(i, first)..self.place(i, i)];
            let known: f64 = row.iter().zip(&self.right[first..]).map(|(a, b)| a * b).sum();
            self.right[i] = (self.right[i] - known) / self.values[self.place(i, i)];
        }
        for i in (0..size).rev() {
            let below = i + 1..size.min(i + self.band + 1);
            let known: f64 = below.map(|k| self.values[self.place(k, i)] * self.right[k]).sum();
            self.right[i] = (self.right[i] - known) / self.values[self.place(i, i)];
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn complement_is_orthonormal_and_orthogonal() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut rows = [[0.0; MAX_VARIABLES]; MAX_ROWS];
        rows.iter_mut().for_each(|row| {
            row[..11].iter_mut().for_each(|v| *v = rng.random_range(-1.0..1.0));
        });
        let basis = Basis::of_complement(&mut rows.clone(), 11);
        assert_eq!(basis.columns().len(), 4);
        for (i, a) in basis.columns().iter().enumerate() {
            for (j, b) in basis.columns().iter().enumerate() {
                assert!((dot(a, b) - if i == j { 1.0 } else { 0.0 }).abs() < 1e-12);
            }
            assert!(rows.iter().all(|row| dot(a, row).abs() < 1e-12));
        }
        // Two rows that are the same leave one dimension more.
        rows[6] = rows[0];
        assert_eq!(Basis::of_complement(&mut rows, 11).columns().len(), 5);
    }

    #[test]
    fn banded_solver_agrees_with_a_dense_one() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(6);
        let (n, band) = (20, 4);
        let mut dense = DMatrix::zeros(n, n);
        let mut banded = Banded::default();
        banded.reset(n, band);
        for i in 0..n {
            for j in i.saturating_sub(band)..=i {
                let value = if i == j { 10.0 } else { rng.random_range(-1.0..1.0) };
                (dense[(i, j)], dense[(j, i)]) = (value, value);
                banded.add(i, j, value);
            }
            banded.right[i] = rng.random_range(-1.0..1.0);
        }
        let theirs = dense.lu().solve(&DVector::from_column_slice(&banded.right)).unwrap();
        banded.solve().unwrap();
        assert!((DVector::from_column_slice(&banded.right) - theirs).amax() < 1e-12);
        // Not positive definite.
        banded.reset(2, 1);
        banded.add(0, 0, -1.0);
        assert!(banded.solve().is_none());
    }
}
