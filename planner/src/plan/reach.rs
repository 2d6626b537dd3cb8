//! Which grasps are within reach, and the configurations that hold them.

use std::sync::OnceLock;

use akrobat_model::ModelError;
use akrobat_model::events::Event;
use akrobat_model::task::Task;
use akrobat_model::trajectory::Grasp;

use super::{Hold, LIMIT_MARGIN, PlanError, Run, stage_seed};
use crate::akr::{self, Akr};
use crate::closure::Closure;
use crate::collision::{MovingCheck, RobotBody};
use crate::ik::{Batch, Effort, Search, SeedRegion, Tool};
use crate::kernels::Config;
use crate::kinematics::{Frame, Kinematics};
use crate::world::{World, handle_center, outward};
use crate::{cluster, grasp};

/// Grasps that are looked at for each one that is used, and seeds that tell whether one is within reach.
const SCREENED_PER_GRASP: usize = 12;
const SCREENING_SEEDS: usize = 100;
/// Solutions among them that suffice, and the number that stands for screening in seeds.
const SCREENING_SOLUTIONS: usize = 2;
const SCREENING_TARGET: usize = 0xffff;
/// Solutions that are clustered, for each cluster that is kept.
const SOLUTIONS_PER_CLUSTER: usize = 4;
/// Room for what single precision makes of a clearance, and for what polishing changes, metres.
const DEVICE_ROUNDING_M: f64 = 1e-3;

impl Run<'_> {
    /// The grasps that are used: the first, in order of diversity, that fit and are within reach at both
    /// ends of the motion.
    pub(super) fn grasps(&mut self, world: &World) -> Result<Vec<Grasp>, PlanError> {
        let task = self.task;
        let wanted = task.file.grasps.count;
        let (fitting, tried) = grasp::grasps(
            task,
            &self.preparation.spheres,
            stage_seed(task, "grasps", 0),
            wanted * SCREENED_PER_GRASP,
        );
        self.count("grasps/candidates", tried);
        self.count("grasps/fitting", fitting.len());
        let mut chosen = Vec::new();
        for grasp in fitting {
            if self.observer.cancelled() {
                return Err(PlanError::Cancelled);
            }
            if chosen.len() == wanted {
                break;
            }
            if self.is_within_reach(world, &grasp)? {
                chosen.push(Grasp { id: chosen.len() as u32, ..grasp });
            }
        }
        if task.file.goal.regrasps > 0 {
            self.add_partial_grasps(world, &mut chosen)?;
        }
        self.count("grasps/used", chosen.len());
        Ok(chosen)
    }

    /// Grasps for a part of the way: those that are within reach at the start, and those that fit and are
    /// within reach at a goal.
    fn add_partial_grasps(
        &mut self,
        world: &World,
        chosen: &mut Vec<Grasp>,
    ) -> Result<(), PlanError> {
        let goal = &self.task.file.goal;
        for (index, q) in std::iter::once(goal.start).chain(goal.positions.clone()).enumerate() {
            let mut task = self.task.clone();
            task.object.start = task.object.configuration(q);
            let wanted = chosen.len() + task.file.grasps.count;
            let seed = stage_seed(&task, "partial grasps", index as u64);
            let most = task.file.grasps.count * SCREENED_PER_GRASP;
            let (fitting, tried) = grasp::grasps(&task, &self.preparation.spheres, seed, most);
            self.count("grasps/candidates", tried);
            self.count("grasps/fitting", fitting.len());
            for grasp in fitting {
                if self.observer.cancelled() {
                    return Err(PlanError::Cancelled);
                }
                if chosen.len() >= wanted {
                    break;
                }
                if self.reaches(world, &grasp, q)? {
                    chosen.push(Grasp { id: chosen.len() as u32, ..grasp });
                }
            }
        }
        Ok(())
    }

    /// True where a few seeds give free configurations at the start and at a goal.
    fn is_within_reach(&self, world: &World, grasp: &Grasp) -> Result<bool, PlanError> {
        let goal = &self.task.file.goal;
        if !self.reaches(world, grasp, goal.start)? {
            return Ok(false);
        }
        for &q in &goal.positions {
            if self.reaches(world, grasp, q)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// True where a few seeds give free configurations with the object's joint at `q`.
    fn reaches(&self, world: &World, grasp: &Grasp, q: f64) -> Result<bool, PlanError> {
        let akr = akr::assemble(&self.task.robot, &self.task.object, grasp)?;
        let effort = Effort { seeds: SCREENING_SEEDS, enough: SCREENING_SOLUTIONS };
        let batch = self.solve(world, &akr, grasp, q, SCREENING_TARGET, effort)?;
        Ok(batch.accepted.len() >= SCREENING_SOLUTIONS)
    }

    /// Inverse kinematics at the start, for every grasp; clustered.
    pub(super) fn holds(
        &mut self,
        world: &World,
        grasps: &[Grasp],
    ) -> Result<Vec<Hold>, PlanError> {
        let stage = "inverse kinematics";
        self.observer.event(&Event::StageStarted { stage, total: Some(grasps.len() as u64) });
        let mut holds = Vec::new();
        for (grasp, done) in grasps.iter().zip(1..) {
            if self.observer.cancelled() {
                return Err(PlanError::Cancelled);
            }
            if let Some(hold) = self.hold(world, grasp)? {
                holds.push(hold);
            }
            self.observer.event(&Event::Progress { stage, done });
        }
        Ok(holds)
    }

    fn hold(&mut self, world: &World, grasp: &Grasp) -> Result<Option<Hold>, PlanError> {
        let task = self.task;
        let akr = akr::assemble(&task.robot, &task.object, grasp)?;
        let mut kinematics =
            Kinematics::compile(&akr.tree, &task.robot.world_from_root, &akr.variables, &akr.rest);
        kinematics.draw_in_limits(akr.variables.len() - 1, LIMIT_MARGIN);
        let body = RobotBody::new(
            &task.robot,
            &self.preparation.spheres,
            &self.preparation.self_pairs,
            &kinematics,
        );
        let Some(closure) = Closure::new(&akr, &kinematics, &task.object.world_from_root) else {
            return Ok(None);
        };
        let mut hold = Hold {
            grasp: grasp.clone(),
            kinematics,
            body,
            closure,
            starts: Vec::new(),
            clustered_starts: 0,
            approaches: Vec::new(),
            goals: Vec::new(),
        };
        (hold.starts, hold.clustered_starts) = self.starts(world, &akr, &hold)?;
        hold.approaches = hold.starts.iter().map(|_| OnceLock::new()).collect();
        if hold.starts.is_empty() {
            self.count("grasps/without_start", 1);
            if task.file.goal.regrasps == 0 {
                return Ok(None);
            }
        }
        Ok(Some(hold))
    }

    /// Inverse kinematics at every goal, for every grasp; clustered.
    pub(super) fn find_goals(
        &mut self,
        world: &World,
        holds: &mut [Hold],
    ) -> Result<(), PlanError> {
        let task = self.task;
        for hold in holds {
            if self.observer.cancelled() {
                return Err(PlanError::Cancelled);
            }
            let akr = akr::assemble(&task.robot, &task.object, &hold.grasp)?;
            for (index, &goal) in task.file.goal.positions.iter().enumerate() {
                let found = self.configurations(world, &akr, hold, goal, index + 1)?;
                hold.goals.push(found);
            }
        }
        Ok(())
    }

    /// Collision-free configurations at the start: the representatives of clusters, then all others. Tells how many
    /// there are of the first kind.
    fn starts(
        &mut self,
        world: &World,
        akr: &Akr,
        hold: &Hold,
    ) -> Result<(Vec<Vec<f64>>, usize), PlanError> {
        let q = self.task.file.goal.start;
        let found = self.free_configurations(world, akr, hold, q, 0)?;
        let mut order = self.representatives(hold, &found, 0);
        let clustered = order.len();
        let others = (0..found.len()).filter(|index| !order.contains(index));
        order.extend(others.collect::<Vec<_>>());
        Ok((order.into_iter().map(|index| found[index].clone()).collect(), clustered))
    }

    /// Clustered, collision-free configurations with the object's joint at `q`.
    pub(super) fn configurations(
        &mut self,
        world: &World,
        akr: &Akr,
        hold: &Hold,
        q: f64,
        target_index: usize,
    ) -> Result<Vec<Vec<f64>>, PlanError> {
        let mut found = self.free_configurations(world, akr, hold, q, target_index)?;
        let chosen = self.representatives(hold, &found, target_index);
        Ok(chosen.into_iter().map(|index| std::mem::take(&mut found[index])).collect())
    }

    /// Collision-free configurations with the object's joint at `q`, which is their last variable.
    fn free_configurations(
        &mut self,
        world: &World,
        akr: &Akr,
        hold: &Hold,
        q: f64,
        target_index: usize,
    ) -> Result<Vec<Vec<f64>>, PlanError> {
        let enough = SOLUTIONS_PER_CLUSTER * self.config.ik_clusters;
        let effort = Effort { seeds: self.config.ik_seeds, enough };
        let batch = self.solve(world, akr, &hold.grasp, q, target_index, effort)?;
        self.count("ik/seeds", batch.seeds);
        self.count("ik/solved", batch.solved);
        self.count("ik/free", batch.accepted.len());
        let mut found = batch.accepted;
        found.iter_mut().for_each(|x| x.push(q));
        Ok(found)
    }

    /// Indices of the configurations that stand for their clusters.
    fn representatives(&self, hold: &Hold, found: &[Vec<f64>], target_index: usize) -> Vec<usize> {
        let weights = vec![1.0; hold.kinematics.dof()];
        let seed = ik_seed(self.task, &hold.grasp, target_index);
        cluster::representatives(found, &weights, 10, self.config.ik_clusters, 500, seed)
    }

    /// Collision-free base and arm configurations that hold the object with its joint at `q`.
    pub(super) fn solve(
        &self,
        world: &World,
        akr: &Akr,
        grasp: &Grasp,
        q: f64,
        target_index: usize,
        effort: Effort,
    ) -> Result<Batch, PlanError> {
        let robot = &self.task.robot;
        let variables = &akr.variables[..akr.variables.len() - 1];
        let mut kinematics =
            Kinematics::compile(&akr.tree, &robot.world_from_root, variables, &akr.rest);
        kinematics.draw_in_limits(variables.len(), LIMIT_MARGIN);
        let Some(tool) = Tool::new(robot, &kinematics) else { return Ok(Batch::default()) };
        let body = RobotBody::new(
            robot,
            &self.preparation.spheres,
            &self.preparation.self_pairs,
            &kinematics,
        );
        // Half way to what optimisation aims at: a path that leaves here has room on all sides.
        let least = f64::midpoint(self.config.min_clearance_m, self.config.clearance_m);
        let prefilter =
            |x: &[f64]| self.base() == 0 || body.base_is_free(&kinematics.forward(x), world, -0.05);
        let accept = |x: &[f64]| {
            let frames = kinematics.forward(x);
            let clearance = body.clearance(&frames, world, q, MovingCheck::NotTool, least);
            clearance.distance_m >= least
        };
        let search = Search {
            kinematics: &kinematics,
            tool: &tool,
            target: &self.tool_target(grasp, q)?,
            region: &self.seed_region(),
            seed: ik_seed(self.task, grasp, target_index),
            effort,
            prefilter: &prefilter,
            accept: &accept,
        };
        let Some(device) = self.device else { return Ok(search.on_cpu()) };
        let solve =
            |seeds: &[Config]| device.solve_ik(&kinematics, &body, &tool, search.target, q, seeds);
        let ahead = device.gpu().chunks_ahead();
        Ok(search.on_device(solve, ahead, least - DEVICE_ROUNDING_M)?)
    }

    /// World frame of the tool that holds the object with its joint at `q`.
    pub(super) fn tool_target(&self, grasp: &Grasp, q: f64) -> Result<Frame, ModelError> {
        let object = &self.task.object;
        let poses = object.tree.link_poses(&object.world_from_root, &object.configuration(q));
        let link = object.tree.link_index(&grasp.link)?;
        Ok(Frame::from(&(poses[link] * grasp.link_from_tool)))
    }

    pub(super) fn seed_region(&self) -> SeedRegion {
        let robot = &self.task.robot;
        let base = self.base();
        let poses = robot.tree.link_poses(&robot.world_from_root, &robot.rest);
        let mount =
            robot.arm_joints.first().map_or(robot.tree.root(), |&j| robot.tree.joints()[j].parent);
        let mut offset = [0.0, 0.0];
        if base == 3 {
            let foot = robot.tree.joints()[robot.base_joints[2]].child;
            let relative = poses[foot].inverse() * poses[mount];
            offset = [relative.translation.x, relative.translation.y];
        }
        let handle = handle_center(&self.task.object);
        SeedRegion {
            base,
            mount: offset,
            outward: outward(&self.task.object, &handle),
            distance_m: [0.3, 0.85],
            half_angle: 2.0,
        }
    }
}

fn ik_seed(task: &Task, grasp: &Grasp, target_index: usize) -> u64 {
    stage_seed(task, "ik", u64::from(grasp.id) << 16 | target_index as u64)
}
