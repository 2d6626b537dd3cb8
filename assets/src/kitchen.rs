//! A furnished kitchen around three things to open.
//!
//! The room is 4.8 x 4.2 m and 2.5 m high, centred on the origin, with the floor at z = 0. A run of seven units
//! of 600 mm stands along the wall x = -2.4 and faces +x; in front of it 2.3 m are free for a robot. A table
//! with chairs stands at the other side.

use akrobat_model::Pose;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::appliances::{Appliance, Cabinet, DrawerUnit, HingeSide, Microwave, Refrigerator};
use crate::description::{CollisionBox, Description, JointDescription, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::HandleStyle;
use crate::solid::Solid;

/// Inner dimensions of the room, metres.
pub const ROOM_M: [f64; 3] = [4.8, 4.2, 2.5];

/// Height of the worktop's surface and its thickness, metres (EN 1116: 900 mm).
const WORKTOP_M: [f64; 2] = [0.9, 0.038];
/// Depth of the worktop, metres (EN 1116: 600 mm).
const WORKTOP_DEPTH_M: f64 = 0.6;
const UNIT_M: f64 = 0.6;
const WALL_M: f64 = 0.1;
/// Gap between furniture and wall.
const GAP_M: f64 = 0.01;

/// Something in the kitchen that can be opened: in the scene it is a static body of the same shape.
#[derive(Debug, Clone)]
pub struct Openable {
    /// The articulated object.
    pub appliance: Appliance,
    /// Its static body in the scene, to be left out where the object itself is used.
    pub body: String,
    /// Where it stands: translation of its root frame in the world, metres; the axes are parallel.
    pub world_from_root: [f64; 3],
}

/// A generated kitchen.
#[derive(Debug, Clone)]
pub struct Kitchen {
    /// All static bodies, as links fixed to an empty root; those of the openable things included.
    pub scene: Description,
    /// A microwave oven, a base cabinet and a drawer unit.
    pub openables: Vec<Openable>,
}

impl Kitchen {
    /// The kitchen of a seed.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a sampled appliance cannot be built.
    pub fn generate(seed: u64) -> Result<Self, AssetError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let palette = Palette::sample(&mut rng);
        let openables = openables(&mut rng, &palette)?;
        let mut scene = SceneBuilder::new();
        scene.add_shell(&palette);
        for openable in &openables {
            scene.add_static(&openable.body, &openable.appliance, openable.world_from_root);
        }
        scene.add_units(&palette)?;
        scene.add_worktop(&palette);
        scene.add_table(&mut rng, &palette);
        scene.add_clutter(&mut rng, &palette);
        Ok(Self { scene: scene.description, openables })
    }
}

/// Middle of a unit of the run, 0 to 6 along +y.
fn unit_y(unit: usize) -> f64 {
    (unit as f64 - 3.0) * UNIT_M
}

/// x of the backs of the run's units.
fn back_x() -> f64 {
    -ROOM_M[0] / 2.0 + GAP_M
}

fn openables(rng: &mut ChaCha8Rng, palette: &Palette) -> Result<Vec<Openable>, AssetError> {
    let style = if rng.random_bool(0.5) { HandleStyle::BAR } else { HandleStyle::ARCH };
    let hinge_side = if rng.random_bool(0.5) { HingeSide::Left } else { HingeSide::Right };
    let microwave = Microwave {
        width_m: rng.random_range(0.46..0.51),
        depth_m: rng.random_range(0.35..0.40),
        height_m: rng.random_range(0.27..0.30),
        handle: HandleStyle::Bar { spacing_m: 0.128, diameter_m: 0.012, clearance_m: 0.035 },
        ..Microwave::default()
    };
    let cabinet = Cabinet { hinge_side, handle: style, ..Cabinet::default() };
    let drawers = DrawerUnit { handle: style, ..DrawerUnit::default() };
    // The microwave's door swings clear of the worktop's front edge.
    let microwave_x = back_x() + WORKTOP_DEPTH_M - 0.04 - microwave.depth_m;
    Ok(vec![
        Openable {
            appliance: microwave.build("microwave", palette)?,
            body: "microwave".into(),
            world_from_root: [microwave_x, unit_y(5), WORKTOP_M[0]],
        },
        Openable {
            appliance: cabinet.build("base_cabinet", palette)?,
            body: "base_cabinet_4".into(),
            world_from_root: [back_x(), unit_y(4), 0.0],
        },
        Openable {
            appliance: drawers.build("drawer_unit", palette)?,
            body: "drawer_unit_2".into(),
            world_from_root: [back_x(), unit_y(2), 0.0],
        },
    ])
}

struct SceneBuilder {
    description: Description,
}

impl SceneBuilder {
    fn new() -> Self {
        let root = LinkDescription::new("kitchen", 0.0);
        Self {
            description: Description {
                name: "kitchen".into(),
                links: vec![root],
                joints: Vec::new(),
            },
        }
    }

    fn add(&mut self, link: LinkDescription, origin: [f64; 3]) {
        self.description.joints.push(JointDescription {
            name: format!("{}_mount", link.name),
            parent: "kitchen".into(),
            child: link.name.clone(),
            origin,
            motion: None,
        });
        self.description.links.push(link);
    }

    fn add_static(&mut self, name: &str, appliance: &Appliance, origin: [f64; 3]) {
        self.add(flattened(&appliance.description, name), origin);
    }

    /// Floor and walls; the wall behind the run has a window.
    fn add_shell(&mut self, palette: &Palette) {
        let [half_x, half_y] = [ROOM_M[0] / 2.0, ROOM_M[1] / 2.0];
        let (outer_x, outer_y, height) = (half_x + WALL_M, half_y + WALL_M, ROOM_M[2]);
        let mut floor = LinkDescription::new("floor", 0.0);
        floor.add_box(
            "floor",
            &palette.floor,
            [-outer_x, -outer_y, -WALL_M],
            [outer_x, outer_y, 0.0],
        );
        self.add(floor, [0.0; 3]);
        let plain = [
            ("wall_east", [half_x, -outer_y, 0.0], [outer_x, outer_y, height]),
            ("wall_north", [-half_x, half_y, 0.0], [half_x, outer_y, height]),
            ("wall_south", [-half_x, -outer_y, 0.0], [half_x, -half_y, height]),
        ];
        for (name, low, high) in plain {
            let mut wall = LinkDescription::new(name, 0.0);
            wall.add_box("wall", &palette.wall, low, high);
            self.add(wall, [0.0; 3]);
        }
        let (window_y, window_z) = ([unit_y(2) - 0.3, unit_y(3) + 0.3], [1.15, 2.05]);
        let mut west = LinkDescription::new("wall_west", 0.0);
        for (y, z) in [
            ([-outer_y, window_y[0]], [0.0, height]),
            ([window_y[1], outer_y], [0.0, height]),
            (window_y, [0.0, window_z[0]]),
            (window_y, [window_z[1], height]),
        ] {
            west.add_box("wall", &palette.wall, [-outer_x, y[0], z[0]], [-half_x, y[1], z[1]]);
        }
        self.add(west, [0.0; 3]);
        let mut frame = LinkDescription::new("window_frame", 0.0);
        let (bar, x) = (0.05, [-half_x - 0.07, -half_x - 0.03]);
        let middle = (window_y[0] + window_y[1]) / 2.0;
        for (y, z) in [
            ([window_y[0], window_y[0] + bar], window_z),
            ([window_y[1] - bar, window_y[1]], window_z),
            ([middle - bar / 2.0, middle + bar / 2.0], [window_z[0] + bar, window_z[1] - bar]),
            ([window_y[0] + bar, window_y[1] - bar], [window_z[0], window_z[0] + bar]),
            ([window_y[0] + bar, window_y[1] - bar], [window_z[1] - bar, window_z[1]]),
        ] {
            frame.add_box("frame", &palette.accents[2], [x[0], y[0], z[0]], [x[1], y[1], z[1]]);
        }
        self.add(frame, [0.0; 3]);
    }

    /// The units of the run that stay shut: a refrigerator at the end, cabinets, wall cabinets.
    fn add_units(&mut self, palette: &Palette) -> Result<(), AssetError> {
        let refrigerator = Refrigerator::default().build("refrigerator", palette)?;
        self.add_static("refrigerator", &refrigerator, [back_x(), unit_y(0), 0.0]);
        let cabinet = Cabinet::default().build("base_cabinet", palette)?;
        for unit in [1, 3, 5, 6] {
            let name = format!("base_cabinet_{unit}");
            self.add_static(&name, &cabinet, [back_x(), unit_y(unit), 0.0]);
        }
        let wall_cabinet = Cabinet {
            depth_m: 0.33,
            height_m: 0.72,
            plinth_m: 0.03,
            handle: HandleStyle::KNOB,
            ..Cabinet::default()
        }
        .build("wall_cabinet", palette)?;
        for unit in [1, 4, 6] {
            let name = format!("wall_cabinet_{unit}");
            self.add_static(&name, &wall_cabinet, [back_x(), unit_y(unit), 1.55]);
        }
        Ok(())
    }

    /// The worktop over units 1 to 6, with a hob and a sink's tap.
    fn add_worktop(&mut self, palette: &Palette) {
        let [top, thickness] = WORKTOP_M;
        let (start, end) = (unit_y(1) - UNIT_M / 2.0, unit_y(6) + UNIT_M / 2.0);
        let mut worktop = LinkDescription::new("worktop", 0.0);
        worktop.add_box(
            "worktop",
            &palette.worktop,
            [0.0, start, top - thickness],
            [WORKTOP_DEPTH_M, end, top],
        );
        self.add(worktop, [back_x(), 0.0, 0.0]);
        let mut hob = LinkDescription::new("hob", 0.0);
        hob.add_box("hob", &palette.glass, [-0.25, -0.28, 0.0], [0.25, 0.28, 0.006]);
        self.add(hob, [back_x() + 0.3, unit_y(3), top]);
        let mut sink = LinkDescription::new("sink", 0.0);
        sink.add_box("basin_rim", &palette.handle, [-0.2, -0.24, 0.0], [0.2, 0.24, 0.004]);
        sink.add_visual(
            "basin",
            &palette.dark,
            vec![Solid::cuboid([-0.16, -0.2, 0.0], [0.16, 0.2, 0.005])],
        );
        let tap = [
            nalgebra::Point3::new(-0.17, 0.0, 0.0),
            nalgebra::Point3::new(-0.17, 0.0, 0.16),
            nalgebra::Point3::new(-0.15, 0.0, 0.21),
            nalgebra::Point3::new(-0.10, 0.0, 0.23),
            nalgebra::Point3::new(-0.05, 0.0, 0.21),
            nalgebra::Point3::new(-0.03, 0.0, 0.16),
        ];
        let spout = Solid::bent_rod(&tap, nalgebra::Vector3::y(), 0.012, 12);
        sink.add_visual("tap", &palette.handle, vec![spout]);
        sink.collisions.push(CollisionBox::between(
            "tap",
            [-0.185, -0.015, 0.0],
            [-0.02, 0.015, 0.245],
        ));
        self.add(sink, [back_x() + 0.3, unit_y(1), top]);
    }

    fn add_table(&mut self, rng: &mut ChaCha8Rng, palette: &Palette) {
        let at = [rng.random_range(1.35..1.6), rng.random_range(-1.0..0.2)];
        let [half_x, half_y, height] = [0.4, 0.65, 0.74];
        let mut table = LinkDescription::new("table", 0.0);
        table.add_box(
            "top",
            &palette.worktop,
            [-half_x, -half_y, height - 0.03],
            [half_x, half_y, height],
        );
        for x in [-half_x + 0.04, half_x - 0.1] {
            for y in [-half_y + 0.04, half_y - 0.1] {
                table.add_box(
                    "legs",
                    &palette.worktop,
                    [x, y, 0.0],
                    [x + 0.06, y + 0.06, height - 0.03],
                );
            }
        }
        self.add(table, [at[0], at[1], 0.0]);
        for (index, y) in [-0.3, 0.3].into_iter().enumerate() {
            let offset = rng.random_range(0.0..0.08);
            // Pushed under the far side, away from the free floor.
            self.add(
                chair(&format!("chair_{index}"), palette),
                [at[0] + 0.3 + offset, at[1] + y, 0.0],
            );
        }
    }

    /// Crockery on worktop and table, clear of the microwave.
    fn add_clutter(&mut self, rng: &mut ChaCha8Rng, palette: &Palette) {
        let table = self.joint_origin("table_mount");
        let places = [
            [back_x() + rng.random_range(0.10..0.16), unit_y(2) - 0.15, WORKTOP_M[0]],
            [back_x() + rng.random_range(0.10..0.16), unit_y(2) + 0.12, WORKTOP_M[0]],
            [back_x() + rng.random_range(0.10..0.16), unit_y(4) - 0.10, WORKTOP_M[0]],
            [back_x() + rng.random_range(0.12..0.20), unit_y(6), WORKTOP_M[0]],
            [table[0] + rng.random_range(-0.1..0.1), table[1] + rng.random_range(-0.3..0.0), 0.74],
            [table[0] + rng.random_range(-0.2..0.0), table[1] + rng.random_range(0.15..0.4), 0.74],
        ];
        for (index, place) in places.into_iter().enumerate() {
            let finish = &palette.accents[rng.random_range(0..palette.accents.len())];
            let kind = if index == 4 { 2 } else { rng.random_range(0..3) };
            let (name, profile) = CROCKERY[kind];
            let mut link = LinkDescription::new(&format!("{name}_{index}"), 0.0);
            let solid = Solid::lathe(profile, 24);
            let (low, high) = solid.bounds();
            link.add_visual(name, finish, vec![solid]);
            link.collisions.push(CollisionBox::between(name, low, high));
            self.add(link, place);
        }
    }

    fn joint_origin(&self, name: &str) -> [f64; 3] {
        let joint = self.description.joints.iter().find(|joint| joint.name == name);
        joint.map_or([0.0; 3], |joint| joint.origin)
    }
}

/// Names and profiles of turned crockery: (radius, z) in metres.
const CROCKERY: [(&str, &[[f64; 2]]); 3] = [
    (
        "jar",
        &[
            [0.0, 0.0],
            [0.045, 0.0],
            [0.048, 0.02],
            [0.048, 0.11],
            [0.04, 0.13],
            [0.042, 0.15],
            [0.0, 0.155],
        ],
    ),
    (
        "bottle",
        &[[0.0, 0.0], [0.036, 0.0], [0.038, 0.16], [0.016, 0.22], [0.014, 0.27], [0.0, 0.275]],
    ),
    (
        "bowl",
        &[
            [0.0, 0.0],
            [0.05, 0.0],
            [0.09, 0.03],
            [0.12, 0.07],
            [0.112, 0.07],
            [0.08, 0.035],
            [0.045, 0.012],
            [0.0, 0.01],
        ],
    ),
];

/// A chair that faces -x.
fn chair(name: &str, palette: &Palette) -> LinkDescription {
    let mut chair = LinkDescription::new(name, 0.0);
    let half = 0.2;
    chair.add_box("seat", &palette.worktop, [-half, -half, 0.43], [half, half, 0.46]);
    for x in [-half, half - 0.035] {
        for y in [-half, half - 0.035] {
            chair.add_box("legs", &palette.worktop, [x, y, 0.0], [x + 0.035, y + 0.035, 0.43]);
        }
    }
    chair.add_box("back", &palette.worktop, [half - 0.03, -half, 0.46], [half, half, 0.85]);
    chair
}

/// All links of a closed appliance as one rigid body.
pub(crate) fn flattened(description: &Description, name: &str) -> LinkDescription {
    let mut body = LinkDescription::new(name, 0.0);
    for link in &description.links {
        let [x, y, z] = offset_from_root(description, &link.name);
        let offset = Pose::translation(x, y, z);
        for visual in &link.visuals {
            let solids = visual.solids.iter().map(|s| s.clone().moved(&offset)).collect();
            body.add_visual(&visual.finish.name, &visual.finish, solids);
        }
        for part in &link.collisions {
            let name = format!("{}_{}", link.name, part.name);
            let link_from_box = offset * part.link_from_box;
            body.collisions.push(CollisionBox { name, link_from_box, size: part.size });
        }
    }
    body
}

/// Offset of a closed appliance's link from its root: frames are parallel, so origins add up.
fn offset_from_root(description: &Description, link: &str) -> [f64; 3] {
    match description.joints.iter().find(|joint| joint.child == link) {
        None => [0.0; 3],
        Some(joint) => {
            let parent = offset_from_root(description, &joint.parent);
            std::array::from_fn(|axis| parent[axis] + joint.origin[axis])
        }
    }
}
