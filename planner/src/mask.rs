//! Self-collision masks of robots that nobody has described: which link pairs need not be compared.

use akrobat_model::{Pose, Robot};
use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use crate::collision;
use crate::spheres::{Closeness, SphereModel, fit_closely};

/// Why a pair is masked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The spheres touch in nearly all configurations.
    Always,
    /// Spheres touch, but finer ones inside the links never do: the links themselves stay apart.
    SpheresOnly,
    /// Spheres touch often, finer ones seldom: planning would lose most of what the arm can do. The judge decides, who
    /// compares the meshes.
    Overstated,
}

/// A pair of links that need not be compared.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MaskedPair {
    /// Link names.
    pub links: [String; 2],
    /// Why.
    pub reason: Reason,
    /// Fraction of the sampled configurations in which the spheres touch.
    pub touching: f64,
    /// The same for fine spheres.
    pub touching_closely: f64,
}

/// Configurations that decide, at most: MoveIt's default density.
const SAMPLES: usize = 2000;
/// Fraction of configurations from which a pair counts as always touching, as it does when planning.
const ALWAYS: f64 = 0.9;
/// Fraction of configurations from which touching costs much of an arm's freedom.
const OFTEN: f64 = 0.1;
/// Fraction of those that are real, at most, where spheres overstate a pair.
const SELDOM_REAL: f64 = 0.5;
/// Spheres that stand for the links themselves.
const FINE: Closeness = Closeness { protrusion_m: 0.004, most_per_link: 160, coverage: 0.985 };

/// The pairs that `spheres` make touch although they need not be compared, besides those that the
/// planner leaves out on its own (adjacent links). The same seed gives the same pairs.
pub fn derive(robot: &Robot, spheres: &SphereModel, seed: u64) -> Vec<MaskedPair> {
    let fine = Bounded::of_robot(robot, &within_surfaces(fit_closely(&robot.tree, FINE)));
    let coarse = Bounded::of_robot(robot, spheres);
    let pairs = collision::comparable_pairs(robot, spheres);
    let configurations = configurations(robot, SAMPLES, seed);
    let hits: Vec<Vec<[bool; 2]>> = configurations
        .par_iter()
        .map(|q| {
            let poses = robot.tree.link_poses(&Pose::identity(), q);
            let touch = |&(a, b): &(usize, usize)| {
                let near = touches(&coarse[a], &coarse[b], &poses[a], &poses[b]);
                [near, near && touches(&fine[a], &fine[b], &poses[a], &poses[b])]
            };
            pairs.iter().map(touch).collect()
        })
        .collect();
    let fraction = |pair: usize, kind: usize| {
        hits.iter().filter(|h| h[pair][kind]).count() as f64 / hits.len().max(1) as f64
    };
    let masked = |(index, &(a, b)): (usize, &(usize, usize))| {
        let [touching, touching_closely] = [fraction(index, 0), fraction(index, 1)];
        let reason = match () {
            () if touching >= ALWAYS => Reason::Always,
            () if touching > 0.0 && touching_closely == 0.0 => Reason::SpheresOnly,
            () if touching >= OFTEN && touching_closely < SELDOM_REAL * touching => {
                Reason::Overstated
            }
            () => return None,
        };
        let links = [a, b].map(|link| robot.tree.links()[link].name.clone());
        Some(MaskedPair { links, reason, touching, touching_closely })
    };
    pairs.iter().enumerate().filter_map(masked).collect()
}

/// Spheres made smaller by what they reach beyond the links' surfaces: links that pass one another closely do not make
/// them touch. Small ones keep a quarter of their radius.
fn within_surfaces(mut model: SphereModel) -> SphereModel {
    for sphere in &mut model.spheres {
        sphere.radius = (sphere.radius - FINE.protrusion_m).max(sphere.radius / 4.0);
    }
    model
}

/// Random configurations: the arm anywhere, the fingers anywhere, all else at rest.
pub(crate) fn configurations(robot: &Robot, count: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let joints = [&robot.arm_joints[..], &robot.gripper_joints].concat();
    let one = |_| {
        let mut q = robot.rest.clone();
        for &joint in &joints {
            let [low, high] = robot.tree.joints()[joint].limits;
            let value = rng.random_range(low.max(-3.2)..=high.min(3.2));
            if let Some(column) = robot.tree.column(joint) {
                q[column] = value;
            }
        }
        q
    };
    (0..count).map(one).collect()
}

/// The spheres of a link and a sphere around them, in the link's frame.
pub(crate) struct Bounded {
    spheres: Vec<(Point3<f64>, f64)>,
    center: Point3<f64>,
    radius: f64,
}

impl Bounded {
    /// One for each link.
    pub(crate) fn of_robot(robot: &Robot, model: &SphereModel) -> Vec<Self> {
        let of_link = |link: usize| {
            let own = model.spheres.iter().filter(|s| s.link == link);
            let spheres: Vec<_> = own.map(|s| (Point3::from(s.center), s.radius)).collect();
            let sum: Vector3<f64> = spheres.iter().map(|(c, _)| c.coords).sum();
            let center = Point3::from(sum / spheres.len().max(1) as f64);
            let reach = spheres.iter().map(|(c, r)| (c - center).norm() + r);
            let radius = reach.fold(0.0, f64::max);
            Self { spheres, center, radius }
        };
        (0..robot.tree.links().len()).map(of_link).collect()
    }

    /// Lowest point of the link's spheres above z = 0 of the poses' frame, metres.
    pub(crate) fn lowest(&self, pose: &Pose) -> f64 {
        self.spheres.iter().map(|(c, r)| (pose * c).z - r).fold(f64::INFINITY, f64::min)
    }
}

pub(crate) fn touches(a: &Bounded, b: &Bounded, pose_a: &Pose, pose_b: &Pose) -> bool {
    let far = (pose_a * a.center - pose_b * b.center).norm() > a.radius + b.radius;
    if far || a.spheres.is_empty() || b.spheres.is_empty() {
        return false;
    }
    let a_from_b = pose_a.inverse() * pose_b;
    b.spheres.iter().any(|(c, r)| {
        let center = a_from_b * c;
        a.spheres.iter().any(|(d, s)| (center - d).norm_squared() < (r + s) * (r + s))
    })
}
