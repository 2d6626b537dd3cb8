//! Objects by class: parameters, drawn by a seed where they are not given, and the folder they are written to.

use std::path::Path;

use akrobat_model::Pose;
use akrobat_model::task::ObjectKind;
use nalgebra::Vector3;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::appliances::{
    Appliance, Cabinet, Dishwasher, DrawerUnit, HingeSide, Microwave, Oven, Refrigerator, RoomDoor,
    TrashCan,
};
use crate::description::Description;
use crate::error::{AssetError, write_file};
use crate::finish::Palette;
use crate::grasp;
use crate::handle::HandleStyle;
use crate::loose::{self, Loose};

/// Licence of everything that is generated.
pub const LICENSE: &str = "MIT OR Apache-2.0";
/// Number of grasps that an object comes with, at most.
const GRASPS: usize = 20;

/// A class of objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names say it")]
pub enum ObjectClass {
    Microwave,
    Oven,
    Dishwasher,
    Refrigerator,
    WallCabinet,
    BaseCabinet,
    DrawerUnit,
    TrashCan,
    Door,
    Chair,
    Box,
    Mug,
    Bowl,
}

impl ObjectClass {
    /// All classes.
    pub const ALL: [Self; 13] = [
        Self::Microwave,
        Self::Oven,
        Self::Dishwasher,
        Self::Refrigerator,
        Self::WallCabinet,
        Self::BaseCabinet,
        Self::DrawerUnit,
        Self::TrashCan,
        Self::Door,
        Self::Chair,
        Self::Box,
        Self::Mug,
        Self::Bowl,
    ];

    /// Name, as in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Microwave => "microwave",
            Self::Oven => "oven",
            Self::Dishwasher => "dishwasher",
            Self::Refrigerator => "refrigerator",
            Self::WallCabinet => "wall_cabinet",
            Self::BaseCabinet => "base_cabinet",
            Self::DrawerUnit => "drawer_unit",
            Self::TrashCan => "trash_can",
            Self::Door => "door",
            Self::Chair => "chair",
            Self::Box => "box",
            Self::Mug => "mug",
            Self::Bowl => "bowl",
        }
    }

    /// True where it is opened by a joint.
    pub fn is_articulated(self) -> bool {
        !matches!(self, Self::Chair | Self::Box | Self::Mug | Self::Bowl)
    }

    /// True where the side of the hinges can be chosen.
    pub fn has_hinge_side(self) -> bool {
        matches!(
            self,
            Self::Microwave
                | Self::Refrigerator
                | Self::WallCabinet
                | Self::BaseCabinet
                | Self::Door
        )
    }

    /// Where typical sizes come from.
    pub fn size_source(self) -> &'static str {
        match self {
            Self::Oven | Self::Dishwasher | Self::BaseCabinet | Self::DrawerUnit => {
                "EN 1116 and ISO 3055: co-ordinating sizes of kitchen furniture and appliances"
            }
            Self::WallCabinet => "EN 1116; ANSI/KCMA A161.1 lists 12 to 13 inches of depth",
            Self::Refrigerator => "EN 1116 (600 mm niches); manufacturers' free-standing models",
            Self::Door => "DIN 18101: leaves 735, 860 and 985 mm by 1985 mm, lever at 1050 mm",
            Self::Chair => "EN 1729 and manufacturers' dining chairs",
            Self::Microwave | Self::TrashCan | Self::Box | Self::Mug | Self::Bowl => {
                "manufacturers' typical sizes"
            }
        }
    }
}

/// Which handle; its dimensions are drawn by the seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names say it")]
pub enum HandleKind {
    Bar,
    Arch,
    Knob,
    Recess,
    Lever,
}

/// What is asked for; what is `None` is drawn by the seed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ObjectRequest {
    /// Outer width, metres.
    pub width_m: Option<f64>,
    /// Depth without fronts and handles, metres.
    pub depth_m: Option<f64>,
    /// Height, metres.
    pub height_m: Option<f64>,
    /// Side of the hinges.
    pub hinge_side: Option<HingeSide>,
    /// Number of doors of a cabinet.
    pub doors: Option<usize>,
    /// Handle.
    pub handle: Option<HandleKind>,
    /// Seed of what is not given.
    pub seed: u64,
}

/// What moves, and how.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Articulation {
    /// Joint that opens it.
    pub joint: String,
    /// `revolute` or `prismatic`.
    pub kind: &'static str,
    /// Lower and upper limit, rad or m.
    pub limits: [f64; 2],
    /// Positions to ask for, rad or m.
    pub goals: Vec<f64>,
}

/// A generated object.
#[derive(Debug, Clone)]
pub struct GeneratedObject {
    /// Its class.
    pub class: ObjectClass,
    /// The seed it was drawn by.
    pub seed: u64,
    /// Links and joints; its name is the object's.
    pub description: Description,
    /// How tasks move it.
    pub kind: ObjectKind,
    /// The joint that opens it, where it has one.
    pub articulation: Option<Articulation>,
    /// Link that is held.
    pub handle_link: String,
    /// Patterns of that link's parts that are held; all where empty.
    pub held_parts: Vec<String>,
    /// Depth (without handles), width and height, metres.
    pub size_m: [f64; 3],
    /// Tool poses in the held link's frame, the best first.
    pub grasps: Vec<Pose>,
}

/// `object.json`: what other programs need to know of an object.
#[derive(Debug, Serialize)]
struct Manifest<'a> {
    format: &'static str,
    name: &'a str,
    class: ObjectClass,
    seed: u64,
    urdf: String,
    kind: ObjectKind,
    articulation: &'a Option<Articulation>,
    handle_link: &'a str,
    held_parts: &'a [String],
    /// What each link is: `body`, `door`, `drawer`, `handle`, `rigid`.
    links: Vec<LinkSemantics<'a>>,
    size_m: [f64; 3],
    mass_kg: f64,
    grasps: GraspFile,
    license: &'static str,
    size_source: &'static str,
}

#[derive(Debug, Serialize)]
struct LinkSemantics<'a> {
    name: &'a str,
    semantics: &'static str,
}

#[derive(Debug, Serialize)]
struct GraspFile {
    file: &'static str,
    frame: &'static str,
    count: usize,
}

/// Makes an object under a name.
///
/// # Errors
/// [`AssetError::Dimension`] where a given dimension cannot be built, [`AssetError::NotApplicable`] where the
/// class has no such parameter.
pub fn generate(
    class: ObjectClass,
    name: &str,
    request: &ObjectRequest,
    palette: &Palette,
) -> Result<GeneratedObject, AssetError> {
    check_applicable(class, request)?;
    let mut draw = Draw::new(request);
    if class.is_articulated() {
        let appliance = articulated(class, name, &mut draw, palette)?;
        from_appliance(class, request.seed, appliance)
    } else {
        let loose = rigid(class, name, &mut draw, palette)?;
        from_loose(class, request.seed, loose)
    }
}

/// The palette that a seed draws for an object alone.
pub fn palette_of(seed: u64) -> Palette {
    Palette::sample(&mut ChaCha8Rng::seed_from_u64(seed ^ 0x70a1_e77e))
}

fn check_applicable(class: ObjectClass, request: &ObjectRequest) -> Result<(), AssetError> {
    let cabinet = matches!(class, ObjectClass::BaseCabinet | ObjectClass::WallCabinet);
    let refusals = [
        (request.hinge_side.is_some() && !class.has_hinge_side(), "side of the hinges"),
        (request.doors.is_some() && !cabinet, "number of doors"),
        (request.handle.is_some() && !class.is_articulated(), "handle"),
        (
            request.handle == Some(HandleKind::Lever) && class != ObjectClass::Door,
            "lever; valid handles: bar, arch, knob, recess",
        ),
        (
            // A lid is thinner than a recess is deep.
            request.handle == Some(HandleKind::Recess) && class == ObjectClass::TrashCan,
            "recess; valid handles: bar, arch, knob",
        ),
    ];
    match refusals.into_iter().find(|(refused, _)| *refused) {
        Some((_, parameter)) => Err(AssetError::NotApplicable { class: class.name(), parameter }),
        None => Ok(()),
    }
}

/// Draws parameters in a fixed order; those given take the place of what was drawn.
struct Draw<'a> {
    rng: ChaCha8Rng,
    request: &'a ObjectRequest,
}

impl<'a> Draw<'a> {
    fn new(request: &'a ObjectRequest) -> Self {
        Self { rng: ChaCha8Rng::seed_from_u64(request.seed), request }
    }

    /// One of the usual widths, depths or heights.
    fn one_of(&mut self, given: Option<f64>, usual: &[f64]) -> f64 {
        let drawn = usual[self.rng.random_range(0..usual.len())];
        given.unwrap_or(drawn)
    }

    fn between(&mut self, given: Option<f64>, low: f64, high: f64) -> f64 {
        // Whole millimetres, as on drawings.
        let drawn = (self.rng.random_range(low..high) * 1000.0).round() / 1000.0;
        given.unwrap_or(drawn)
    }

    fn hinge_side(&mut self) -> HingeSide {
        let left = self.rng.random_bool(0.5);
        let drawn = if left { HingeSide::Left } else { HingeSide::Right };
        self.request.hinge_side.unwrap_or(drawn)
    }

    /// A handle on at most `span` metres, with hole spacings of System 32.
    fn handle(&mut self, span: f64, kinds: &[HandleKind]) -> HandleStyle {
        let drawn = kinds[self.rng.random_range(0..kinds.len())];
        let kind = self.request.handle.unwrap_or(drawn);
        let pitches = ((span / 0.032).floor() as u32).clamp(3, 12);
        let spacing_m = 0.032 * f64::from(self.rng.random_range(3..=pitches));
        let thin = self.between(None, 0.010, 0.016);
        match kind {
            HandleKind::Bar => HandleStyle::Bar {
                spacing_m,
                diameter_m: thin,
                clearance_m: self.between(None, 0.034, 0.044),
            },
            HandleKind::Arch => HandleStyle::Arch {
                spacing_m: spacing_m.min(0.192),
                diameter_m: thin,
                rise_m: self.between(None, 0.038, 0.048),
            },
            HandleKind::Knob => HandleStyle::Knob {
                diameter_m: self.between(None, 0.028, 0.038),
                depth_m: self.between(None, 0.034, 0.042),
            },
            HandleKind::Recess => HandleStyle::Recess {
                length_m: self.between(None, 0.070, 0.100),
                bridge_m: thin,
                depth_m: self.between(None, 0.034, 0.042),
            },
            HandleKind::Lever => HandleStyle::Lever {
                length_m: self.between(None, 0.105, 0.135),
                diameter_m: self.between(None, 0.016, 0.022),
                clearance_m: self.between(None, 0.036, 0.046),
            },
        }
    }
}

const FURNITURE: [HandleKind; 4] =
    [HandleKind::Bar, HandleKind::Arch, HandleKind::Knob, HandleKind::Recess];
const APPLIANCE: [HandleKind; 2] = [HandleKind::Bar, HandleKind::Arch];

fn articulated(
    class: ObjectClass,
    name: &str,
    draw: &mut Draw<'_>,
    palette: &Palette,
) -> Result<Appliance, AssetError> {
    let &ObjectRequest { width_m, depth_m, height_m, doors, .. } = draw.request;
    match class {
        ObjectClass::Microwave => Microwave {
            width_m: draw.between(width_m, 0.45, 0.54),
            depth_m: draw.between(depth_m, 0.34, 0.42),
            height_m: draw.between(height_m, 0.26, 0.31),
            controls_m: draw.between(None, 0.09, 0.13),
            handle: draw.handle(0.16, &APPLIANCE),
            hinge_side: draw.hinge_side(),
        }
        .build(name, palette),
        ObjectClass::Oven => {
            let width_m = draw.one_of(width_m, &[0.5, 0.6, 0.6, 0.76]);
            Oven {
                width_m,
                depth_m: draw.between(depth_m, 0.55, 0.60),
                height_m: draw.one_of(height_m, &[0.85, 0.862, 0.9]),
                door_z_m: [draw.between(None, 0.2, 0.3), draw.between(None, 0.68, 0.74)],
                handle: draw.handle(width_m - 0.2, &APPLIANCE),
            }
            .build(name, palette)
        }
        ObjectClass::Dishwasher => {
            let width_m = draw.one_of(width_m, &[0.448, 0.598, 0.598]);
            Dishwasher {
                width_m,
                depth_m: draw.between(depth_m, 0.53, 0.57),
                height_m: draw.between(height_m, 0.815, 0.862),
                handle: draw.handle(width_m - 0.2, &APPLIANCE),
                ..Dishwasher::default()
            }
            .build(name, palette)
        }
        ObjectClass::Refrigerator => Refrigerator {
            width_m: draw.one_of(width_m, &[0.54, 0.595, 0.6, 0.7]),
            depth_m: draw.between(depth_m, 0.55, 0.62),
            height_m: draw.one_of(height_m, &[0.85, 1.45, 1.6, 1.75, 1.85]),
            hinge_side: draw.hinge_side(),
            handle: draw.handle(0.4, &APPLIANCE),
        }
        .build(name, palette),
        ObjectClass::WallCabinet | ObjectClass::BaseCabinet => {
            let base = class == ObjectClass::BaseCabinet;
            let drawn_doors = if draw.rng.random_bool(0.4) { 2 } else { 1 };
            let doors = doors.unwrap_or(drawn_doors);
            let widths: &[f64] = if doors == 2 { &[0.6, 0.8, 0.9] } else { &[0.4, 0.5, 0.6] };
            let depths = if base { [0.50, 0.58] } else { [0.30, 0.36] };
            let heights: &[f64] = if base { &[0.82, 0.862, 0.87] } else { &[0.6, 0.72, 0.9] };
            Cabinet {
                width_m: draw.one_of(width_m, widths),
                depth_m: draw.between(depth_m, depths[0], depths[1]),
                height_m: draw.one_of(height_m, heights),
                plinth_m: if base { draw.one_of(None, &[0.08, 0.1, 0.15]) } else { 0.0 },
                doors,
                hinge_side: draw.hinge_side(),
                handle: draw.handle(0.2, &FURNITURE),
            }
            .build(name, palette)
        }
        ObjectClass::DrawerUnit => {
            let shares: [&[f64]; 3] = [&[0.26, 0.37, 0.37], &[0.25, 0.25, 0.25, 0.25], &[0.5, 0.5]];
            let front_shares = shares[draw.rng.random_range(0..shares.len())].to_vec();
            DrawerUnit {
                width_m: draw.one_of(width_m, &[0.4, 0.5, 0.6, 0.8]),
                depth_m: draw.between(depth_m, 0.50, 0.58),
                height_m: draw.one_of(height_m, &[0.82, 0.862, 0.87]),
                opened: draw.rng.random_range(0..front_shares.len().min(2)),
                front_shares,
                handle: draw.handle(0.25, &FURNITURE),
                ..DrawerUnit::default()
            }
            .build(name, palette)
        }
        ObjectClass::TrashCan => TrashCan {
            width_m: draw.between(width_m, 0.28, 0.42),
            depth_m: draw.between(depth_m, 0.22, 0.34),
            height_m: draw.between(height_m, 0.55, 0.72),
            handle: draw.handle(0.16, &[HandleKind::Bar, HandleKind::Arch, HandleKind::Knob]),
        }
        .build(name, palette),
        _ => RoomDoor {
            width_m: draw.one_of(width_m, &[0.735, 0.86, 0.86, 0.985]),
            depth_m: draw.between(depth_m, 0.1, 0.2),
            height_m: draw.one_of(height_m, &[1.985, 2.11]),
            hinge_side: draw.hinge_side(),
            handle: draw.handle(0.2, &[HandleKind::Lever]),
        }
        .build(name, palette),
    }
}

fn rigid(
    class: ObjectClass,
    name: &str,
    draw: &mut Draw<'_>,
    palette: &Palette,
) -> Result<Loose, AssetError> {
    let &ObjectRequest { width_m, depth_m, height_m, .. } = draw.request;
    let accent = draw.rng.random_range(0..palette.accents.len());
    let finish = &palette.accents[accent];
    match class {
        ObjectClass::Chair => {
            let size = [
                draw.between(depth_m, 0.40, 0.48),
                draw.between(width_m, 0.38, 0.46),
                draw.between(height_m, 0.82, 0.98),
            ];
            loose::chair(name, size, palette)
        }
        ObjectClass::Box => {
            let size = [
                draw.between(depth_m, 0.035, 0.068),
                draw.between(width_m, 0.06, 0.2),
                draw.between(height_m, 0.08, 0.28),
            ];
            loose::packet(name, size, finish)
        }
        ObjectClass::Mug => {
            let diameter = draw.between(width_m, 0.074, 0.092);
            loose::mug(name, diameter, draw.between(height_m, 0.085, 0.11), finish)
        }
        _ => {
            let diameter = draw.between(width_m, 0.13, 0.24);
            loose::bowl(name, diameter, draw.between(height_m, 0.055, 0.09), finish)
        }
    }
}

fn from_appliance(
    class: ObjectClass,
    seed: u64,
    appliance: Appliance,
) -> Result<GeneratedObject, AssetError> {
    let Appliance { description, joint, handle_link, goals, size, grasps } = appliance;
    let grasps = best(grasp::fitting(&description, &handle_link, &grasps)?);
    let motion = description.joints.iter().find(|j| j.name == joint).and_then(|j| j.motion.clone());
    let articulation = motion.map(|motion| Articulation {
        joint,
        kind: if motion.kind == akrobat_model::JointKind::Prismatic {
            "prismatic"
        } else {
            "revolute"
        },
        limits: motion.limits,
        goals,
    });
    Ok(GeneratedObject {
        class,
        seed,
        description,
        kind: ObjectKind::Articulated,
        articulation,
        handle_link,
        held_parts: Vec::new(),
        size_m: size,
        grasps,
    })
}

fn from_loose(class: ObjectClass, seed: u64, loose: Loose) -> Result<GeneratedObject, AssetError> {
    let Loose { description, kind, held_parts, size, grasps } = loose;
    let handle_link = description.links[0].name.clone();
    let grasps = best(grasp::fitting(&description, &handle_link, &grasps)?);
    Ok(GeneratedObject {
        class,
        seed,
        description,
        kind,
        articulation: None,
        handle_link,
        held_parts,
        size_m: size,
        grasps,
    })
}

fn best(mut grasps: Vec<Pose>) -> Vec<Pose> {
    grasps.truncate(GRASPS);
    grasps
}

impl GeneratedObject {
    /// Writes URDF, meshes, `object.json` and `grasps.txt` into `folder`, which is made where it is missing.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), AssetError> {
        self.description.write(folder)?;
        write_file(&folder.join("grasps.txt"), self.grasp_text())?;
        let manifest = Manifest {
            format: "akrobat object 1",
            name: &self.description.name,
            class: self.class,
            seed: self.seed,
            urdf: format!("{}.urdf", self.description.name),
            kind: self.kind,
            articulation: &self.articulation,
            handle_link: &self.handle_link,
            held_parts: &self.held_parts,
            links: self.semantics(),
            size_m: self.size_m.map(|edge| (edge * 1e6).round() / 1e6),
            mass_kg: self.description.links.iter().map(|link| link.mass_kg).sum(),
            grasps: GraspFile { file: "grasps.txt", frame: "link", count: self.grasps.len() },
            license: LICENSE,
            size_source: self.class.size_source(),
        };
        let text = serde_json::to_string_pretty(&manifest).map_err(AssetError::Manifest)?;
        write_file(&folder.join("object.json"), text + "\n")
    }

    fn semantics(&self) -> Vec<LinkSemantics<'_>> {
        let semantics = |name: &str| match name {
            "body" => "body",
            name if name.starts_with("door") => "door",
            name if name.starts_with("drawer") => "drawer",
            name if name.starts_with("handle") => "handle",
            _ => "rigid",
        };
        let links = self.description.links.iter();
        links.map(|l| LinkSemantics { name: &l.name, semantics: semantics(&l.name) }).collect()
    }

    fn grasp_text(&self) -> String {
        let mut text = format!(
            "# Tool poses in the frame of link {}: x y z (m) qw qx qy qz; z approaches, y closes.\n",
            self.handle_link
        );
        for pose in &self.grasps {
            let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
            let values = [t.x, t.y, t.z, q.w, q.i, q.j, q.k];
            let words = values.map(|v| format!("{:.6}", if v.abs() < 5e-7 { 0.0 } else { v }));
            text.push_str(&words.join(" "));
            text.push('\n');
        }
        text
    }

    /// The `[object]`, `[object.handle]` and `[grasps]` tables of a task whose object's folder and root pose
    /// are given.
    pub fn task_tables(&self, folder: &str, world_from_root: &Pose) -> String {
        let name = &self.description.name;
        let kind = match self.kind {
            ObjectKind::Articulated => "articulated",
            ObjectKind::Rigid => "rigid",
            ObjectKind::Planar => "planar",
        };
        let joint = self
            .articulation
            .as_ref()
            .map_or(String::new(), |articulation| format!("joint = \"{}\"\n", articulation.joint));
        let parts = if self.held_parts.is_empty() {
            String::new()
        } else {
            format!("parts = {:?}\n", self.held_parts)
        };
        format!(
            "[object]\nname = \"{name}\"\nkind = \"{kind}\"\nurdf = \"{folder}/{name}.urdf\"\nlicense = \"{LICENSE}\"\npose = {}\n{joint}\n[object.handle]\nlink = \"{}\"\n{parts}\n[grasps]\nfile = \"{folder}/grasps.txt\"\nframe = \"link\"\n",
            pose_text(world_from_root),
            self.handle_link,
        )
    }

    /// The `[goal]` table: the positions of its joint, or other places for it to stand.
    pub fn goal_table(&self, world_from_root: &Pose) -> String {
        if let Some(articulation) = &self.articulation {
            let goals: Vec<String> =
                articulation.goals.iter().map(|goal| format!("{goal:.4}")).collect();
            return format!("[goal]\npositions = [{}]\n", goals.join(", "));
        }
        let moved = |x: f64, y: f64| {
            let mut pose = *world_from_root;
            pose.translation.vector += pose.rotation * Vector3::new(x, y, 0.0);
            pose_text(&pose)
        };
        let poses = match self.kind {
            ObjectKind::Planar => [moved(-0.4, 0.0), moved(-0.4, 0.2)],
            _ => [moved(0.0, 0.25), moved(0.0, -0.25)],
        };
        format!("[goal]\nposes = [{}, {}]\n", poses[0], poses[1])
    }
}

/// `[x, y, z, qw, qx, qy, qz]`.
pub(crate) fn pose_text(pose: &Pose) -> String {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    let values = [t.x, t.y, t.z, q.w, q.i, q.j, q.k];
    let words = values.map(|v| format!("{:.6}", if v.abs() < 5e-7 { 0.0 } else { v }));
    format!("[{}]", words.join(", "))
}

/// A task with the object alone in a room: at a wall, or on a table.
pub fn task_text(object: &GeneratedObject, robot_file: &str) -> String {
    let name = &object.description.name;
    let [depth, width, _] = object.size_m;
    let turned =
        nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    // The room's walls are at +-4 m.
    let (world_from_root, support) = match object.class {
        ObjectClass::Microwave => {
            (Pose::translation(-3.98, 0.0, 0.9), Some([depth + 0.03, width + 0.4, 0.9]))
        }
        ObjectClass::WallCabinet => (Pose::translation(-3.99, 0.0, 1.4), None),
        ObjectClass::Chair => {
            let turn = nalgebra::Translation3::new(-2.5, 0.0, 0.0) * turned;
            (turn, None)
        }
        ObjectClass::Box | ObjectClass::Mug | ObjectClass::Bowl => {
            (Pose::translation(-3.65, 0.0, 0.75), Some([0.5, 1.2, 0.75]))
        }
        _ => (Pose::translation(-3.99, 0.0, 0.0), None),
    };
    let support = support.map_or(String::new(), |[x, y, z]| {
        format!(
            "[[scene.box]]\nname = \"table\"\nsize = [{x:.4}, {y:.4}, {z:.4}]\npose = [{:.4}, 0.0, {:.4}, 1.0, 0.0, 0.0, 0.0]\ncolor = [0.35, 0.22, 0.12]\n\n",
            -3.99 + x / 2.0,
            z / 2.0
        )
    });
    format!(
        "name = \"{name}\"\nseed = {}\n\n[robot]\nfile = \"{robot_file}\"\n\n{}\n[scene]\nroom = [8.0, 8.0, 3.0]\n\n{support}{}",
        object.seed,
        object.task_tables(".", &world_from_root),
        object.goal_table(&world_from_root),
    )
}
