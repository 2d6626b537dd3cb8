//! Puts the checks together.

use akrobat_model::robot::Robot;
use akrobat_model::task::{ObjectKind, Task};
use akrobat_model::trajectory::{ContactException, Grasp, Segment};
use akrobat_model::{Phase, Trajectory, Verdict};

use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;

use crate::bodies::{Obstacle, link_solids};
use crate::contacts::{ContactTable, LinkPairs, RobotGroups, contact_table};
use crate::convex::ConvexPiece;
use crate::finding::Finding;
use crate::free;
use crate::grip::{Grip, finger_width_m};
use crate::kinematics::{Frame, Kinematics};
use crate::meshes::{self, Region};
use crate::motion::Motion;
use crate::object::{self, StartDepths};
use crate::path::{Configuration, Hold, Place, configurations};
use crate::spheres::{self, RobotSphere, SpherePair};
use crate::structure;
use crate::travel::{self, Travel};
use crate::{JudgeConfig, JudgeError};

/// Robot, object and scene, prepared for the collision checks.
pub struct Geometry {
    /// Robot link names, for reports.
    pub link_names: Vec<String>,
    /// Collision spheres.
    pub spheres: Vec<RobotSphere>,
    /// Links whose spheres must not overlap.
    pub sphere_pairs: Vec<SpherePair>,
    /// Solids of the robot, each with its link.
    pub robot_solids: Vec<(usize, ConvexPiece)>,
    /// Pairs of robot solids that must not enter each other.
    pub solid_pairs: Vec<(usize, usize)>,
    /// The scene, then each link of the object.
    pub obstacles: Vec<Obstacle>,
    /// By robot link and obstacle.
    pub contacts: ContactTable,
    /// Bounds of the handle in the held link's frame.
    pub handle_region: Option<Region>,
    /// For each object link, whether the driven joint moves it.
    pub moving_links: Vec<bool>,
    /// Names of the object's links, for reports.
    pub object_link_names: Vec<String>,
    /// Solids that the driven joint moves, each with its object link.
    pub moving_solids: Vec<(usize, ConvexPiece)>,
    /// How deep they are in everything else at the start.
    pub start_depths: StartDepths,
    /// Bounds of the spheres and solids of each robot link, in its frame.
    pub link_bounds: Vec<Option<Aabb>>,
    /// Bounds of each object link, in its frame.
    pub object_bounds: Vec<Option<Aabb>>,
}

impl Geometry {
    /// True for obstacles that the driven joint moves.
    pub fn is_moving_obstacle(&self, obstacle: usize) -> bool {
        obstacle > 0 && self.moving_links[obstacle - 1]
    }
}

/// Where everything is in one configuration.
pub struct Scenery {
    /// Where on the path.
    pub place: Place,
    /// World frames of the robot's links.
    pub robot: Vec<Frame>,
    /// World frames of the object's links.
    pub object: Vec<Frame>,
    /// For each obstacle.
    pub obstacle_from_world: Vec<Frame>,
    /// The ways of the robot's links.
    pub robot_travel: Vec<Travel>,
    /// The ways of the obstacles.
    pub obstacle_travel: Vec<Travel>,
}

/// Judges trajectories of one task. It is built once and used from any number of threads.
pub struct Judge {
    task: Task,
    config: JudgeConfig,
    robot: Kinematics,
    object: Kinematics,
    geometry: Geometry,
    notes: Vec<String>,
}

impl Judge {
    /// Prepares the geometry of a task.
    ///
    /// `spheres` are the robot's collision spheres, `exceptions` the only robot-object pairs that may
    /// touch. What else may touch, and is listed in [`Judge::notes`]: robot links that are attached to
    /// each other or joined by one moving joint, the fingers, pairs of the robot file, pairs that touch
    /// in the robot's rest configuration, and the links of the base with scene bodies whose class names
    /// a floor or ground.
    ///
    /// # Errors
    /// Where a tolerance, a sphere, an exception or a collision shape is not valid.
    pub fn new(
        task: &Task,
        spheres: &[RobotSphere],
        exceptions: &[ContactException],
        config: JudgeConfig,
    ) -> Result<Self, JudgeError> {
        config.validate()?;
        check_spheres(spheres, &task.robot)?;
        let mut notes = Vec::new();
        let robot = Kinematics::new(&task.robot.tree, &task.robot.world_from_root);
        let object = Kinematics::new(&task.object.tree, &task.object.world_from_root);
        let groups = RobotGroups::new(&task.robot);
        let mut geometry = geometry(task, spheres, exceptions, &groups, &mut notes)?;

        let rest = robot.link_frames(&task.robot.rest);
        let mut sphere_links = LinkPairs::new(&task.robot, &groups);
        let mut solid_links = sphere_links.clone();
        geometry.sphere_pairs = spheres::pairs(spheres, &sphere_links);
        geometry.solid_pairs =
            meshes::pairs(geometry.robot_solids.iter().map(|s| s.0), &solid_links);
        let overlapping = spheres::overlapping_links(spheres, &geometry.sphere_pairs, &rest);
        let penetrating = meshes::penetrating_links(&geometry, &rest, config.penetration_m);
        mask(&mut sphere_links, &overlapping, "spheres", &geometry.link_names, &mut notes);
        mask(&mut solid_links, &penetrating, "meshes", &geometry.link_names, &mut notes);
        geometry.sphere_pairs = spheres::pairs(spheres, &sphere_links);
        geometry.solid_pairs =
            meshes::pairs(geometry.robot_solids.iter().map(|s| s.0), &solid_links);

        let start = Scenery::new(
            Place { sample: 0.0, time_s: 0.0, phase: Phase::Approach },
            rest,
            object.link_frames(&task.object.start),
        );
        geometry.start_depths = object::start_depths(&geometry, &start);
        Ok(Self { task: task.clone(), config, robot, object, geometry, notes })
    }

    /// What the user should know about how the geometry is judged, in the user's words.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The tolerances.
    pub fn config(&self) -> &JudgeConfig {
        &self.config
    }

    #[cfg(test)]
    pub(crate) fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Judges the dense path and the waypoints as they are stored.
    ///
    /// The reason given is the first in the order of [`akrobat_model::Rejection`]. A trajectory that
    /// fails a check that needs no geometry is not looked at further, one with a colliding sphere not
    /// for penetration: what was not looked for is 0 in the verdict.
    pub fn judge(&self, trajectory: &Trajectory) -> Verdict {
        let mut verdict = Verdict {
            rejection: None,
            detail: String::new(),
            anchor_translation_m: 0.0,
            anchor_rotation_rad: 0.0,
            velocity_fraction: 0.0,
            acceleration_fraction: 0.0,
            base_yaw_rad: 0.0,
            penetration_m: 0.0,
            samples: 0,
        };
        if let Err(finding) = self.examine(trajectory, &mut verdict) {
            verdict.rejection = Some(finding.rejection);
            verdict.detail = finding.detail;
        }
        verdict
    }

    fn examine(&self, trajectory: &Trajectory, verdict: &mut Verdict) -> Result<(), Finding> {
        let robot_columns = self.task.robot.trajectory_joints().len();
        structure::check(trajectory, robot_columns, self.task.object.tree.dof())?;
        let held_links = self.held_links(trajectory)?;
        let configurations = configurations(trajectory, self.config.configurations_between);
        let mut sceneries: Vec<Scenery> = configurations.iter().map(|c| self.scenery(c)).collect();
        measure_travel(&self.geometry, &mut sceneries);
        verdict.samples = configurations.len() as u32;

        let motion = self.motion(trajectory, &held_links, &configurations, &sceneries);
        verdict.anchor_translation_m = motion.anchor_translation_m;
        verdict.anchor_rotation_rad = motion.anchor_rotation_rad;
        verdict.velocity_fraction = motion.velocity_fraction;
        verdict.acceleration_fraction = motion.acceleration_fraction;
        verdict.base_yaw_rad = motion.base_yaw_rad;
        refuse_first(motion.findings.into_iter().min_by_key(|finding| finding.rejection))?;

        if free::is_free(&self.task)
            && let (Some(first), Some(last)) = (sceneries.first(), sceneries.last())
        {
            let gap_m = self.config.support_gap_m;
            refuse_first(free::support(&self.geometry, first, gap_m))?;
            refuse_first(free::support(&self.geometry, last, gap_m))?;
        }
        refuse_first(spheres::check(&self.geometry, &sceneries, self.config.sphere_tolerance_m))?;
        let penetration = meshes::deepest(&self.geometry, &sceneries);
        verdict.penetration_m = penetration.depth_m;
        refuse_first(meshes::finding(&penetration, self.config.penetration_m))?;
        refuse_first(object::check(&self.geometry, &sceneries, self.config.penetration_m))
    }

    fn motion(
        &self,
        trajectory: &Trajectory,
        held_links: &[usize],
        configurations: &[Configuration],
        sceneries: &[Scenery],
    ) -> Motion {
        let (task, config) = (&self.task, &self.config);
        let segments = trajectory.segments();
        let grasps: Vec<&Grasp> = segments.iter().map(|segment| segment.grasp).collect();
        let link_from_tool = Frame::from_pose(&task.robot.link_from_tool);
        let link_from_grasp: Vec<Frame> =
            grasps.iter().map(|grasp| Frame::from_pose(&grasp.link_from_tool)).collect();
        let grips = configurations.iter().zip(sceneries).filter_map(|(configuration, scenery)| {
            let (Hold::Closing(grasp) | Hold::Held(grasp) | Hold::Leaving(grasp)) =
                configuration.hold
            else {
                return None;
            };
            let world_from_tool = scenery.robot[task.robot.tool_link].then(&link_from_tool);
            let grasp_from_tool = |grasp: usize| {
                let link = scenery.object[held_links[grasp]];
                link.then(&link_from_grasp[grasp]).inverse().then(&world_from_tool)
            };
            Some(Grip {
                place: configuration.place,
                hold: configuration.hold,
                width_m: finger_width_m(&task.robot, &configuration.robot),
                grasp_from_tool: grasp_from_tool(grasp),
                next_from_tool: (grasp + 1 < grasps.len()).then(|| grasp_from_tool(grasp + 1)),
            })
        });
        let mut motion = Motion::default();
        motion.check_grip(grips, &grasps, config);
        if free::is_free(task) {
            let body = free::body_link(task);
            let last = *trajectory.manipulation_samples().end();
            let at_last = |(c, _): &(&Configuration, &Scenery)| c.place.sample == last as f64;
            if let Some((_, scenery)) = configurations.iter().zip(sceneries).find(at_last) {
                let found = free::object_motion(trajectory, task, &scenery.object[body], config);
                motion.object_moved(found);
            }
        } else {
            motion.check_object(trajectory, task, config);
        }
        if task.file.object.kind == ObjectKind::Planar {
            let body = free::body_link(task);
            let carried = configurations.iter().zip(sceneries).filter_map(|(c, scenery)| {
                let Hold::Held(grasp) = c.hold else { return None };
                let link_from_body =
                    scenery.object[held_links[grasp]].inverse().then(&scenery.object[body]);
                let world_from_tool = scenery.robot[task.robot.tool_link].then(&link_from_tool);
                let world_from_link = world_from_tool.then(&link_from_grasp[grasp].inverse());
                let world_from_body = world_from_link.then(&link_from_body);
                Some(free::Carried { place: c.place, world_from_body })
            });
            let start = self.object.link_frames(&task.object.start)[body];
            motion.check_plane(carried, &start, config);
        }
        motion.check_positions(configurations, &task.robot, &task.object, config);
        motion.check_rates(trajectory, &task.robot, config);
        motion.check_base_yaw(trajectory, &task.robot, config);
        motion
    }

    /// The object link that each grasp holds.
    fn held_links(&self, trajectory: &Trajectory) -> Result<Vec<usize>, Finding> {
        let malformed = |detail: String| Finding::new(akrobat_model::Rejection::Malformed, detail);
        let link = |segment: Segment<'_>| {
            let pose = &segment.grasp.link_from_tool;
            let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            if !numbers.copied().all(f64::is_finite) {
                return Err(malformed("the grasp pose has a number that is not finite".into()));
            }
            let found = self.task.object.tree.link_index(&segment.grasp.link);
            found.map_err(|error| malformed(error.to_string()))
        };
        trajectory.segments().into_iter().map(link).collect()
    }

    fn scenery(&self, configuration: &Configuration) -> Scenery {
        let robot = &self.task.robot;
        let mut q = robot.rest.clone();
        for (joint, &position) in robot.trajectory_joints().iter().zip(&configuration.robot) {
            if let Some(column) = robot.tree.dof_joints().iter().position(|dof| dof == joint) {
                q[column] = position;
            }
        }
        Scenery::new(
            configuration.place,
            self.robot.link_frames(&q),
            self.object.link_frames(&configuration.object),
        )
    }
}

impl Scenery {
    /// Places the links, and from them the obstacles.
    pub fn new(place: Place, robot: Vec<Frame>, object: Vec<Frame>) -> Self {
        let links = object.iter().map(Frame::inverse);
        let obstacle_from_world: Vec<Frame> =
            std::iter::once(Frame::IDENTITY).chain(links).collect();
        Self {
            place,
            robot_travel: vec![0.0; robot.len()],
            obstacle_travel: vec![0.0; obstacle_from_world.len()],
            robot,
            object,
            obstacle_from_world,
        }
    }
}

/// Fills in the ways of links and obstacles along a path.
fn measure_travel(geometry: &Geometry, sceneries: &mut [Scenery]) {
    for index in 1..sceneries.len() {
        let (earlier, later) = sceneries.split_at_mut(index);
        let (before, now) = (&earlier[index - 1], &mut later[0]);
        let robot = Some((&before.robot[..], &before.robot_travel[..]));
        now.robot_travel = travel::after(&geometry.link_bounds, robot, &now.robot);
        // The scene, which comes first, stays where it is.
        let object = Some((&before.object[..], &before.obstacle_travel[1..]));
        let links = travel::after(&geometry.object_bounds, object, &now.object);
        now.obstacle_travel = std::iter::once(0.0).chain(links).collect();
    }
}

fn refuse_first(finding: Option<Finding>) -> Result<(), Finding> {
    finding.map_or(Ok(()), Err)
}

fn geometry(
    task: &Task,
    spheres: &[RobotSphere],
    exceptions: &[ContactException],
    groups: &RobotGroups,
    notes: &mut Vec<String>,
) -> Result<Geometry, JudgeError> {
    let (robot, object) = (&task.robot.tree, &task.object.tree);
    let mut solids = Vec::new();
    for (link, description) in robot.links().iter().enumerate() {
        solids.extend(link_solids(description, notes)?.into_iter().map(|solid| (link, solid)));
    }
    let mut obstacles = vec![Obstacle::of_scene(&task.scene)?];
    for link in object.links() {
        obstacles.push(Obstacle::of_link(link, notes)?);
    }
    note_floors(&obstacles[0], notes);
    let moving_links = object::moving_links(&task.object);
    let mut moving_solids = Vec::new();
    for (link, description) in
        object.links().iter().enumerate().filter(|(link, _)| moving_links[*link])
    {
        let solids = link_solids(description, notes)?;
        moving_solids.extend(solids.into_iter().map(|solid| (link, solid)));
    }
    Ok(Geometry {
        link_names: robot.links().iter().map(|link| link.name.clone()).collect(),
        spheres: spheres.to_vec(),
        sphere_pairs: Vec::new(),
        link_bounds: link_bounds(robot.links().len(), spheres, &solids),
        robot_solids: solids,
        solid_pairs: Vec::new(),
        object_bounds: obstacles[1..].iter().map(Obstacle::bounds).collect(),
        contacts: contact_table(task, &obstacles, groups, exceptions)?,
        handle_region: task.object.handle_region,
        object_link_names: object.links().iter().map(|link| link.name.clone()).collect(),
        moving_solids,
        moving_links,
        start_depths: StartDepths::new(),
        obstacles,
    })
}

fn link_bounds(
    links: usize,
    spheres: &[RobotSphere],
    solids: &[(usize, ConvexPiece)],
) -> Vec<Option<Aabb>> {
    let of_link = |link: usize| {
        let balls = spheres.iter().filter(move |s| s.link == link);
        let balls = balls.map(|s| travel::ball(Vector::from(s.center), s.radius));
        let solids = solids.iter().filter(move |(l, _)| *l == link).map(|(_, s)| s.bounds);
        travel::around(balls.chain(solids))
    };
    (0..links).map(of_link).collect()
}

fn note_floors(scene: &Obstacle, notes: &mut Vec<String>) {
    for floor in scene.owners.iter().filter(|owner| owner.is_floor) {
        notes.push(format!(
            "the base stands on {}: contact between them is not judged",
            floor.label
        ));
    }
}

/// Stops checking pairs that touch in the rest configuration, and says so.
fn mask(
    pairs: &mut LinkPairs,
    touching: &[[usize; 2]],
    what: &str,
    names: &[String],
    notes: &mut Vec<String>,
) {
    for &[a, b] in touching {
        if pairs.checked(a, b) {
            pairs.ignore(a, b);
            notes.push(format!(
                "{what} of links \"{}\" and \"{}\" touch at rest: the pair is not judged",
                names[a], names[b]
            ));
        }
    }
}

fn check_spheres(spheres: &[RobotSphere], robot: &Robot) -> Result<(), JudgeError> {
    let links = robot.tree.links().len();
    for (index, sphere) in spheres.iter().enumerate() {
        let fail = |message: String| Err(JudgeError::Sphere { index, message });
        if sphere.link >= links {
            return fail(format!("link index {} of a robot with {links} links", sphere.link));
        }
        if !sphere.center.iter().all(|c| c.is_finite()) {
            return fail("its centre is not finite".into());
        }
        if !(sphere.radius.is_finite() && sphere.radius > 0.0) {
            return fail(format!("radius {}, expected a positive number", sphere.radius));
        }
    }
    Ok(())
}
