//! Variants of an imported scene: its articulated objects are exchanged for generated ones of their classes, in the
//! same places but with other dimensions, handles and finishes, and free stretches of floor are furnished.
//!
//! What stands still is written once and shared by all variants.

use std::path::{Path, PathBuf};

use akrobat_model::load::AssetSearch;
use akrobat_model::pose::to_xyz_wxyz;
use akrobat_model::{KinematicTree, Link, ModelError, Pose, SceneBody, Shape, urdf};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::ground::{Ground, Rectangle};
use super::layout::{fixed, tree_bounds};
use super::read_text;
use super::twin::static_twin;
use crate::error::{AssetError, make_folder, write_file};
use crate::object::{self, GeneratedObject, ObjectClass, ObjectRequest, palette_of};
use crate::room::TaskRobot;

/// Draws of an object until one fits into a place.
const DRAWS: usize = 24;
/// Attempts at a free place for a piece of furniture.
const PLACES: usize = 6000;
/// A handle may stand out of an object's place by this much, metres.
const HANDLE_M: f64 = 0.08;
/// Free floor in front of furniture, from its front on, and how much wider than it, metres.
const FRONT_M: f64 = 1.3;
const WIDER_M: f64 = 0.3;
/// Radius of the disc that stands for a robot's base, metres.
const BASE_RADIUS_M: f64 = 0.4;
/// What free floor is furnished with, in this order, where the scene has none of that class.
const FURNITURE: [ObjectClass; 6] = [
    ObjectClass::DrawerUnit,
    ObjectClass::BaseCabinet,
    ObjectClass::Refrigerator,
    ObjectClass::Dishwasher,
    ObjectClass::Oven,
    ObjectClass::TrashCan,
];

/// A place for an object of a class.
#[derive(Debug, Clone)]
struct Slot {
    class: ObjectClass,
    /// Middle of the bottom edge of its back, x to the front.
    world_from_back: Pose,
    /// Depth, width and height, metres.
    size_m: [f64; 3],
}

/// An imported scene that variants are made of.
#[derive(Debug, Clone)]
pub struct Base {
    name: String,
    folder: PathBuf,
    /// The links of `scene.urdf`.
    tree: KinematicTree,
    license: String,
    slots: Vec<Slot>,
    ground: Ground,
}

/// A generated object in its place.
#[derive(Debug, Clone)]
pub struct StandingObject {
    /// The object.
    pub object: GeneratedObject,
    /// Pose of its root.
    pub world_from_root: Pose,
}

/// A variant of a scene.
#[derive(Debug, Clone)]
pub struct Variant {
    /// Seed.
    pub seed: u64,
    /// What can be opened.
    pub objects: Vec<StandingObject>,
    /// Share of the floor on which a disc of 0.4 m radius can stand.
    pub free_floor: f64,
    /// Places that nothing was found for.
    pub left_empty: Vec<String>,
}

impl Base {
    /// Reads a folder that an importer has written.
    ///
    /// # Errors
    /// [`ModelError`] where it holds no imported scene, or a file of it is broken.
    pub fn load(folder: &Path) -> Result<Self, ModelError> {
        let path = folder.join("scene.json");
        let manifest: Value = serde_json::from_str(&read_text(&path)?)
            .map_err(|e| ModelError::invalid(&path, format!("malformed JSON: {e}")))?;
        if manifest["kind"] != "scene" {
            let message = "expected the manifest of an imported scene (\"kind\": \"scene\")";
            return Err(ModelError::invalid(&path, message.to_owned()));
        }
        let (tree, _) = urdf::read(&folder.join("scene.urdf"), &AssetSearch::default())?;
        // Bases move within some metres of the origin.
        let [low, high] = Ground::new(&bodies(&tree)).bounds();
        let middle = (low + high) / 2.0;
        let centred_from_world = Pose::translation(-middle.x, -middle.y, 0.0);
        let tree = moved(&tree, &centred_from_world)?;
        let objects = manifest["objects"].as_array().cloned().unwrap_or_default();
        let slots = objects.iter().map(|entry| slot(folder, entry));
        let slots = slots.collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            name: super::layout::file_name(manifest["name"].as_str().unwrap_or("scene")),
            folder: folder.to_path_buf(),
            license: manifest["license"].as_str().unwrap_or_default().into(),
            ground: Ground::new(&bodies(&tree)),
            slots: slots
                .into_iter()
                .flatten()
                .map(|slot| Slot {
                    world_from_back: centred_from_world * slot.world_from_back,
                    ..slot
                })
                .collect(),
            tree,
        })
    }

    /// The scene's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of bodies that stand still.
    pub fn bodies(&self) -> usize {
        self.tree.links().len().saturating_sub(1)
    }

    /// Copies what all variants share below `folder`: the files of what stands still.
    ///
    /// # Errors
    /// [`AssetError`] where a file cannot be read or written.
    pub fn write_shared(&self, folder: &Path) -> Result<(), AssetError> {
        let place = folder.join(&self.name);
        make_folder(&place)?;
        copy(&self.folder.join("scene.urdf"), &place.join("scene.urdf"))?;
        let meshes = self.folder.join("meshes");
        if !meshes.is_dir() {
            return Ok(());
        }
        make_folder(&place.join("meshes"))?;
        let entries = std::fs::read_dir(&meshes).map_err(|e| ModelError::read(&meshes, e))?;
        for file in entries.flatten().map(|entry| entry.path()).filter(|path| path.is_file()) {
            let name = file.file_name().unwrap_or_default();
            copy(&file, &place.join("meshes").join(name))?;
        }
        Ok(())
    }

    /// The variant of a seed, with up to `furniture` pieces on free floor.
    ///
    /// # Errors
    /// Where no object fits into any place of the scene.
    pub fn vary(&self, seed: u64, furniture: usize) -> Result<Variant, AssetError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut ground = self.ground.clone();
        let mut variant =
            Variant { seed, objects: Vec::new(), free_floor: 0.0, left_empty: Vec::new() };
        for slot in &self.slots {
            match fitted(slot, &mut rng, (self, &variant))? {
                Some(placed) => {
                    ground.take(&footprint(&placed)?);
                    variant.objects.push(placed);
                }
                None => variant.left_empty.push(slot.class.name().into()),
            }
        }
        let placed: Vec<_> = variant.objects.iter().map(|placed| placed.object.class).collect();
        let present = |class: ObjectClass| placed.contains(&class);
        let wanted = FURNITURE.into_iter().filter(|&class| !present(class)).take(furniture);
        let mut carries = !present(ObjectClass::Microwave) && furniture > 0;
        for class in wanted {
            let object = drawn(class, ObjectRequest::default(), &mut rng, (self, &variant))?;
            let Some(place) = free_place(&object, &ground, &mut rng)? else {
                variant.left_empty.push(class.name().into());
                continue;
            };
            ground.take(&place);
            let height = object.size_m[2];
            let placed = StandingObject { object, world_from_root: place.world_from_back() };
            variant.objects.push(placed);
            if carries && class.is_worktop_high() {
                let microwave = on_top(&place, height, &mut rng, (self, &variant))?;
                carries = microwave.is_none();
                variant.objects.extend(microwave);
            }
        }
        if variant.objects.is_empty() {
            let reason = "no place for anything that opens".to_owned();
            return Err(AssetError::Scene { seed, reason });
        }
        variant.free_floor = ground.free_share(BASE_RADIUS_M);
        Ok(variant)
    }
}

impl ObjectClass {
    fn is_worktop_high(self) -> bool {
        matches!(self, Self::DrawerUnit | Self::BaseCabinet)
    }
}

fn copy(from: &Path, to: &Path) -> Result<(), AssetError> {
    std::fs::copy(from, to).map(drop).map_err(|e| AssetError::write(to, e))
}

/// The tree with everything that hangs from its root moved.
fn moved(tree: &KinematicTree, new_from_old: &Pose) -> Result<KinematicTree, ModelError> {
    let mut joints = tree.joints().to_vec();
    for joint in joints.iter_mut().filter(|joint| joint.parent == tree.root()) {
        joint.parent_from_joint = new_from_old * joint.parent_from_joint;
    }
    KinematicTree::new(tree.name.clone(), tree.links().to_vec(), joints)
}

fn bodies(tree: &KinematicTree) -> Vec<SceneBody> {
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let body = |(link, pose): (&Link, Pose)| SceneBody {
        name: link.name.clone(),
        class: String::new(),
        world_from_body: pose,
        visuals: link.visuals.clone(),
        collisions: link.collisions.clone(),
    };
    tree.links().iter().zip(poses).map(body).collect()
}

/// The generated class that stands for an imported one.
fn generated_class(class: &str) -> Option<ObjectClass> {
    match class {
        "cabinet" => Some(ObjectClass::BaseCabinet),
        "drawer" => Some(ObjectClass::DrawerUnit),
        name => ObjectClass::ALL.into_iter().find(|c| c.is_articulated() && c.name() == name),
    }
}

/// The place of an articulated object of an imported scene; none where nothing is generated of its class.
fn slot(folder: &Path, entry: &Value) -> Result<Option<Slot>, ModelError> {
    let path = folder.join("scene.json");
    let wrong =
        |what: &str| ModelError::invalid(&path, format!("objects: expected {what}, got {}", entry));
    let class = entry["class"].as_str().ok_or_else(|| wrong("a class"))?;
    let Some(class) = generated_class(class) else { return Ok(None) };
    let numbers: Option<Vec<f64>> =
        entry["pose"].as_array().map(|pose| pose.iter().filter_map(Value::as_f64).collect());
    let numbers = numbers.filter(|numbers| numbers.len() == 7).ok_or_else(|| wrong("a pose"))?;
    let turn = nalgebra::Quaternion::new(numbers[3], numbers[4], numbers[5], numbers[6]);
    let world_from_root = Pose::from_parts(
        Vector3::new(numbers[0], numbers[1], numbers[2]).into(),
        UnitQuaternion::from_quaternion(turn),
    );
    let asset = entry["asset"].as_str().ok_or_else(|| wrong("an asset"))?;
    let (tree, _) = urdf::read(&folder.join(asset), &AssetSearch::default())?;
    let (low, high) = tree_bounds(&tree).ok_or_else(|| wrong("an object with shapes"))?;
    let root_from_back = Pose::translation(low.x, (low.y + high.y) / 2.0, low.z);
    Ok(Some(Slot {
        class,
        world_from_back: world_from_root * root_from_back,
        size_m: (high - low).into(),
    }))
}

/// An object of a class under a name that the variant does not have yet.
fn drawn(
    class: ObjectClass,
    given: ObjectRequest,
    rng: &mut ChaCha8Rng,
    (base, variant): (&Base, &Variant),
) -> Result<GeneratedObject, AssetError> {
    let taken = |name: &str| {
        base.tree.link_index(name).is_ok()
            || variant.objects.iter().any(|placed| placed.object.description.name == name)
    };
    let mut names = (1..).map(|number: usize| format!("{}_{number}", class.name()));
    let name = names.find(|name| !taken(name)).unwrap_or_default();
    let seed = u64::from(rng.random::<u32>());
    let request = ObjectRequest { seed, ..given };
    object::generate(class, &name, &request, &palette_of(seed))
}

/// An object that fits into a place, its back against the place's.
fn fitted(
    slot: &Slot,
    rng: &mut ChaCha8Rng,
    (base, variant): (&Base, &Variant),
) -> Result<Option<StandingObject>, AssetError> {
    let [most_depth, most_width, most_height] = slot.size_m;
    for draw in 0..DRAWS {
        // What no usual size fits into gets an object of its own size.
        let given = match draw < DRAWS / 2 {
            true => ObjectRequest::default(),
            false => ObjectRequest {
                width_m: Some(most_width),
                depth_m: Some((most_depth - HANDLE_M).max(0.2)),
                height_m: Some(most_height),
                ..ObjectRequest::default()
            },
        };
        let object = match drawn(slot.class, given, rng, (base, variant)) {
            Err(AssetError::Dimension { .. }) => continue,
            object => object?,
        };
        let [depth, width, height] = object.size_m;
        if depth <= most_depth + HANDLE_M && width <= most_width + 0.01 && height <= most_height {
            return Ok(Some(StandingObject { object, world_from_root: slot.world_from_back }));
        }
    }
    Ok(None)
}

/// What an object covers of the floor.
fn footprint(placed: &StandingObject) -> Result<Rectangle, AssetError> {
    let (low, high) = bounds_of(&placed.object)?;
    let back = placed.world_from_root * nalgebra::Point3::new(low.x, (low.y + high.y) / 2.0, 0.0);
    let ahead = placed.world_from_root.rotation * Vector3::x();
    Ok(Rectangle {
        back: back.coords.xy(),
        yaw: ahead.y.atan2(ahead.x),
        size: [high.x - low.x, high.y - low.y],
    })
}

fn bounds_of(object: &GeneratedObject) -> Result<(Vector3<f64>, Vector3<f64>), AssetError> {
    let [depth, width, height] = object.size_m;
    let tree = object.description.tree()?;
    let whole = (Vector3::new(0.0, -width / 2.0, 0.0), Vector3::new(depth, width / 2.0, height));
    Ok(tree_bounds(&tree).unwrap_or(whole))
}

/// A free place for furniture with free floor before it; of several, one with something behind it.
fn free_place(
    object: &GeneratedObject,
    ground: &Ground,
    rng: &mut ChaCha8Rng,
) -> Result<Option<Rectangle>, AssetError> {
    let (low, high) = bounds_of(object)?;
    let size = [high.x, 2.0 * high.y.max(-low.y)];
    let [from, to] = ground.bounds();
    let mut standing_free = None;
    for _ in 0..PLACES {
        let at = Vector2::new(rng.random_range(from.x..=to.x), rng.random_range(from.y..=to.y));
        let quarters = rng.random_range(0..4);
        let place =
            Rectangle { back: at, yaw: f64::from(quarters) * std::f64::consts::FRAC_PI_2, size };
        let front = place.stretch(size[0], size[0] + FRONT_M, WIDER_M);
        if !(ground.is_free(&place) && ground.is_free(&front)) {
            continue;
        }
        if !ground.is_clear(&place.stretch(-0.15, 0.0, -0.1)) {
            return Ok(Some(place));
        }
        standing_free.get_or_insert(place);
    }
    Ok(standing_free)
}

/// A microwave on a piece of furniture that is deep and wide enough.
fn on_top(
    place: &Rectangle,
    height: f64,
    rng: &mut ChaCha8Rng,
    (base, variant): (&Base, &Variant),
) -> Result<Option<StandingObject>, AssetError> {
    let world_from_back = place.world_from_back() * Pose::translation(0.0, 0.0, height + 0.002);
    let size_m = [place.size[0] - HANDLE_M, place.size[1], 1.0];
    fitted(&Slot { class: ObjectClass::Microwave, world_from_back, size_m }, rng, (base, variant))
}

impl Variant {
    /// Writes the variant into `folder`, with a task for every object and robot; what `base` shares must have been
    /// written to `../shared`. Returns the task files, relative to the folder, with their classes and robots.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn write(
        &self,
        base: &Base,
        folder: &Path,
        name: &str,
        robots: &[TaskRobot],
    ) -> Result<Vec<(String, ObjectClass, String)>, AssetError> {
        make_folder(folder)?;
        make_folder(&folder.join("tasks"))?;
        let mut links = shared_links(base);
        let mut joints = base.tree.joints().to_vec();
        let mut tasks = Vec::new();
        for placed in &self.objects {
            let object = &placed.object.description.name;
            placed.object.write(&folder.join("objects").join(object))?;
            joints.push(fixed(
                &format!("{object}_place"),
                base.tree.root(),
                links.len(),
                placed.world_from_root,
            ));
            links.push(static_twin(folder, object)?);
            for robot in robots {
                let file = format!("tasks/{object}_{}.toml", robot.name);
                write_file(&folder.join(&file), self.task_text(placed, name, robot))?;
                tasks.push((file, placed.object.class, robot.name.clone()));
            }
        }
        let tree = KinematicTree::new(name.into(), links, joints)?;
        write_file(&folder.join("scene.urdf"), urdf::to_string(&tree))?;
        write_file(&folder.join("scene.json"), format!("{:#}\n", self.manifest(base, name)))?;
        Ok(tasks)
    }

    fn task_text(&self, placed: &StandingObject, scene: &str, robot: &TaskRobot) -> String {
        let object = &placed.object.description.name;
        format!(
            "name = \"{scene}_{object}_{}\"\nseed = {}\n\n[robot]\nfile = \"{}\"\n\n{}\n[scene]\nname = \"{scene}\"\nfile = \"../scene.urdf\"\n# The static twin of the object.\nremove = [\"{object}\"]\n\n{}",
            robot.name,
            self.seed,
            robot.file,
            placed.object.task_tables(&format!("../objects/{object}"), &placed.world_from_root),
            placed.object.goal_table(&placed.world_from_root),
        )
    }

    fn manifest(&self, base: &Base, name: &str) -> Value {
        let objects: Vec<Value> = self
            .objects
            .iter()
            .map(|placed| {
                let object = &placed.object;
                let file = &object.description.name;
                json!({
                    "name": file,
                    "class": object.class.name(),
                    "asset": format!("objects/{file}/{file}.urdf"),
                    "pose": to_xyz_wxyz(&placed.world_from_root),
                    "seed": object.seed,
                    "articulation": object.articulation,
                })
            })
            .collect();
        json!({
            "format": "akrobat scene variant 1",
            "name": name,
            "variant_of": base.name,
            "seed": self.seed,
            "free_floor": self.free_floor,
            "units": "m",
            "up": "z",
            "quat_order": "wxyz",
            "file": "scene.urdf",
            "license": base.license,
            "objects": objects,
            "left_empty": self.left_empty,
        })
    }
}

/// The links of what stands still, whose meshes lie in the folder that variants share.
fn shared_links(base: &Base) -> Vec<Link> {
    let mut links = base.tree.links().to_vec();
    for part in links.iter_mut().flat_map(|l| l.visuals.iter_mut().chain(&mut l.collisions)) {
        if let Shape::Mesh { source, .. } = &mut part.shape {
            *source = format!("../shared/{}/{source}", base.name);
        }
    }
    links
}
