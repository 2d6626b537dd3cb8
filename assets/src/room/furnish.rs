//! What stands where.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use akrobat_model::Pose;
use nalgebra::{Point3, Vector3};
use rand::RngExt as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

use super::layout::{self, CORNER_M, Plan, RUN_M, Run, UNIT_M, on_floor};
use super::{GeneratedScene, PlacedBody, PlacedObject, between};
use crate::appliances::HingeSide;
use crate::description::{CollisionBox, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::kitchen::flattened;
use crate::object::{self, GeneratedObject, ObjectClass, ObjectRequest};
use crate::overlap::WorldBox;
use crate::solid::Solid;

/// Surface of the worktops, and their thickness, metres (EN 1116: 900 mm).
const WORKTOP_M: [f64; 2] = [0.9, 0.038];
/// Gap between furniture and wall, and between neighbours, metres.
const GAP_M: f64 = 0.01;
const WALL_M: f64 = 0.1;
/// Where wall cabinets hang.
const HUNG_M: f64 = 1.45;
/// Sill and lintel of a window, and its width, metres.
const WINDOW_M: [f64; 3] = [1.08, 2.05, 1.1];
/// Distance kept around things that are put down, metres.
const APART_M: f64 = 0.015;

/// What a slot of a run holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unit {
    Refrigerator,
    Oven,
    Dishwasher,
    Sink,
    Drawers,
    Cabinet,
}

pub fn furnished(
    rng: &mut ChaCha8Rng,
    seed: u64,
    confinement: f64,
    palette: &Palette,
) -> Result<GeneratedScene, AssetError> {
    let plan = layout::plan(rng, confinement);
    let mut room = Furnisher { rng, palette, plan, confinement, bodies: vec![], objects: vec![] };
    room.add_units()?;
    room.add_table()?;
    room.add_trash_can()?;
    room.add_clutter()?;
    let Furnisher { plan, bodies, objects, .. } = room;
    Ok(GeneratedScene {
        seed,
        confinement,
        layout: plan.layout,
        room_m: plan.room,
        aisle_m: plan.aisle,
        bodies,
        objects,
        attempts: 0,
        free_floor: 0.0,
    })
}

struct Furnisher<'a> {
    rng: &'a mut ChaCha8Rng,
    palette: &'a Palette,
    plan: Plan,
    confinement: f64,
    bodies: Vec<PlacedBody>,
    objects: Vec<PlacedObject>,
}

impl Furnisher<'_> {
    fn next_name(&self, class: &str) -> String {
        let count = self.bodies.iter().filter(|body| body.class == class).count();
        format!("{class}_{}", count + 1)
    }

    fn add(&mut self, class: &str, mut link: LinkDescription, world_from_body: Pose) {
        let name = self.next_name(class);
        link.name.clone_from(&name);
        self.bodies.push(PlacedBody { name, class: class.into(), world_from_body, link });
    }

    fn draw(
        &mut self,
        class: ObjectClass,
        request: ObjectRequest,
    ) -> Result<GeneratedObject, AssetError> {
        let seed = u64::from(self.rng.random::<u32>());
        let name = self.next_name(class.name());
        object::generate(class, &name, &ObjectRequest { seed, ..request }, self.palette)
    }

    /// Adds an object and its static twin.
    fn add_object(&mut self, object: GeneratedObject, world_from_root: Pose) {
        let class = object.class.name();
        self.add(class, flattened(&object.description, class), world_from_root);
        if object.articulation.is_some() {
            self.objects.push(PlacedObject { object, world_from_root, reached_by: vec![] });
        }
    }

    /// Fills the runs, and builds the walls with a window over the sink and a door.
    fn add_units(&mut self) -> Result<(), AssetError> {
        let slots = self.slots();
        let runs = self.plan.runs.clone();
        let mut window = None;
        for (number, (run, units)) in runs.iter().zip(&slots).enumerate() {
            for (index, unit) in units.iter().enumerate() {
                let y = UNIT_M * (index as f64 + 0.5);
                self.add_unit(run, *unit, y, index == 0)?;
                if *unit == Unit::Sink && run.at_wall {
                    window = Some((number, y));
                }
            }
            self.add_worktop(run, units);
            if run.at_wall {
                self.add_wall_cabinets(run, units, window.filter(|w| w.0 == number).map(|w| w.1))?;
            }
        }
        self.add_shell(&runs, window)
    }

    /// Units by run: what every kitchen has, in an order that keeps the oven away from the refrigerator, the
    /// dishwasher beside the sink.
    fn slots(&mut self) -> Vec<Vec<Unit>> {
        let lengths: Vec<usize> = self.plan.runs.iter().map(|run| run.units).collect();
        let total: usize = lengths.iter().sum();
        let mut order = vec![Unit::Refrigerator, Unit::Cabinet, Unit::Sink, Unit::Dishwasher];
        let fill = [Unit::Drawers, Unit::Cabinet];
        order.push(Unit::Oven);
        order.push(Unit::Drawers);
        // More units go anywhere but between sink and dishwasher.
        while order.len() < total {
            let at = [1, 4, 5, order.len()][self.rng.random_range(0..4)];
            order.insert(at, fill[self.rng.random_range(0..2)]);
        }
        order.truncate(total.max(1));
        let mut rest = order.into_iter();
        lengths.iter().map(|&count| rest.by_ref().take(count).collect()).collect()
    }

    fn add_unit(&mut self, run: &Run, unit: Unit, y: f64, first: bool) -> Result<(), AssetError> {
        let under_worktop = ObjectRequest {
            width_m: Some(UNIT_M - 0.002),
            depth_m: Some(0.555),
            height_m: Some(WORKTOP_M[0] - WORKTOP_M[1]),
            ..ObjectRequest::default()
        };
        // A door beside a wall is hinged on the other side.
        let hinge_side = first.then_some(HingeSide::Left);
        let (class, request) = match unit {
            Unit::Refrigerator => {
                let width_m = Some(UNIT_M - 0.01);
                let depth_m = Some(0.57);
                (
                    ObjectClass::Refrigerator,
                    ObjectRequest { width_m, depth_m, hinge_side, ..ObjectRequest::default() },
                )
            }
            Unit::Oven => {
                (ObjectClass::Oven, ObjectRequest { depth_m: Some(0.545), ..under_worktop })
            }
            Unit::Dishwasher => {
                (ObjectClass::Dishwasher, ObjectRequest { depth_m: Some(0.545), ..under_worktop })
            }
            Unit::Sink => {
                (ObjectClass::BaseCabinet, ObjectRequest { doors: Some(2), ..under_worktop })
            }
            Unit::Drawers => (ObjectClass::DrawerUnit, under_worktop),
            Unit::Cabinet => (
                ObjectClass::BaseCabinet,
                ObjectRequest { doors: Some(1), hinge_side, ..under_worktop },
            ),
        };
        let object = self.draw(class, request)?;
        let pose = run.world_from_run * Pose::translation(GAP_M, y, 0.0);
        self.add_object(object, pose);
        let top = run.world_from_run * Pose::translation(0.3, y, WORKTOP_M[0]);
        match unit {
            Unit::Sink => self.add("sink", sink(self.palette), top),
            Unit::Oven => {
                let mut hob = LinkDescription::new("hob", 0.0);
                hob.add_box("hob", &self.palette.glass, [-0.25, -0.28, 0.0], [0.25, 0.28, 0.006]);
                for (x, y, radius) in [
                    (-0.11, -0.13, 0.08),
                    (-0.11, 0.13, 0.1),
                    (0.12, -0.13, 0.1),
                    (0.12, 0.13, 0.08),
                ] {
                    let ring =
                        Solid::rod(radius, 0.0008, 32).moved(&Pose::translation(x, y, 0.006));
                    hob.add_visual("rings", &self.palette.dark, vec![ring]);
                }
                self.add("hob", hob, top);
            }
            _ => {}
        }
        Ok(())
    }

    /// Worktops over neighbouring units and corners; none over a refrigerator.
    fn add_worktop(&mut self, run: &Run, units: &[Unit]) {
        let [top, thickness] = WORKTOP_M;
        let mut spans: Vec<[f64; 2]> = Vec::new();
        let length = UNIT_M * units.len() as f64;
        if run.corners[0] {
            spans.push([-CORNER_M, 0.0]);
        }
        let gap = CORNER_M - RUN_M;
        if run.adjoins[0] {
            spans.push([-gap, 0.0]);
        }
        for (index, _) in units.iter().enumerate().filter(|(_, u)| **u != Unit::Refrigerator) {
            spans.push([UNIT_M * index as f64, UNIT_M * (index + 1) as f64]);
        }
        if run.corners[1] {
            spans.push([length, length + CORNER_M]);
        }
        if run.adjoins[1] {
            spans.push([length, length + gap]);
        }
        let mut joined: Vec<[f64; 2]> = Vec::new();
        for [start, end] in spans {
            match joined.last_mut() {
                Some(last) if (last[1] - start).abs() < 1e-9 => last[1] = end,
                _ => joined.push([start, end]),
            }
        }
        for [start, end] in joined {
            let mut link = LinkDescription::new("worktop", 0.0);
            let low = [0.0, start + 0.001, top - thickness];
            // At a corner the other run's worktop begins where this one's depth ends.
            link.add_box("worktop", &self.palette.worktop, low, [RUN_M, end - 0.001, top]);
            self.add("worktop", link, run.world_from_run * Pose::translation(0.0, 0.0, 0.0005));
        }
        for (adjoins, y) in [(run.adjoins[0], -gap), (run.adjoins[1], length)] {
            if adjoins {
                let mut filler = LinkDescription::new("filler", 0.0);
                let high = [0.55, y + gap - 0.002, top - thickness];
                filler.add_box("filler", &self.palette.front, [0.0, y + 0.002, 0.0], high);
                self.add("filler", filler, run.world_from_run);
            }
        }
        for (fills, y) in [(run.corners[0], -CORNER_M), (run.corners[1], length)] {
            if fills {
                let mut link = LinkDescription::new("corner_unit", 0.0);
                link.add_box(
                    "corner",
                    &self.palette.front,
                    [0.0, y + 0.001, 0.0],
                    [RUN_M - 0.02, y + CORNER_M - 0.002, top - thickness],
                );
                self.add("corner_unit", link, run.world_from_run);
            }
        }
    }

    fn add_wall_cabinets(
        &mut self,
        run: &Run,
        units: &[Unit],
        window_y: Option<f64>,
    ) -> Result<(), AssetError> {
        for (index, unit) in units.iter().enumerate() {
            let y = UNIT_M * (index as f64 + 0.5);
            let at_window =
                window_y.is_some_and(|w| (w - y).abs() < (WINDOW_M[2] + UNIT_M) / 2.0 + 0.03);
            if at_window || *unit == Unit::Refrigerator {
                continue;
            }
            if *unit == Unit::Oven {
                self.add(
                    "hood",
                    hood(self.palette),
                    run.world_from_run * Pose::translation(0.0, y, 1.62),
                );
            } else if self.rng.random_bool(0.75) {
                let request = ObjectRequest {
                    width_m: Some(UNIT_M - 0.004),
                    depth_m: Some(0.32),
                    height_m: Some(0.72),
                    doors: Some(1),
                    ..ObjectRequest::default()
                };
                let cabinet = self.draw(ObjectClass::WallCabinet, request)?;
                self.add_object(cabinet, run.world_from_run * Pose::translation(0.001, y, HUNG_M));
            }
        }
        // A microwave oven on the worktop, where a unit without sink and hob is.
        let free = |u: &Unit| matches!(u, Unit::Drawers | Unit::Cabinet | Unit::Dishwasher);
        let has_one = self.objects.iter().any(|o| o.object.class == ObjectClass::Microwave);
        let places: Vec<usize> = (0..units.len()).filter(|&i| free(&units[i])).collect();
        if let (false, Some(&index)) = (has_one, places.last()) {
            let microwave = self.draw(ObjectClass::Microwave, ObjectRequest::default())?;
            // Its door swings clear of the worktop's front edge.
            let x = RUN_M - 0.03 - microwave.size_m[0];
            let pose = Pose::translation(x, UNIT_M * (index as f64 + 0.5), WORKTOP_M[0] + 0.001);
            self.add_object(microwave, run.world_from_run * pose);
        }
        Ok(())
    }

    /// Floor and walls. The south wall has a door into the aisle, the sink's wall a window.
    fn add_shell(&mut self, runs: &[Run], window: Option<(usize, f64)>) -> Result<(), AssetError> {
        let [depth, width, height] = self.plan.room;
        let (hx, hy) = (depth / 2.0, width / 2.0);
        let mut floor = LinkDescription::new("floor", 0.0);
        let outer = [hx + WALL_M, hy + WALL_M];
        floor.add_box(
            "floor",
            &self.palette.floor,
            [-outer[0], -outer[1], -WALL_M],
            [outer[0], outer[1], 0.0],
        );
        self.add("floor", floor, Pose::identity());
        // The frame of a wall is that of a run along all of it.
        let walls = [
            (on_floor(-hx, -hy, 0.0), width),
            (on_floor(-hx, hy, -FRAC_PI_2), depth),
            (on_floor(hx, hy, PI), width),
            (on_floor(hx, -hy, FRAC_PI_2), depth),
        ];
        let leaf = if self.plan.aisle < 1.6 { 0.735 } else { 0.86 };
        let request = ObjectRequest {
            width_m: Some(leaf),
            depth_m: Some(WALL_M),
            height_m: Some(1.985),
            ..ObjectRequest::default()
        };
        let door = self.draw(ObjectClass::Door, request)?;
        let [_, door_width, door_height] = door.size_m;
        for (number, (world_from_wall, length)) in walls.into_iter().enumerate() {
            let mut holes: Vec<([f64; 2], [f64; 2])> = Vec::new();
            if let Some((run, y)) = window {
                let in_wall =
                    world_from_wall.inverse() * runs[run].world_from_run * Point3::new(0.0, y, 0.0);
                let facing = world_from_wall.rotation.angle_to(&runs[run].world_from_run.rotation);
                if in_wall.x.abs() < 1e-6 && facing < 1e-6 {
                    let half = WINDOW_M[2] / 2.0;
                    let span = [(in_wall.y - half).max(0.1), (in_wall.y + half).min(length - 0.1)];
                    holes.push((span, [WINDOW_M[0], WINDOW_M[1]]));
                    self.add("window", window_frame(self.palette, span), world_from_wall);
                }
            }
            if number == 3 {
                let y = (hx - self.plan.aisle_x)
                    .clamp(door_width / 2.0 + 0.1, length - door_width / 2.0 - 0.1);
                holes.push((
                    [y - door_width / 2.0 - 0.001, y + door_width / 2.0 + 0.001],
                    [0.0, door_height + 0.001],
                ));
                self.add_object(
                    door.clone(),
                    world_from_wall * Pose::translation(-WALL_M, y, 0.0005),
                );
            }
            let wall = wall(self.palette, length, height, &holes, number % 2 == 0);
            self.add("wall", wall, world_from_wall);
        }
        Ok(())
    }

    /// A table with chairs at the side of +x.
    fn add_table(&mut self) -> Result<(), AssetError> {
        if !self.plan.dining {
            return Ok(());
        }
        let [depth, width, _] = self.plan.room;
        let [half_x, half_y] = [between(self.rng, 0.35, 0.45), between(self.rng, 0.45, 0.7)];
        let x = depth / 2.0 - half_x - 0.12;
        let reach = width / 2.0 - half_y - 0.6;
        let y = if reach > 0.0 { between(self.rng, -reach, reach) } else { 0.0 };
        let mut table = LinkDescription::new("table", 0.0);
        let (height, leg) = (0.74, 0.06);
        let wood = &self.palette.worktop;
        table.add_box("top", wood, [-half_x, -half_y, height - 0.03], [half_x, half_y, height]);
        for lx in [-half_x + 0.03, half_x - 0.03 - leg] {
            for ly in [-half_y + 0.03, half_y - 0.03 - leg] {
                table.add_box("legs", wood, [lx, ly, 0.0], [lx + leg, ly + leg, height - 0.03]);
            }
        }
        self.add("table", table, on_floor(x, y, 0.0));
        // Chairs at both ends, and on the side of the room, pushed under a little.
        let seats = [
            (x, y - half_y - 0.12, FRAC_PI_2),
            (x, y + half_y + 0.12, -FRAC_PI_2),
            (x - half_x - 0.12, y - 0.26, 0.0),
            (x - half_x - 0.12, y + 0.26, 0.0),
        ];
        let count = 2 + (self.confinement * 2.0).round() as usize;
        for (cx, cy, yaw) in seats.into_iter().take(count) {
            let yaw = yaw + between(self.rng, -0.1, 0.1);
            let chair = self.draw(ObjectClass::Chair, ObjectRequest::default())?;
            self.try_add(chair, on_floor(cx, cy, yaw));
        }
        Ok(())
    }

    fn add_trash_can(&mut self) -> Result<(), AssetError> {
        let [depth, width, _] = self.plan.room;
        let (hx, hy) = (depth / 2.0, width / 2.0);
        for _ in 0..24 {
            let bin = self.draw(ObjectClass::TrashCan, ObjectRequest::default())?;
            let along = bin.size_m[1] / 2.0 + 0.08;
            let pose = if self.rng.random_bool(0.5) {
                on_floor(hx - GAP_M, between(self.rng, -hy + along, hy - along), PI)
            } else {
                on_floor(between(self.rng, -hx + along, hx - along), -hy + GAP_M, FRAC_PI_2)
            };
            if self.try_add(bin, pose) {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Things on worktops and tables; the more, the more confined.
    fn add_clutter(&mut self) -> Result<(), AssetError> {
        let surfaces: Vec<(Pose, [f64; 3], [f64; 3])> = self
            .bodies
            .iter()
            .filter(|body| body.class == "worktop" || body.class == "table")
            .filter_map(|body| {
                let top = body.link.collisions.first()?;
                let centre = top.link_from_box.translation.vector;
                let low = std::array::from_fn(|i| centre[i] - top.size[i] / 2.0);
                let high = std::array::from_fn(|i| centre[i] + top.size[i] / 2.0);
                Some((body.world_from_body, low, high))
            })
            .collect();
        let mut classes = [ObjectClass::Box, ObjectClass::Mug, ObjectClass::Bowl];
        for (world_from_surface, low, high) in surfaces {
            let area = (high[0] - low[0]) * (high[1] - low[1]);
            let count = (area * (2.0 + 4.0 * self.confinement)).round() as usize;
            for _ in 0..count {
                classes.shuffle(self.rng);
                let thing = self.draw(classes[0], ObjectRequest::default())?;
                let margin = 0.13;
                if high[0] - low[0] < 2.0 * margin || high[1] - low[1] < 2.0 * margin {
                    continue;
                }
                let x = self.rng.random_range(low[0] + margin..high[0] - margin);
                let y = self.rng.random_range(low[1] + margin..high[1] - margin);
                let turn = on_floor(x, y, self.rng.random_range(0.0..TAU));
                let lift = Pose::translation(0.0, 0.0, high[2] + 0.001);
                self.try_add(thing, world_from_surface * lift * turn);
            }
        }
        Ok(())
    }

    /// Adds an object where nothing is.
    fn try_add(&mut self, object: GeneratedObject, pose: Pose) -> bool {
        let twin = flattened(&object.description, object.class.name());
        let boxes: Vec<WorldBox> =
            twin.collisions.iter().map(|b| WorldBox::new(&pose, b)).collect();
        let on_floor = pose.translation.z < 0.01;
        let blocked = self.bodies.iter().filter(|body| body.class != "floor").any(|body| {
            // What stands on something may touch it.
            let apart = if !on_floor && matches!(body.class.as_str(), "worktop" | "table") {
                0.0
            } else {
                APART_M
            };
            body.link.collisions.iter().any(|shape| {
                let other = WorldBox::new(&body.world_from_body, shape);
                boxes.iter().any(|b| b.penetration(&other) > -apart)
            })
        });
        if !blocked {
            self.add_object(object, pose);
        }
        !blocked
    }
}

fn sink(palette: &Palette) -> LinkDescription {
    let mut sink = LinkDescription::new("sink", 0.0);
    sink.add_box("rim", &palette.handle, [-0.2, -0.24, 0.001], [0.2, 0.24, 0.004]);
    let basin = Solid::cuboid([-0.14, -0.2, 0.001], [0.16, 0.2, 0.0045]);
    sink.add_visual("basin", &palette.dark, vec![basin]);
    let tap =
        [[-0.17, 0.0], [-0.17, 0.16], [-0.15, 0.21], [-0.10, 0.23], [-0.05, 0.21], [-0.03, 0.16]]
            .map(|[x, z]| Point3::new(x, 0.0, z));
    let spout = Solid::bent_rod(&tap, Vector3::y(), 0.012, 12);
    sink.add_visual("tap", &palette.handle, vec![spout]);
    sink.collisions.push(CollisionBox::between(
        "tap",
        [-0.185, -0.015, 0.004],
        [-0.02, 0.015, 0.245],
    ));
    sink
}

fn hood(palette: &Palette) -> LinkDescription {
    let mut hood = LinkDescription::new("hood", 0.0);
    hood.add_box("canopy", &palette.appliance, [0.001, -0.29, 0.0], [0.45, 0.29, 0.06]);
    hood.add_box("duct", &palette.appliance, [0.001, -0.13, 0.06], [0.24, 0.13, 0.7]);
    hood
}

fn window_frame(palette: &Palette, y: [f64; 2]) -> LinkDescription {
    let mut frame = LinkDescription::new("window", 0.0);
    let (bar, x, z) = (0.05, [-0.07, -0.03], [WINDOW_M[0], WINDOW_M[1]]);
    let middle = (y[0] + y[1]) / 2.0;
    for (y, z) in [
        ([y[0] + 0.001, y[0] + bar], [z[0] + 0.001, z[1] - 0.001]),
        ([y[1] - bar, y[1] - 0.001], [z[0] + 0.001, z[1] - 0.001]),
        ([middle - bar / 2.0, middle + bar / 2.0], [z[0] + bar, z[1] - bar]),
        ([y[0] + bar, y[1] - bar], [z[0] + 0.001, z[0] + bar]),
        ([y[0] + bar, y[1] - bar], [z[1] - bar, z[1] - 0.001]),
    ] {
        frame.add_box("frame", &palette.accents[2], [x[0], y[0], z[0]], [x[1], y[1], z[1]]);
    }
    frame
}

/// A wall with holes, `(y, z)` spans that do not share any y. Walls of one direction cover the corners.
fn wall(
    palette: &Palette,
    length: f64,
    height: f64,
    holes: &[([f64; 2], [f64; 2])],
    covers: bool,
) -> LinkDescription {
    let mut wall = LinkDescription::new("wall", 0.0);
    let beyond = if covers { WALL_M } else { 0.0 };
    let mut add = |y: [f64; 2], z: [f64; 2]| {
        if y[1] - y[0] > 1e-6 && z[1] - z[0] > 1e-6 {
            wall.add_box("wall", &palette.wall, [-WALL_M, y[0], z[0]], [-0.0005, y[1], z[1]]);
        }
    };
    let mut holes = holes.to_vec();
    holes.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
    let mut from = -beyond;
    for (y, z) in holes {
        add([from, y[0]], [0.0, height]);
        add(y, [0.0, z[0]]);
        add(y, [z[1], height]);
        from = y[1];
    }
    add([from, length + beyond], [0.0, height]);
    wall
}
