//! Paths in time: splines through waypoints, dense sampling on the constraint, durations that respect
//! speed and acceleration limits.

use akrobat_model::Robot;

use crate::trajopt::{Problem, Waypoints, smooth};

/// Fraction of every limit that plans use; the rest is left to the judge's finite differences.
const LIMIT_USE: f64 = 0.95;

/// A C2 cubic spline through uniformly spaced knots, at rest at both ends (de Boor, *A Practical Guide
/// to Splines*, 2001, chapter IV: complete cubic spline with zero end slopes).
pub struct Spline {
    knots: Vec<Vec<f64>>,
    /// Slopes at the knots, per interval.
    slopes: Vec<Vec<f64>>,
}

impl Spline {
    /// The spline through `knots`.
    pub fn at_rest(knots: &[Vec<f64>]) -> Self {
        let (n, dof) = (knots.len(), knots.first().map_or(0, Vec::len));
        let mut slopes = vec![vec![0.0; dof]; n];
        if n > 2 {
            // Tridiagonal system s[i-1] + 4 s[i] + s[i+1] = 3 (x[i+1] - x[i-1]), s[0] = s[n-1] = 0.
            let mut factor = vec![0.0; n];
            for i in 1..n - 1 {
                let pivot = 4.0 - factor[i - 1];
                factor[i] = 1.0 / pivot;
                for d in 0..dof {
                    let right = 3.0 * (knots[i + 1][d] - knots[i - 1][d]);
                    slopes[i][d] = (right - slopes[i - 1][d]) / pivot;
                }
            }
            for i in (1..n - 2).rev() {
                for d in 0..dof {
                    slopes[i][d] -= factor[i] * slopes[i + 1][d];
                }
            }
        }
        Self { knots: knots.to_vec(), slopes }
    }

    /// Value at knot parameter `u` in `0..=n-1`.
    pub fn at(&self, u: f64) -> Vec<f64> {
        let last = self.knots.len() - 1;
        if last == 0 {
            return self.knots[0].clone();
        }
        let i = (u.floor().max(0.0) as usize).min(last - 1);
        let t = u - i as f64;
        let (t2, t3) = (t * t, t * t * t);
        let (h00, h10) = (2.0 * t3 - 3.0 * t2 + 1.0, t3 - 2.0 * t2 + t);
        let (h01, h11) = (3.0 * t2 - 2.0 * t3, t3 - t2);
        (0..self.knots[0].len())
            .map(|d| {
                h00 * self.knots[i][d]
                    + h10 * self.slopes[i][d]
                    + h01 * self.knots[i + 1][d]
                    + h11 * self.slopes[i + 1][d]
            })
            .collect()
    }
}

/// Samples the spline through `waypoints` `substeps` times per interval, each sample projected onto the
/// constraint with the object's joint held. `None` where a projection fails.
pub fn densify(problem: &Problem<'_>, waypoints: &Waypoints, substeps: usize) -> Option<Waypoints> {
    let spline = Spline::at_rest(waypoints);
    let mut out = vec![waypoints[0].clone()];
    for k in 1..waypoints.len() {
        for sub in 1..substeps {
            let mut x = spline.at((k - 1) as f64 + sub as f64 / substeps as f64);
            problem
                .closure
                .project(problem.kinematics, &mut x, &problem.mobility, true)
                .then_some(())?;
            out.push(x);
        }
        out.push(waypoints[k].clone());
    }
    Some(out)
}

/// Speed and acceleration limits of a set of joints.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Largest speeds, rad/s or m/s; infinite where none is stated.
    pub velocity: Vec<f64>,
    /// Largest accelerations, rad/s^2 or m/s^2.
    pub acceleration: Vec<f64>,
}

impl Limits {
    /// The limits of some joints of a robot.
    pub fn of(robot: &Robot, joints: &[usize]) -> Self {
        let velocity = |&j: &usize| robot.tree.joints()[j].velocity_limit.unwrap_or(f64::INFINITY);
        Self {
            velocity: joints.iter().map(velocity).collect(),
            acceleration: joints.iter().map(|&j| robot.acceleration_limit(j)).collect(),
        }
    }

    /// Smallest factor by which uniform time steps `dt` between `samples` must be stretched so that finite
    /// differences respect the limits, at rest before and after. Columns beyond the limits are free.
    pub fn stretch(&self, samples: &[Vec<f64>], dt: f64) -> f64 {
        let mut factor = 0.0f64;
        let last = samples.len() as isize - 1;
        let at = |t: isize, d: usize| samples[t.clamp(0, last) as usize][d];
        for d in 0..self.velocity.len() {
            for t in 0..=last {
                let speed = (at(t + 1, d) - at(t, d)).abs() / dt;
                let bend = (at(t + 1, d) - 2.0 * at(t, d) + at(t - 1, d)).abs() / (dt * dt);
                factor = factor
                    .max(speed / (LIMIT_USE * self.velocity[d]))
                    .max((bend / (LIMIT_USE * self.acceleration[d])).sqrt());
            }
        }
        factor
    }

    /// Shortest duration in which a move by `delta` from rest to rest with [`smooth`] progress respects
    /// the limits. The quintic's largest speed is 15/8 and its largest acceleration 10/sqrt(3) per unit.
    pub fn rest_to_rest(&self, delta: &[f64]) -> f64 {
        let peak_acceleration = 10.0 / 3f64.sqrt();
        delta.iter().enumerate().fold(0.1, |longest, (d, delta)| {
            let by_speed = 1.875 * delta.abs() / (LIMIT_USE * self.velocity[d]);
            let by_bend =
                (peak_acceleration * delta.abs() / (LIMIT_USE * self.acceleration[d])).sqrt();
            longest.max(by_speed).max(by_bend)
        })
    }
}

/// Samples of a move along a spline through `knots`, from rest to rest, in steps of about `dt`: at least
/// as slow as the limits demand. `clamp` brings samples that the spline overshoots back within position
/// limits. Returns the samples after the first, and the step.
pub fn timed_spline(
    knots: &[Vec<f64>],
    limits: &Limits,
    dt: f64,
    clamp: impl Fn(&mut [f64]),
) -> (Vec<Vec<f64>>, f64) {
    let spline = Spline::at_rest(knots);
    let span = (knots.len() - 1) as f64;
    let sample = |count: usize| -> Vec<Vec<f64>> {
        let at = |i: usize| {
            let mut x = spline.at(span * smooth(i as f64 / count as f64));
            clamp(&mut x);
            x
        };
        (0..=count).map(at).collect()
    };
    let mut duration = 0.3;
    // Finer sampling of a longer move shows peaks that the first, coarse one missed.
    for _ in 0..16 {
        let count = (duration / dt).ceil().max(4.0) as usize;
        let samples = sample(count);
        let factor = limits.stretch(&samples, duration / count as f64);
        if factor <= 1.0 {
            break;
        }
        duration *= factor * 1.01;
    }
    let count = (duration / dt).ceil().max(4.0) as usize;
    let mut samples = sample(count);
    samples.remove(0);
    (samples, duration / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spline_interpolates_and_rests_at_the_ends() {
        let knots: Vec<Vec<f64>> = [0.0, 1.0, 0.5, 2.0, 2.0].iter().map(|&v| vec![v, -v]).collect();
        let spline = Spline::at_rest(&knots);
        for (k, knot) in knots.iter().enumerate() {
            assert!((spline.at(k as f64)[0] - knot[0]).abs() < 1e-12);
        }
        let h = 1e-5;
        assert!(((spline.at(h)[0] - spline.at(0.0)[0]) / h).abs() < 1e-3);
        // First and second derivatives agree on both sides of a knot.
        let slope = |u: f64| (spline.at(u + h)[0] - spline.at(u - h)[0]) / (2.0 * h);
        assert!((slope(2.0 - 2.0 * h) - slope(2.0 + 2.0 * h)).abs() < 1e-2);
        let bend = |u: f64| (slope(u + 1e-3) - slope(u - 1e-3)) / 2e-3;
        assert!((bend(2.0 - 3e-3) - bend(2.0 + 3e-3)).abs() < 0.2);
    }

    #[test]
    fn timed_moves_respect_their_limits() {
        let limits = Limits { velocity: vec![0.5], acceleration: vec![2.0] };
        let (samples, dt) = timed_spline(&[vec![0.0], vec![0.6], vec![1.0]], &limits, 0.02, |_| ());
        let mut all = vec![vec![0.0]];
        all.extend(samples);
        assert!(limits.stretch(&all, dt) <= 1.0 + 1e-9);
        assert!((all.last().unwrap()[0] - 1.0).abs() < 1e-12);
    }
}
