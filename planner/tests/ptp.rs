//! Free-space motion: lanes against the double-precision clearance, solids against sampled surfaces, paths against a
//! finer check of their own.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use akrobat_model::{Pose, Robot};
use akrobat_planner::collision::{MovingCheck, RobotBody};
use akrobat_planner::kernels::obstacles::{Obstacles, Solid};
use akrobat_planner::kernels::validity::Validity;
use akrobat_planner::kinematics::{Frame, Kinematics};
use akrobat_planner::ptp::{Domain, NoPath, Query, RobotSpace, Settings};
use akrobat_planner::world::World;
use akrobat_planner::{PlannerConfig, Preparation};
use akrobat_simd::Simd;
use common::numbers;
use nalgebra::{Rotation3, Vector3};
use rand::RngExt;

/// Clearances this near to the wanted one may round to either side, metres.
const ROUNDING_M: f64 = 2e-4;

fn compile(robot: &Robot) -> Kinematics {
    let variables = [&robot.base_joints[..], &robot.arm_joints].concat();
    Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest)
}

/// Random configurations with the base within `reach` of `around`.
fn configurations(
    kinematics: &Kinematics,
    around: [f64; 2],
    reach: f64,
    count: usize,
) -> Vec<Vec<f64>> {
    let mut rng = numbers(11);
    let mut draw = |i: usize| {
        let (low, high) = (kinematics.lower()[i].max(-3.0), kinematics.upper()[i].min(3.0));
        match i {
            0 | 1 => around[i] + rng.random_range(-reach..reach),
            _ => rng.random_range(low..high),
        }
    };
    (0..count).map(|_| (0..kinematics.dof()).map(&mut draw).collect()).collect()
}

fn everywhere(kinematics: &Kinematics) -> Domain {
    let dof = kinematics.dof();
    let bound = |limits: &[f64], base: f64| -> Vec<f64> {
        limits
            .iter()
            .map(|l| if l.is_finite() { l.clamp(-base, base) } else { l.signum() * base })
            .collect()
    };
    Domain {
        lower: bound(kinematics.lower(), 3.0),
        upper: bound(kinematics.upper(), 3.0),
        weights: vec![1.0; dof],
    }
}

#[test]
fn lanes_agree_with_the_clearance_in_double_precision() {
    let Some(task) = common::task("summit_drawer_kitchen") else { return };
    let preparation = Preparation::new(&task).unwrap();
    let config = PlannerConfig { voxel_size_m: 0.03, ..PlannerConfig::default() };
    let world = World::build(&task, &config);
    let kinematics = compile(&task.robot);
    let (spheres, pairs) = (&preparation.spheres, &preparation.self_pairs);
    let body = RobotBody::new(&task.robot, spheres, pairs, &kinematics);
    let start = task.object.start[task.object.tree.column(task.object.active_joint).unwrap()];
    let least = 0.01;
    let mut obstacles = Obstacles::new();
    obstacles.add_field(&Frame::identity(), &world.fixed);
    obstacles.add_field(&world.joint.world_from_moved(start), &world.moving);
    obstacles.set_floor(world.floor_z);
    let handle = akrobat_planner::world::handle_center(&task.object);
    let samples = configurations(&kinematics, [handle.x, handle.y], 1.5, 3000);
    let validity = |margin: f64, simd: Simd| {
        Validity::new(&kinematics, &spheres.spheres, pairs, 3, margin).with_simd(simd)
    };
    let settings = Settings::default();
    let domain = everywhere(&kinematics);
    let answers = |validity: &Validity| -> Vec<bool> {
        let space =
            RobotSpace { validity, obstacles: &obstacles, domain: &domain, settings: &settings };
        samples.iter().map(|x| space.is_free(x)).collect()
    };
    let clearances: Vec<f64> = samples
        .iter()
        .map(|x| {
            let frames = kinematics.forward(x);
            body.clearance(&frames, &world, start, MovingCheck::All, least).distance_m
        })
        .collect();
    let differ = |answers: &[bool]| {
        let pairs = answers.iter().zip(&clearances);
        pairs.filter(|(a, d)| (*d - least).abs() > ROUNDING_M && **a != (**d >= least)).count()
    };
    let fast = answers(&validity(least, Simd::detect()));
    let free = fast.iter().filter(|f| **f).count();
    assert!(free > 100 && free < samples.len() - 100, "{free} are free");
    assert_eq!(differ(&fast), 0);
    assert_eq!(fast, answers(&validity(least, Simd::Portable)));
    // Half a centimetre of another margin is noticed.
    assert!(differ(&answers(&validity(least + 0.005, Simd::detect()))) > 0);
    assert!(differ(&answers(&validity(least - 0.005, Simd::detect()))) > 0);
}

/// Summit beside two boxes with a gap between them.
struct Gap {
    robot: Robot,
    preparation: Preparation,
    kinematics: Kinematics,
    boxes: Vec<(Frame, [f64; 3])>,
}

impl Gap {
    fn new(width_m: f64) -> Option<Self> {
        let task = common::task("summit_drawer_empty")?;
        let preparation = Preparation::new(&task).unwrap();
        let kinematics = compile(&task.robot);
        let half = [0.1, 2.0, 1.0];
        let wall = |side: f64| {
            let shift = Vector3::new(0.0, side * (width_m / 2.0 + half[1]), half[2]);
            let turn = *Rotation3::from_axis_angle(&Vector3::z_axis(), 0.2).matrix();
            (Frame { rotation: turn, translation: turn * shift }, half)
        };
        let boxes = vec![wall(1.0), wall(-1.0)];
        Some(Self { robot: task.robot, preparation, kinematics, boxes })
    }

    fn obstacles(&self) -> Obstacles<'static> {
        let mut out = Obstacles::new();
        self.boxes.iter().for_each(|(at, half)| out.add_solid(at, Solid::Box { half: *half }));
        out
    }

    fn validity(&self, simd: Simd) -> Validity {
        let Preparation { spheres, self_pairs, .. } = &self.preparation;
        Validity::new(&self.kinematics, &spheres.spheres, self_pairs, 3, 0.0).with_simd(simd)
    }

    fn query(&self, seed: u64) -> Query {
        let at = |x: f64| {
            let mut q = vec![x, 0.3, 0.0];
            q.extend(&self.robot.file.arm.retract);
            q
        };
        Query { start: at(-1.3), goal: at(1.3), seed }
    }

    /// Smallest distance of any sphere from the boxes, in double precision.
    fn clearance(&self, x: &[f64]) -> f64 {
        let frames = self.kinematics.forward(x);
        let mut least = f64::INFINITY;
        for sphere in &self.preparation.spheres.spheres {
            let link = self.kinematics.link_frame(&frames, sphere.link);
            let center = link.transform(&Vector3::from(sphere.center));
            for (at, half) in &self.boxes {
                let beyond = at.inverse_transform(&center).abs() - Vector3::from(*half);
                least = least.min(beyond.sup(&Vector3::zeros()).norm() - sphere.radius);
            }
        }
        least
    }
}

#[test]
fn a_base_with_an_arm_drives_through_a_gap() {
    let Some(gap) = Gap::new(1.1) else { return };
    let (obstacles, domain) = (gap.obstacles(), everywhere(&gap.kinematics));
    let settings = Settings { smoothing_rounds: 1, ..Settings::default() };
    let validity = gap.validity(Simd::detect());
    let space = RobotSpace {
        validity: &validity,
        obstacles: &obstacles,
        domain: &domain,
        settings: &settings,
    };
    let queries: Vec<Query> = (0..4).map(|seed| gap.query(seed)).collect();
    let found = space.plan_batch(&queries);
    for (query, found) in queries.iter().zip(&found) {
        let path = &found.as_ref().unwrap().path;
        assert_eq!((&path[0], path.last().unwrap()), (&query.start, &query.goal));
        assert!(path.len() > 2, "the straight way is blocked");
        for pair in path.windows(2) {
            let longest =
                pair[0].iter().zip(&pair[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let count = (longest / 0.002).ceil().max(1.0) as usize;
            for i in 0..=count {
                let t = i as f64 / count as f64;
                let x: Vec<f64> =
                    pair[0].iter().zip(&pair[1]).map(|(a, b)| a + (b - a) * t).collect();
                let clearance = gap.clearance(&x);
                assert!(clearance > -2e-3, "{:.1} mm inside a wall", -1e3 * clearance);
            }
        }
    }
    // The same seed gives the same path, alone and in lanes of the other kind; another seed another one.
    let portable = gap.validity(Simd::Portable);
    let alone = RobotSpace { validity: &portable, ..space };
    assert_eq!(alone.plan(&queries[2]), found[2]);
    assert_ne!(found[2], found[3]);
}

#[test]
fn what_cannot_be_solved_says_why() {
    let Some(gap) = Gap::new(0.2) else { return };
    let (obstacles, domain) = (gap.obstacles(), everywhere(&gap.kinematics));
    let validity = gap.validity(Simd::detect());
    let settings = Settings { iterations: 200, attempts: 1, ..Settings::default() };
    let space = RobotSpace {
        validity: &validity,
        obstacles: &obstacles,
        domain: &domain,
        settings: &settings,
    };
    let query = gap.query(0);
    assert_eq!(space.plan(&query), Err(NoPath::Budget));
    let mut inside = query.start.clone();
    inside[0] = 0.0;
    let from_inside = Query { start: inside.clone(), ..query.clone() };
    assert_eq!(space.plan(&from_inside), Err(NoPath::Start));
    assert_eq!(space.plan(&Query { goal: inside, ..query }), Err(NoPath::Goal));
}

/// Points on the surface of a solid in its own frame, about a centimetre apart.
fn surface(solid: Solid) -> Vec<Vector3<f64>> {
    let steps = |length: f64| -> Vec<f64> {
        let count = (length / 0.01).ceil().max(1.0);
        (0..=count as usize).map(|i| i as f64 / count).collect()
    };
    let mut out = Vec::new();
    match solid {
        Solid::Box { half } => {
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                for a in steps(2.0 * half[u]) {
                    for b in steps(2.0 * half[v]) {
                        for side in [-1.0, 1.0] {
                            let mut p = Vector3::zeros();
                            p[axis] = side * half[axis];
                            p[u] = half[u] * (2.0 * a - 1.0);
                            p[v] = half[v] * (2.0 * b - 1.0);
                            out.push(p);
                        }
                    }
                }
            }
        }
        Solid::Cylinder { radius, half_length } => {
            for turn in steps(std::f64::consts::TAU * radius) {
                let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
                for along in steps(2.0 * half_length) {
                    let z = half_length * (2.0 * along - 1.0);
                    out.push(Vector3::new(radius * cos, radius * sin, z));
                }
                for r in steps(radius) {
                    for z in [-half_length, half_length] {
                        out.push(Vector3::new(r * radius * cos, r * radius * sin, z));
                    }
                }
            }
        }
        Solid::Capsule { radius, half_length } => {
            for turn in steps(std::f64::consts::TAU * radius) {
                let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
                for along in steps(2.0 * half_length) {
                    let z = half_length * (2.0 * along - 1.0);
                    out.push(Vector3::new(radius * cos, radius * sin, z));
                }
                for rise in steps(std::f64::consts::FRAC_PI_2 * radius) {
                    let (up, side) = (rise * std::f64::consts::FRAC_PI_2).sin_cos();
                    for sign in [-1.0, 1.0] {
                        let z = sign * (half_length + radius * up);
                        out.push(Vector3::new(radius * side * cos, radius * side * sin, z));
                    }
                }
            }
        }
    }
    out
}

/// A ball on a gantry touches a solid exactly where the solid's sampled surface is within its radius.
#[test]
fn solids_are_where_their_surfaces_are() {
    let urdf = r#"<robot name="gantry"><link name="world"/><link name="a"/><link name="b"/><link name="ball"/>
        <joint name="x" type="prismatic"><parent link="world"/><child link="a"/><axis xyz="1 0 0"/>
            <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
        <joint name="y" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
            <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
        <joint name="z" type="prismatic"><parent link="b"/><child link="ball"/><axis xyz="0 0 1"/>
            <limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"#;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gantry.urdf");
    std::fs::write(&path, urdf).unwrap();
    let search = akrobat_model::load::AssetSearch::default();
    let (tree, _) = akrobat_model::urdf::read(&path, &search).unwrap();
    let variables: Vec<usize> = ["x", "y", "z"].map(|j| tree.joint_index(j).unwrap()).into();
    let kinematics = Kinematics::compile(&tree, &Pose::identity(), &variables, &tree.neutral());
    let radius = 0.15;
    let link = tree.link_index("ball").unwrap();
    let sphere = akrobat_planner::Sphere { link, center: [0.0; 3], radius };
    let validity = Validity::new(&kinematics, &[sphere], &[], 0, 0.0);
    let solids = [
        Solid::Box { half: [0.3, 0.1, 0.2] },
        Solid::Cylinder { radius: 0.2, half_length: 0.3 },
        Solid::Capsule { radius: 0.2, half_length: 0.3 },
        Solid::Capsule { radius: 0.25, half_length: 0.0 },
    ];
    let turn = *Rotation3::from_euler_angles(0.4, -0.7, 1.1).matrix();
    let place = Frame { rotation: turn, translation: Vector3::new(0.3, -0.2, 0.1) };
    let (domain, settings) = (everywhere(&kinematics), Settings::default());
    for solid in solids {
        let mut obstacles = Obstacles::new();
        obstacles.add_solid(&place, solid);
        let space = RobotSpace {
            validity: &validity,
            obstacles: &obstacles,
            domain: &domain,
            settings: &settings,
        };
        let surface = surface(solid);
        let mut decided = [0, 0];
        for x in configurations(&kinematics, [0.3, -0.2], 0.6, 400) {
            let x = [x[0], x[1], x[2] * 0.25];
            let local = place.inverse_transform(&Vector3::from(x));
            let nearest = surface.iter().map(|p| (p - local).norm()).fold(f64::INFINITY, f64::min);
            let free = space.is_free(&x);
            // Sampling leaves the distance to the surface open by less than a centimetre; inside, the ball
            // may be farther from the surface than its radius.
            if nearest < radius {
                assert!(!free, "{solid:?} at {local}: {nearest}");
                decided[0] += 1;
            } else if nearest > radius + 0.01 && local.norm() > 0.55 {
                assert!(free, "{solid:?} at {local}: {nearest}");
                decided[1] += 1;
            }
        }
        assert!(decided.iter().all(|&count| count > 20), "{solid:?}: {decided:?}");
    }
}
