//! Whether a robot's spheres are free, eight configurations at a time.
//!
//! After VAMP (Thomason, Kingston and Kavraki, *Motions in Microseconds via Vectorized Sampling-Based
//! Planning*, ICRA 2024): the eight lanes are configurations spread over one edge, so that a collision
//! anywhere on it is found early. Each link's bounding sphere is tried before those of its clusters of
//! spheres, and those before the spheres.

use nalgebra::Vector3;

pub use super::chain::Config;
use super::chain::{CompiledJoint, FrameRows, compile, load, place, store};
use super::obstacles::{Near, Obstacles, Points};
use crate::kinematics::{Frame, Kinematics};
use crate::spheres::Sphere;
use akrobat_simd::{Kernel, LANES, Lanes, Row, Simd, run, xyz};

/// Room for what single precision rounds away, metres.
const ROUNDING_M: f64 = 1e-5;

/// A robot's joints and spheres, compiled for [`Validity::edge_is_free`].
#[derive(Debug, Clone)]
pub struct Validity {
    simd: Simd,
    joints: Vec<CompiledJoint>,
    /// One for each link with spheres, those that do not move last.
    groups: Vec<Group>,
    clusters: Vec<Cluster>,
    spheres: Vec<Ball>,
    /// Pairs of groups that may touch one another.
    pairs: Vec<(usize, usize)>,
    /// By how much all radii have grown, metres; two links keep it between them once.
    grown: f32,
}

#[derive(Debug, Clone, Copy)]
struct Ball {
    center: [f32; 3],
    radius: f32,
}

#[derive(Debug, Clone, Copy)]
struct Group {
    /// Slot of the frame it moves with; the last slot is the world.
    slot: usize,
    bound: Ball,
    /// Its clusters.
    clusters: [usize; 2],
    /// Stands on the floor.
    on_base: bool,
}

/// A few spheres of one link that are near to each other.
#[derive(Debug, Clone, Copy)]
struct Cluster {
    bound: Ball,
    /// Its spheres.
    spheres: [usize; 2],
}

/// Most spheres of a cluster.
const CLUSTER_SPHERES: usize = 8;

/// Working memory of one thread.
#[derive(Debug, Clone)]
pub struct Scratch {
    frames: Vec<FrameRows>,
    /// Centres of the groups' bounds, the clusters' bounds and the spheres, in the world.
    groups: Vec<[Row; 3]>,
    clusters: Vec<[Row; 3]>,
    spheres: Vec<[Row; 3]>,
    /// Which groups' clusters and which clusters' spheres have been placed.
    group_placed: Vec<bool>,
    cluster_placed: Vec<bool>,
}

impl Validity {
    /// Compiles spheres on a tree. `pairs` are the link pairs that may touch one another, `base_joints` the number
    /// of leading variables that move the base; all radii grow by `margin_m`.
    pub fn new(
        kinematics: &Kinematics,
        spheres: &[Sphere],
        pairs: &[(usize, usize)],
        base_joints: usize,
        margin_m: f64,
    ) -> Self {
        let (joints, turned) = compile(kinematics);
        let mut links: Vec<usize> = spheres.iter().map(|s| s.link).collect();
        links.sort_unstable();
        links.dedup();
        links.sort_by_key(|&l| (kinematics.attachment(l).node.is_none(), l));
        let mut out = Self {
            simd: Simd::detect(),
            joints,
            groups: Vec::new(),
            clusters: Vec::new(),
            spheres: Vec::new(),
            pairs: Vec::new(),
            grown: margin_m as f32,
        };
        for &link in &links {
            let attachment = kinematics.attachment(link);
            let mut offset = Frame::from(&attachment.node_from_link);
            if let Some(node) = attachment.node {
                let back = turned[node].transpose();
                offset = Frame { rotation: back, translation: Vector3::zeros() }.compose(&offset);
            }
            let own = spheres.iter().filter(|s| s.link == link).map(|s| {
                let center = offset.transform(&Vector3::from(s.center));
                (center, s.radius + margin_m + ROUNDING_M)
            });
            let mut own: Vec<(Vector3<f64>, f64)> = own.collect();
            let bound = bounding_ball(&own);
            let first = out.clusters.len();
            split(&mut own, &mut |few| {
                let from = out.spheres.len();
                out.spheres.extend(few.iter().map(|(c, r)| ball(c, *r)));
                let spheres = [from, out.spheres.len()];
                out.clusters.push(Cluster { bound: bounding_ball(few), spheres });
            });
            out.groups.push(Group {
                slot: attachment.node.unwrap_or(kinematics.dof()),
                bound,
                clusters: [first, out.clusters.len()],
                on_base: base_joints > 0 && attachment.node == Some(base_joints - 1),
            });
        }
        let group = |link: usize| links.iter().position(|&l| l == link);
        out.pairs = pairs.iter().filter_map(|&(a, b)| Some((group(a)?, group(b)?))).collect();
        out
    }

    /// The same with another implementation of the lanes.
    ///
    /// # Panics
    /// If the processor cannot run it.
    pub fn with_simd(self, simd: Simd) -> Self {
        assert!(simd == Simd::Portable || simd == Simd::detect(), "{simd:?} is not supported");
        Self { simd, ..self }
    }

    /// Number of variables.
    pub fn dof(&self) -> usize {
        self.joints.len()
    }

    /// Which lanes are used.
    pub fn simd(&self) -> Simd {
        self.simd
    }

    /// Working memory for one thread.
    pub fn scratch(&self) -> Scratch {
        let mut frames = vec![FrameRows::default(); self.joints.len() + 1];
        for axis in 0..3 {
            frames[self.joints.len()][axis][axis] = Row([1.0; LANES]);
        }
        Scratch {
            frames,
            groups: vec![Default::default(); self.groups.len()],
            clusters: vec![Default::default(); self.clusters.len()],
            spheres: vec![Default::default(); self.spheres.len()],
            group_placed: vec![false; self.groups.len()],
            cluster_placed: vec![false; self.clusters.len()],
        }
    }

    /// True where one configuration is free.
    pub fn is_free(&self, q: &Config, obstacles: &Obstacles<'_>, scratch: &mut Scratch) -> bool {
        self.edge_is_free(q, q, 1, obstacles, scratch)
    }

    /// True where `count` configurations, equally spaced on the straight edge after `from` and up to `to`, are all
    /// free.
    pub fn edge_is_free(
        &self,
        from: &Config,
        to: &Config,
        count: usize,
        obstacles: &Obstacles<'_>,
        scratch: &mut Scratch,
    ) -> bool {
        run(self.simd, EdgeIsFree { robot: self, from, to, count, obstacles, scratch })
    }

    /// True where any of eight configurations on an edge collides.
    #[inline(always)]
    fn collides<L: Lanes>(
        &self,
        from: &Config,
        to: &Config,
        along: L,
        obstacles: &Obstacles<'_>,
        scratch: &mut Scratch,
    ) -> bool {
        for (index, joint) in self.joints.iter().enumerate() {
            let q = L::splat(from[index]) + L::splat(to[index] - from[index]) * along;
            let parent = scratch.frames[joint.parent];
            joint.place::<L>(&parent, q, &mut scratch.frames[index]);
        }
        scratch.group_placed.fill(false);
        scratch.cluster_placed.fill(false);
        let world = self.joints.len();
        for (index, group) in self.groups.iter().enumerate() {
            let centers = place::<L>(&scratch.frames[group.slot], &group.bound.center);
            store(centers, &mut scratch.groups[index]);
            // What does not move has been where it is since before the obstacles were.
            if group.slot == world {
                continue;
            }
            let touch = self.touch(obstacles, group, &centers, group.bound.radius, None);
            if let Some(near) = touch
                && self.group_touches::<L>(index, near, obstacles, scratch)
            {
                return true;
            }
        }
        for &(a, b) in &self.pairs {
            if self.pair_touches::<L>(a, b, scratch) {
                return true;
            }
        }
        false
    }

    /// What a sphere of a group may touch, among `near` where that is known.
    #[inline(always)]
    fn touch<L: Lanes>(
        &self,
        obstacles: &Obstacles<'_>,
        group: &Group,
        centers: &Points<L>,
        radius: f32,
        among: Option<Near>,
    ) -> Option<Near> {
        let near = match among {
            None => obstacles.near(centers, radius),
            Some(near) => obstacles.nearer(near, centers, radius),
        };
        let low = !group.on_base && obstacles.below_floor(centers[2], radius) != 0;
        (low || !near.is_empty()).then_some(near)
    }

    /// True where a sphere of the group touches something in any lane.
    #[inline(always)]
    fn group_touches<L: Lanes>(
        &self,
        index: usize,
        near: Near,
        obstacles: &Obstacles<'_>,
        scratch: &mut Scratch,
    ) -> bool {
        self.place_clusters::<L>(index, scratch);
        let group = &self.groups[index];
        for cluster in group.clusters[0]..group.clusters[1] {
            let centers = load::<L>(&scratch.clusters[cluster]);
            let radius = self.clusters[cluster].bound.radius;
            let touch = self.touch(obstacles, group, &centers, radius, Some(near));
            let Some(near) = touch else { continue };
            self.place_spheres::<L>(group.slot, cluster, scratch);
            let [first, last] = self.clusters[cluster].spheres;
            for sphere in first..last {
                let centers = load::<L>(&scratch.spheres[sphere]);
                let radius = self.spheres[sphere].radius;
                if obstacles.touched(near, &centers, radius) != 0
                    || !group.on_base && obstacles.below_floor(centers[2], radius) != 0
                {
                    return true;
                }
            }
        }
        false
    }

    #[inline(always)]
    fn pair_touches<L: Lanes>(&self, a: usize, b: usize, scratch: &mut Scratch) -> bool {
        let (first, second) = (&self.groups[a], &self.groups[b]);
        if !self.overlap::<L>(&scratch.groups[a], &first.bound, &scratch.groups[b], &second.bound) {
            return false;
        }
        self.place_clusters::<L>(a, scratch);
        self.place_clusters::<L>(b, scratch);
        for i in first.clusters[0]..first.clusters[1] {
            let own = &self.clusters[i].bound;
            if !self.overlap::<L>(&scratch.clusters[i], own, &scratch.groups[b], &second.bound) {
                continue;
            }
            for j in second.clusters[0]..second.clusters[1] {
                let other = &self.clusters[j].bound;
                if self.overlap::<L>(&scratch.clusters[i], own, &scratch.clusters[j], other) {
                    self.place_spheres::<L>(first.slot, i, scratch);
                    self.place_spheres::<L>(second.slot, j, scratch);
                    if self.clusters_touch::<L>(i, j, scratch) {
                        return true;
                    }
                }
            }
        }
        false
    }

    #[inline(always)]
    fn clusters_touch<L: Lanes>(&self, a: usize, b: usize, scratch: &Scratch) -> bool {
        let ([a, a_end], [b, b_end]) = (self.clusters[a].spheres, self.clusters[b].spheres);
        for i in a..a_end {
            for j in b..b_end {
                let balls = (&self.spheres[i], &self.spheres[j]);
                if self.overlap::<L>(&scratch.spheres[i], balls.0, &scratch.spheres[j], balls.1) {
                    return true;
                }
            }
        }
        false
    }

    /// True where two balls are nearer to each other than they may be in any lane.
    #[inline(always)]
    fn overlap<L: Lanes>(&self, a: &[Row; 3], a_ball: &Ball, b: &[Row; 3], b_ball: &Ball) -> bool {
        let d: Points<L> = xyz!(i => L::load(&a[i]) - L::load(&b[i]));
        let sum = a_ball.radius + b_ball.radius - self.grown;
        (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).less(L::splat(sum * sum)) != 0
    }

    /// World centres of a group's clusters, once for each batch.
    #[inline(always)]
    fn place_clusters<L: Lanes>(&self, index: usize, scratch: &mut Scratch) {
        if std::mem::replace(&mut scratch.group_placed[index], true) {
            return;
        }
        let group = &self.groups[index];
        for cluster in group.clusters[0]..group.clusters[1] {
            let center = &self.clusters[cluster].bound.center;
            let centers = place::<L>(&scratch.frames[group.slot], center);
            store(centers, &mut scratch.clusters[cluster]);
        }
    }

    /// World centres of a cluster's spheres, once for each batch.
    #[inline(always)]
    fn place_spheres<L: Lanes>(&self, slot: usize, cluster: usize, scratch: &mut Scratch) {
        if std::mem::replace(&mut scratch.cluster_placed[cluster], true) {
            return;
        }
        let [first, last] = self.clusters[cluster].spheres;
        for sphere in first..last {
            let centers = place::<L>(&scratch.frames[slot], &self.spheres[sphere].center);
            store(centers, &mut scratch.spheres[sphere]);
        }
    }
}

/// [`Validity::edge_is_free`].
struct EdgeIsFree<'a, 'b> {
    robot: &'a Validity,
    from: &'a Config,
    to: &'a Config,
    count: usize,
    obstacles: &'a Obstacles<'b>,
    scratch: &'a mut Scratch,
}

impl Kernel for EdgeIsFree<'_, '_> {
    type Output = bool;

    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let Self { robot, from, to, count, obstacles, scratch } = self;
        let stride = count.div_ceil(LANES);
        for offset in (1..=stride).rev() {
            let mut along = Row::default();
            for (lane, value) in along.0.iter_mut().enumerate() {
                *value = (lane * stride + offset).min(count) as f32 / count as f32;
            }
            if robot.collides::<L>(from, to, L::load(&along), obstacles, scratch) {
                return false;
            }
        }
        true
    }
}

/// Halves balls across their longest side until few are left together.
fn split(balls: &mut [(Vector3<f64>, f64)], few: &mut impl FnMut(&[(Vector3<f64>, f64)])) {
    if balls.len() <= CLUSTER_SPHERES {
        return few(balls);
    }
    let low = balls.iter().fold(balls[0].0, |a, b| a.inf(&b.0));
    let high = balls.iter().fold(balls[0].0, |a, b| a.sup(&b.0));
    let axis = (high - low).imax();
    balls.sort_by(|a, b| a.0[axis].total_cmp(&b.0[axis]));
    let (left, right) = balls.split_at_mut(balls.len() / 2);
    split(left, few);
    split(right, few);
}

fn ball(center: &Vector3<f64>, radius: f64) -> Ball {
    Ball { center: [center.x as f32, center.y as f32, center.z as f32], radius: radius as f32 }
}

/// A ball around balls: their mean centre, then moved towards the farthest one as long as that helps
/// (Badoiu and Clarkson, *Smaller Core-Sets for Balls*, SODA 2003).
fn bounding_ball(balls: &[(Vector3<f64>, f64)]) -> Ball {
    let mut center = balls.iter().map(|b| b.0).sum::<Vector3<f64>>() / balls.len().max(1) as f64;
    let farthest = |center: &Vector3<f64>| {
        let reach = |b: &(Vector3<f64>, f64)| (b.0 - center).norm() + b.1;
        balls.iter().max_by(|a, b| reach(a).total_cmp(&reach(b))).map(|b| (b.0, reach(b)))
    };
    for step in 1..200 {
        if let Some((target, _)) = farthest(&center) {
            center += (target - center) / f64::from(step + 1);
        }
    }
    ball(&center, farthest(&center).map_or(0.0, |(_, reach)| reach + ROUNDING_M))
}
