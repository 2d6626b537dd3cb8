//! Objects, scenes and grasps of other collections -> our layout.

use std::path::{Path, PathBuf};

use akrobat_assets::import::infinigen::{self, Catalog};
use akrobat_assets::import::partnet::{self, Size};
use akrobat_assets::import::{
    ImportedObject, ImportedScene, Ledger, Origin, classes, floor, grasps, layout, mjcf, procthor,
    sdf, static_scene,
};
use akrobat_model::load::AssetSearch;
use akrobat_model::{KinematicTree, urdf};
use serde::Serialize;
use serde_json::Value;

use super::{Context, import_task, overview};
use crate::Error;

/// What is to be imported, and how.
#[derive(Debug, Clone)]
pub enum AssetSource {
    /// A PartNet-Mobility folder.
    PartNet {
        /// Class, where `meta.json` states none or the wrong one.
        class: Option<String>,
        /// How large it is to be.
        size: Size,
    },
    /// An Infinigen scene.
    Infinigen {
        /// `solve_state.json`.
        state: Option<PathBuf>,
        /// Folder of articulated objects that replace placeholders.
        objects: Option<PathBuf>,
    },
    /// An MJCF model; an object or a scene by what is in it where nothing is said.
    Mjcf(Option<AssetKind>),
    /// A URDF.
    Urdf(AssetKind),
    /// A USD stage.
    Usd(AssetKind),
    /// An SDF world or model, or Drake's directives.
    Sdf,
    /// A ProcTHOR or AI2-THOR house.
    ProcThor {
        /// Sizes of assets.
        database: Option<PathBuf>,
    },
}

/// What a description is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AssetKind {
    /// Something with joints, or something rigid.
    Object,
    /// Surroundings.
    Scene,
}

/// What is to be imported, and where to.
#[derive(Debug, Clone)]
pub struct ImportAssetRequest {
    /// The file or folder.
    pub input: PathBuf,
    /// What it is.
    pub source: AssetSource,
    /// Folder to write.
    pub output: PathBuf,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Robot file of the tasks that are written beside it; the built-in robot where absent.
    pub robot: Option<PathBuf>,
    /// Draw it as well: `scene.png`, or `object.png`.
    pub picture: bool,
}

/// What an import gave.
#[derive(Debug, Clone, Serialize)]
pub struct ImportAssetReport {
    /// Folder that was written.
    pub output: PathBuf,
    /// The URDF in it that tasks name.
    pub urdf: PathBuf,
    /// Tasks with what has joints.
    pub tasks: Vec<PathBuf>,
    /// The manifest's content.
    pub manifest: Value,
    /// What was repaired.
    pub repairs: Vec<String>,
    /// What could not be taken over.
    pub lost: Vec<String>,
}

enum Imported {
    Object(ImportedObject),
    Scene(ImportedScene),
}

/// Imports an object or a scene.
///
/// # Errors
/// Where the input is wrong, or the folder cannot be written.
pub fn import_asset(
    request: &ImportAssetRequest,
    context: &Context<'_>,
) -> Result<ImportAssetReport, Error> {
    let search = context.asset_search(&request.assets)?;
    let mut imported = read(&request.input, &request.source, &search, context)?;
    if let Imported::Scene(scene) = &mut imported {
        floor::split_floor(scene);
    }
    let (folder, robot) = (&request.output, request.robot.as_deref());
    let (manifest, file, tasks, ledger) = match imported {
        Imported::Object(object) => {
            let manifest = layout::write_object(folder, &object)?;
            let task = import_task::for_object(folder, &object, robot)?;
            let tasks = task.into_iter().collect();
            if request.picture {
                let closed = object.tree.neutral();
                save(
                    &folder.join("object.png"),
                    &overview::object_picture(&object.tree, &closed)?,
                )?;
            }
            (manifest, format!("{}.urdf", object.name), tasks, object.ledger)
        }
        Imported::Scene(scene) => {
            let manifest = layout::write_scene(folder, &scene)?;
            let tasks = import_task::for_scene(folder, &scene, robot)?;
            if request.picture {
                save(&folder.join("scene.png"), &scene_picture(&scene)?)?;
            }
            let mut ledger = scene.ledger;
            scene.objects.into_iter().for_each(|placed| ledger.extend(placed.object.ledger));
            (manifest, "scene.urdf".into(), tasks, ledger)
        }
    };
    Ok(ImportAssetReport {
        urdf: request.output.join(file),
        output: request.output.clone(),
        tasks,
        manifest,
        repairs: ledger.repairs,
        lost: ledger.lost,
    })
}

fn save(path: &Path, picture: &image::RgbImage) -> Result<(), Error> {
    picture.save(path).map_err(|e| Error::Failed(format!("{}: cannot write: {e}", path.display())))
}

/// What stands still and, closed, what opens.
fn scene_picture(scene: &ImportedScene) -> Result<image::RgbImage, Error> {
    let bodies = scene.bodies.iter().map(|body| {
        let parts = if body.visuals.is_empty() { &body.collisions } else { &body.visuals };
        (body.name.clone(), body.world_from_body, parts.clone())
    });
    let links = scene.objects.iter().flat_map(|placed| {
        let tree = &placed.object.tree;
        let poses = tree.link_poses(&placed.world_from_root, &tree.neutral());
        let parts = tree.links().iter().map(|link| {
            if link.visuals.is_empty() { link.collisions.clone() } else { link.visuals.clone() }
        });
        let names = tree.links().iter().map(|link| format!("{}/{}", placed.object.name, link.name));
        names
            .zip(poses)
            .zip(parts)
            .map(|((name, pose), parts)| (name, pose, parts))
            .collect::<Vec<_>>()
    });
    overview::room_picture(bodies.chain(links))
}

fn read(
    input: &Path,
    source: &AssetSource,
    search: &AssetSearch,
    context: &Context<'_>,
) -> Result<Imported, Error> {
    Ok(match source {
        AssetSource::PartNet { class, size } => {
            Imported::Object(partnet::read(input, class.as_deref(), *size)?)
        }
        AssetSource::Infinigen { state, objects } => {
            let catalog = objects.as_deref().map(Catalog::of_folder).transpose()?;
            let (catalog, state) = (catalog.unwrap_or_default(), state.as_deref());
            Imported::Scene(if is_usd(input) {
                let (tree, ledger) = read_usd(input, search, context)?;
                let stage = static_scene(String::new(), &tree, Origin::default(), ledger)?;
                infinigen::of_bodies(input, stage.bodies, state, &catalog, search, stage.ledger)?
            } else {
                infinigen::read(input, state, &catalog, search)?
            })
        }
        AssetSource::Mjcf(kind) => {
            let is_scene = match kind {
                Some(kind) => *kind == AssetKind::Scene,
                None => mjcf::is_scene(input)?,
            };
            if is_scene {
                Imported::Scene(mjcf::read_scene(input)?)
            } else {
                Imported::Object(mjcf::read_object(input, None)?)
            }
        }
        AssetSource::Urdf(kind) => {
            let (tree, notes) = urdf::read(input, search)?;
            let mut ledger = Ledger::default();
            notes.into_iter().for_each(|note| ledger.repaired(note));
            of_tree(tree, *kind, "URDF", input, ledger)?
        }
        AssetSource::Usd(kind) => {
            let (tree, ledger) = read_usd(input, search, context)?;
            of_tree(tree, *kind, "USD", input, ledger)?
        }
        AssetSource::Sdf => Imported::Scene(sdf::read_scene(input, search)?),
        AssetSource::ProcThor { database } => {
            Imported::Scene(procthor::read(input, database.as_deref())?)
        }
    })
}

/// A tree under the name of the file that it came from.
fn of_tree(
    tree: KinematicTree,
    kind: AssetKind,
    format: &str,
    input: &Path,
    ledger: Ledger,
) -> Result<Imported, Error> {
    let name = layout::file_name(&input.file_stem().unwrap_or_default().to_string_lossy());
    let origin = Origin { source: format!("{format} {name}"), license: String::new() };
    Ok(match kind {
        AssetKind::Object => Imported::Object(ImportedObject {
            class: classes::of_file_name(&name),
            name,
            tree,
            origin,
            semantics: Vec::new(),
            ledger,
        }),
        AssetKind::Scene => Imported::Scene(static_scene(name, &tree, origin, ledger)?),
    })
}

/// The host writes a URDF, which is then read as any other.
fn read_usd(
    input: &Path,
    search: &AssetSearch,
    context: &Context<'_>,
) -> Result<(KinematicTree, Ledger), Error> {
    if !input.is_file() {
        return Err(Error::Usage(format!("{}: no such file", input.display())));
    }
    let host = super::export::host_for(context, "reading USD", "usd")?;
    let folder = tempfile::tempdir().map_err(|e| Error::write(&std::env::temp_dir(), &e))?;
    let stage = host.usd_to_urdf(input, folder.path())?;
    let (tree, notes) = urdf::read(&stage.urdf, search)?;
    let mut ledger = Ledger::default();
    stage.repairs.into_iter().chain(notes).for_each(|note| ledger.repaired(note));
    stage.lost.into_iter().for_each(|note| ledger.lost(note));
    Ok((tree, ledger))
}

fn is_usd(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    ["usd", "usda", "usdc", "usdz"].contains(&&*extension)
}

impl ImportAssetReport {
    /// For people.
    pub fn text(&self) -> String {
        let count = |key: &str| self.manifest[key].as_array().map_or(0, Vec::len);
        let kind = self.manifest["kind"].as_str().unwrap_or("asset");
        let what = match kind {
            "scene" => {
                format!("{} bodies, {} articulated objects", count("bodies"), count("objects"))
            }
            _ => {
                let class = self.manifest["class"].as_str().unwrap_or("");
                format!("{class}, {} joints, {} links", count("joints"), self.manifest["links"])
            }
        };
        let mut lines = vec![format!("{}: {kind} of {what}", self.urdf.display())];
        lines.extend(self.tasks.first().map(|task| {
            format!("plan with it: akrobat plan {} -o trajectories.h5", task.display())
        }));
        lines.extend(self.repairs.iter().map(|repair| format!("  repaired {repair}")));
        lines.extend(self.lost.iter().map(|lost| format!("  lost     {lost}")));
        lines.join("\n")
    }
}

/// Imports grasps into a text file that tasks name; gives their number and the ledger.
///
/// # Errors
/// Where the input is wrong, or the file cannot be written.
pub fn import_grasps(
    input: &Path,
    convention: grasps::Convention,
    output: &Path,
) -> Result<(usize, Ledger), Error> {
    super::check_writable(output)?;
    let imported = grasps::read(input, convention)?;
    let source = input.file_name().unwrap_or_default().to_string_lossy();
    let text = grasps::to_text(&imported, &source);
    let folder = super::folder_of(output);
    let fresh = tempfile::NamedTempFile::new_in(folder).map_err(|e| Error::write(output, &e))?;
    std::fs::write(fresh.path(), text).map_err(|e| Error::write(output, &e))?;
    fresh.as_file().sync_all().map_err(|e| Error::write(output, &e))?;
    fresh.persist(output).map_err(|e| Error::write(output, &e.error))?;
    Ok((imported.poses.len(), imported.ledger))
}
