//! Why a task yields nothing: what stops each stage, and which constraint is closest to being satisfied.

use std::collections::BTreeMap;

use akrobat_model::events::Observer;
use akrobat_model::task::Task;
use akrobat_model::trajectory::Grasp;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use super::{Hold, LIMIT_MARGIN, PlanError, Preparation, Run, stage_seed};
use crate::akr;
use crate::collision::{Clearance, MovingCheck, Obstacle, RobotBody};
use crate::config::PlannerConfig;
use crate::esdf::{Triangles, collect_triangles, point_triangle_distance};
use crate::grasp;
use crate::ik::{self, Tool, pose_error};
use crate::kinematics::{Kinematics, NodeFrames};
use crate::world::{World, moved_links};

/// Grasps and seeds that reach is explained with, for each position of the joint.
const GRASPS: usize = 6;
const SEEDS: usize = 60;
/// Grasps and starts whose way is followed, and steps from start to goal.
const FOLLOWED_HOLDS: usize = 8;
const FOLLOWED_STARTS: usize = 4;
const STEPS: usize = 60;

/// What was found out about a task, stage by stage. Lengths in metres, angles in radians.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explanation {
    /// Which grasps fit.
    pub grasps: GraspFindings,
    /// Where inverse kinematics gets to, for the start and each goal.
    pub reach: Vec<ReachFindings>,
    /// How far the joint can be followed, for each goal.
    pub ways: Vec<WayFindings>,
    /// What is closest to feasible, the closest first.
    pub closest: Vec<Violation>,
}

/// Which grasps fit the gripper.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GraspFindings {
    /// Grasps that were looked at.
    pub candidates: usize,
    /// Those that fit.
    pub fitting: usize,
    /// What the others touch, with how many do.
    pub misfits: BTreeMap<String, u64>,
}

/// Inverse kinematics at one position of the object's joint.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReachFindings {
    /// Position of the joint, rad or m.
    pub position: f64,
    /// Seeds tried, over a few grasps.
    pub seeds: usize,
    /// Seeds that brought the tool to the grasp.
    pub reached: usize,
    /// Those of them that are free of collision.
    pub free: usize,
    /// Least distance of the tool from the grasp among the other seeds, metres and radians.
    pub closest_miss: Option<[f64; 2]>,
    /// Joints that were at a limit where the tool did not get there, with how often.
    pub at_limit: BTreeMap<String, u64>,
    /// What collides where it did, the most frequent first.
    pub blocked_by: Vec<Blocker>,
}

/// A link of the robot and what it hits.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Blocker {
    /// The link.
    pub link: String,
    /// Scene body, object link, robot link or floor.
    pub obstacle: String,
    /// In how many configurations.
    pub count: u64,
    /// Smallest lack of clearance among them, metres.
    pub least_m: f64,
}

/// Following the object's joint to one goal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WayFindings {
    /// The goal, rad or m.
    pub goal: f64,
    /// Start configurations that were followed.
    pub followed: usize,
    /// Farthest position that one of them got to without a change of grasp, rad or m.
    pub farthest: Option<f64>,
    /// What stopped them, with how many.
    pub stopped_by: BTreeMap<String, u64>,
}

/// A constraint that is not met, and by how much.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Violation {
    /// The stage.
    pub stage: String,
    /// One sentence.
    pub text: String,
    /// How much is missing, metres.
    pub missing_m: f64,
}

/// Explains a task whose object has a driven joint; of other tasks, grasps and the start.
///
/// # Errors
/// [`PlanError`].
pub fn explain(
    task: &Task,
    preparation: &Preparation,
    world: &World,
    config: &PlannerConfig,
    observer: &dyn Observer,
) -> Result<Explanation, PlanError> {
    let mut run = Run::new(task, preparation, config, observer);
    let seed = stage_seed(task, "grasps", 0);
    let spheres = &preparation.spheres;
    let (fitting, candidates) = grasp::grasps(task, spheres, seed, GRASPS);
    let misfits = grasp::misfits(task, spheres, seed);
    let names = Names::new(task);
    let driven = task.file.object.kind == akrobat_model::task::ObjectKind::Articulated;
    let goal = &task.file.goal;
    let goals: &[f64] = if driven { &goal.positions } else { &[] };
    let mut reach = Vec::new();
    for &q in std::iter::once(&goal.start).chain(goals) {
        reach.push(run.explain_reach(world, &names, &fitting, q)?);
    }
    let holds = if driven { run.holds(world, &fitting)? } else { Vec::new() };
    let ways: Vec<WayFindings> =
        (0..goals.len()).map(|index| run.explain_way(world, &names, &holds, index)).collect();
    let fits = candidates - misfits.values().sum::<u64>() as usize;
    let grasps = GraspFindings { candidates, fitting: fits, misfits };
    let closest = closest(&reach);
    Ok(Explanation { grasps, reach, ways, closest })
}

/// The smallest violations of each position, the smallest first.
fn closest(reach: &[ReachFindings]) -> Vec<Violation> {
    let mut violations = Vec::new();
    for at in reach.iter().filter(|at| at.free == 0) {
        let nearest = at.blocked_by.iter().min_by(|a, b| a.least_m.total_cmp(&b.least_m));
        if let Some(blocker) = nearest {
            violations.push(Violation {
                stage: "collision".into(),
                text: format!(
                    "with the joint at {:.3}, \"{}\" comes {:.1} mm too close to {}",
                    at.position,
                    blocker.link,
                    1e3 * blocker.least_m,
                    blocker.obstacle
                ),
                missing_m: blocker.least_m,
            });
        } else if let Some([distance, angle]) = at.closest_miss {
            let joints: Vec<&str> = at.at_limit.keys().take(3).map(String::as_str).collect();
            let limits = if joints.is_empty() {
                String::new()
            } else {
                format!("; at their limits: {}", joints.join(", "))
            };
            violations.push(Violation {
                stage: "reach".into(),
                text: format!(
                    "with the joint at {:.3}, the tool stays {:.0} mm and {angle:.2} rad away from the grasp{limits}",
                    at.position,
                    1e3 * distance
                ),
                missing_m: distance,
            });
        }
    }
    violations.sort_by(|a, b| a.missing_m.total_cmp(&b.missing_m));
    violations
}

/// Finds out what a sphere is close to.
struct Names {
    links: Vec<String>,
    /// Scene bodies and resting object links, with their triangles and bounds in the world.
    resting: Vec<(String, Triangles, [Vector3<f64>; 2])>,
    moving: String,
}

impl Names {
    fn new(task: &Task) -> Self {
        let object = &task.object;
        let start = object.tree.link_poses(&object.world_from_root, &object.start);
        let moved = moved_links(object);
        let mut resting = Vec::new();
        let mut add = |name: String, triangles: Triangles| {
            let corners = || triangles.iter().flatten();
            let low = corners().fold(Vector3::repeat(f64::INFINITY), |a, c| a.inf(c));
            let high = corners().fold(Vector3::repeat(f64::NEG_INFINITY), |a, c| a.sup(c));
            resting.push((name, triangles, [low, high]));
        };
        for body in &task.scene.bodies {
            let mut triangles = Triangles::new();
            for part in body.collision_parts() {
                collect_triangles(&part.triangulate(), &body.world_from_body, &mut triangles);
            }
            add(format!("scene body \"{}\"", body.name), triangles);
        }
        for (index, link) in object.tree.links().iter().enumerate().filter(|(i, _)| !moved[*i]) {
            let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
            let mut triangles = Triangles::new();
            for part in parts {
                collect_triangles(&part.triangulate(), &start[index], &mut triangles);
            }
            add(format!("object link \"{}\"", link.name), triangles);
        }
        Self {
            links: task.robot.tree.links().iter().map(|link| link.name.clone()).collect(),
            resting,
            moving: format!("object link \"{}\"", object.tree.links()[object.handle_link].name),
        }
    }

    /// What `clearance` is about, in the user's words.
    fn obstacle(
        &self,
        body: &RobotBody,
        frames: &NodeFrames,
        world: &World,
        clearance: &Clearance,
    ) -> String {
        match clearance.to {
            Obstacle::Nothing => "nothing".into(),
            Obstacle::Floor => "the floor".into(),
            Obstacle::Moving => self.moving.clone(),
            Obstacle::Link(other) => format!("robot link \"{}\"", self.links[other]),
            Obstacle::Fixed => {
                let own = body.spheres.iter().filter(|s| s.link == clearance.link);
                let centers = own.map(|s| (frames.frames[s.node].transform(&s.center), s.radius));
                let nearest = centers.min_by(|(a, r), (b, s)| {
                    let gap = |at: &Vector3<f64>, r: f64| world.fixed.distance(at) - r;
                    gap(a, *r).total_cmp(&gap(b, *s))
                });
                nearest.map_or_else(|| "the scene".into(), |(center, _)| self.nearest(&center))
            }
        }
    }

    fn nearest(&self, point: &Vector3<f64>) -> String {
        let mut best = (f64::INFINITY, "the scene");
        for (name, triangles, [low, high]) in &self.resting {
            let outside = (point.sup(low).inf(high) - point).norm();
            if outside < best.0 {
                let near = triangles.iter().map(|t| point_triangle_distance(point, t));
                let distance = near.fold(f64::INFINITY, f64::min);
                if distance < best.0 {
                    best = (distance, name);
                }
            }
        }
        best.1.into()
    }
}

/// What became of one seed.
enum Tried {
    Free,
    Blocked(String, String, f64),
    Missed([f64; 2], Vec<String>),
}

impl Run<'_> {
    fn explain_reach(
        &self,
        world: &World,
        names: &Names,
        grasps: &[Grasp],
        q: f64,
    ) -> Result<ReachFindings, PlanError> {
        let mut tried = Vec::new();
        for grasp in grasps {
            tried.extend(self.explain_grasp(world, names, grasp, q)?);
        }
        let mut blockers: BTreeMap<(String, String), (u64, f64)> = BTreeMap::new();
        let mut at_limit = BTreeMap::new();
        let mut closest_miss: Option<[f64; 2]> = None;
        let (mut free, mut reached) = (0, 0);
        let seeds = tried.len();
        for outcome in tried {
            match outcome {
                Tried::Free => (free, reached) = (free + 1, reached + 1),
                Tried::Blocked(link, obstacle, lack) => {
                    reached += 1;
                    let entry = blockers.entry((link, obstacle)).or_insert((0, f64::INFINITY));
                    *entry = (entry.0 + 1, entry.1.min(lack));
                }
                Tried::Missed(miss, joints) => {
                    joints.into_iter().for_each(|j| *at_limit.entry(j).or_default() += 1);
                    if closest_miss.is_none_or(|best| miss[0] + miss[1] < best[0] + best[1]) {
                        closest_miss = Some(miss);
                    }
                }
            }
        }
        let blocker =
            |((link, obstacle), (count, least_m))| Blocker { link, obstacle, count, least_m };
        let mut blocked_by: Vec<Blocker> = blockers.into_iter().map(blocker).collect();
        blocked_by.sort_by_key(|b| std::cmp::Reverse(b.count));
        Ok(ReachFindings { position: q, seeds, reached, free, closest_miss, at_limit, blocked_by })
    }

    fn explain_grasp(
        &self,
        world: &World,
        names: &Names,
        grasp: &Grasp,
        q: f64,
    ) -> Result<Vec<Tried>, PlanError> {
        let robot = &self.task.robot;
        let akr = akr::assemble(robot, &self.task.object, grasp)?;
        let variables = &akr.variables[..akr.variables.len() - 1];
        let mut kinematics =
            Kinematics::compile(&akr.tree, &robot.world_from_root, variables, &akr.rest);
        kinematics.draw_in_limits(variables.len(), LIMIT_MARGIN);
        let Some(tool) = Tool::new(robot, &kinematics) else { return Ok(Vec::new()) };
        let (spheres, pairs) = (&self.preparation.spheres, &self.preparation.self_pairs);
        let body = RobotBody::new(robot, spheres, pairs, &kinematics);
        let target = self.tool_target(grasp, q)?;
        let region = self.seed_region();
        let seed = stage_seed(self.task, "explain", u64::from(grasp.id));
        let least = self.config.min_clearance_m;
        let try_seed = |index: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(index as u64);
            let mut x = region.sample(&kinematics, &target, &mut rng);
            let reached = ik::solve(&kinematics, &tool, &target, &mut x, 0);
            let frames = kinematics.forward(&x);
            if !reached {
                let error = pose_error(&tool.frame(&frames), &target);
                let miss = [error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm()];
                let limits = kinematics.lower().iter().zip(kinematics.upper());
                let at_limit =
                    x.iter().zip(limits).zip(variables).filter(|((x, (low, high)), _)| {
                        **x <= **low + 1e-6 || **x >= **high - 1e-6
                    });
                let name = |joint: usize| akr.tree.joints()[joint].name.clone();
                return Tried::Missed(miss, at_limit.map(|(_, &joint)| name(joint)).collect());
            }
            let moving = MovingCheck::NotTool;
            let clearance = body.clearance(&frames, world, q, moving, f64::NEG_INFINITY);
            if clearance.distance_m >= least {
                return Tried::Free;
            }
            let obstacle = names.obstacle(&body, &frames, world, &clearance);
            let link = names.links[clearance.link].clone();
            Tried::Blocked(link, obstacle, least - clearance.distance_m)
        };
        Ok((0..SEEDS).into_par_iter().map(try_seed).collect())
    }

    fn explain_way(
        &self,
        world: &World,
        names: &Names,
        holds: &[Hold],
        goal_index: usize,
    ) -> WayFindings {
        let goal = self.task.file.goal.positions[goal_index];
        let start = self.task.file.goal.start;
        let starts = holds
            .iter()
            .take(FOLLOWED_HOLDS)
            .flat_map(|hold| hold.starts.iter().take(FOLLOWED_STARTS).map(move |x| (hold, x)));
        let starts: Vec<(&Hold, &Vec<f64>)> = starts.collect();
        let stops: Vec<(f64, String)> = starts
            .par_iter()
            .map(|(hold, x)| self.follow_until_stopped(world, names, hold, x, goal))
            .collect();
        let mut stopped_by = BTreeMap::new();
        let mut farthest: Option<f64> = None;
        for (q, reason) in stops {
            *stopped_by.entry(reason).or_default() += 1;
            if farthest.is_none_or(|best| (q - start).abs() > (best - start).abs()) {
                farthest = Some(q);
            }
        }
        WayFindings { goal, followed: starts.len(), farthest, stopped_by }
    }

    /// The joint's position at which following it from `x` ends, and why.
    fn follow_until_stopped(
        &self,
        world: &World,
        names: &Names,
        hold: &Hold,
        x: &[f64],
        goal: f64,
    ) -> (f64, String) {
        let problem = self.problem(world, hold, self.config);
        let object = x.len() - 1;
        let (start, mut at) = (x[object], x.to_vec());
        let mut held = start;
        for step in 1..=STEPS {
            let q = start + (goal - start) * step as f64 / STEPS as f64;
            at[object] = q;
            if !problem.closure.project(problem.kinematics, &mut at, &problem.mobility, true) {
                let error = problem.closure.error(&problem.kinematics.forward(&at));
                let metres = error.fixed_rows::<3>(0).norm();
                let reason = if metres > 1e-3 { "out of reach" } else { "the grasp's direction" };
                return (held, format!("the closed chain: {reason}"));
            }
            if self.base() == 3 && (at[2] - x[2]).abs() > self.config.max_base_yaw_rad {
                return (held, "the base would turn too far".into());
            }
            let frames = problem.kinematics.forward(&at);
            let least = self.config.min_clearance_m;
            let moving = MovingCheck::NotTool;
            let clearance = hold.body.clearance(&frames, world, q, moving, least);
            if clearance.distance_m < least {
                let obstacle = names.obstacle(&hold.body, &frames, world, &clearance);
                return (held, format!("\"{}\" hits {obstacle}", names.links[clearance.link]));
            }
            held = q;
        }
        (held, "nothing: the goal is reached".into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(position: f64, free: usize, blocked_by: Vec<Blocker>, miss: f64) -> ReachFindings {
        let closest_miss = Some([miss, 0.1]);
        let at_limit = BTreeMap::from([("elbow".to_owned(), 3)]);
        ReachFindings { position, seeds: 9, reached: 1, free, closest_miss, at_limit, blocked_by }
    }

    #[test]
    fn the_smallest_violation_comes_first_and_what_is_free_is_left_out() {
        let blocker = |least_m| Blocker {
            link: "forearm".into(),
            obstacle: "scene body \"shelf\"".into(),
            count: 1,
            least_m,
        };
        let found = closest(&[
            at(0.0, 3, vec![blocker(0.001)], 0.5),
            at(0.5, 0, vec![blocker(0.02), blocker(0.007)], 0.5),
            at(1.0, 0, Vec::new(), 0.003),
        ]);
        assert_eq!(found.len(), 2);
        assert!(found[0].text.contains("elbow") && found[0].stage == "reach", "{found:?}");
        assert!(found[1].text.contains("7.0 mm") && found[1].text.contains("shelf"), "{found:?}");
    }
}
