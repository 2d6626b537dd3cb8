//! Procedural objects, written so that they can be planned with at once.

use std::path::{Path, PathBuf};

use akrobat_assets::object::{self, GeneratedObject, ObjectClass, ObjectRequest};
use akrobat_assets::robot::DemoRobot;
use akrobat_model::load::AssetSearch;
use akrobat_model::mesh_io::MeshCache;
use akrobat_model::urdf;
use serde::Serialize;

use super::{folder_of, overview};
use crate::Error;

/// The object to be made.
#[derive(Debug, Clone)]
pub struct GenerateObjectRequest {
    /// Its class.
    pub class: ObjectClass,
    /// Its name; the class's where absent.
    pub name: Option<String>,
    /// Parameters.
    pub parameters: ObjectRequest,
    /// Robot file of the task that is written beside it; the built-in robot's where absent.
    pub robot: Option<PathBuf>,
    /// Draw it as well, closed and opened: `object.png`.
    pub picture: bool,
    /// Folder to write: empty or new.
    pub output: PathBuf,
}

/// What was made.
#[derive(Debug, Clone, Serialize)]
pub struct GenerateObjectReport {
    /// The folder.
    pub output: PathBuf,
    /// Its URDF.
    pub urdf: PathBuf,
    /// A task with it.
    pub task: PathBuf,
    /// Its class.
    pub class: ObjectClass,
    /// Depth, width and height, metres.
    pub size_m: [f64; 3],
    /// Number of grasps at which an 8 cm gripper fits.
    pub grasps: usize,
}

/// Makes an object.
///
/// # Errors
/// Where a parameter cannot be built or the output cannot be written.
pub fn generate_object(request: &GenerateObjectRequest) -> Result<GenerateObjectReport, Error> {
    let name = request.name.as_deref().unwrap_or(request.class.name());
    check_name(name)?;
    let palette = object::palette_of(request.parameters.seed);
    let object = object::generate(request.class, name, &request.parameters, &palette)?;
    let robot = request
        .robot
        .as_deref()
        .map(|file| file.canonicalize().map_err(|e| akrobat_model::ModelError::read(file, e)));
    let robot = robot.transpose()?;
    written_whole(&request.output, |folder| {
        write_object(folder, &object, robot.as_deref())?;
        if request.picture { write_picture(folder, &object) } else { Ok(()) }
    })?;
    Ok(GenerateObjectReport {
        urdf: request.output.join(format!("{name}.urdf")),
        task: request.output.join("task.toml"),
        output: request.output.clone(),
        class: object.class,
        size_m: object.size_m,
        grasps: object.grasps.len(),
    })
}

fn write_object(
    folder: &Path,
    object: &GeneratedObject,
    robot: Option<&Path>,
) -> Result<(), Error> {
    object.write(folder)?;
    let robot_file = match robot {
        Some(file) => file.display().to_string(),
        None => {
            DemoRobot::Pillar.write(&folder.join("robots"))?;
            "robots/pillar.toml".into()
        }
    };
    let task = folder.join("task.toml");
    std::fs::write(&task, object::task_text(object, &robot_file))
        .map_err(|e| Error::write(&task, &e))
}

/// The object closed, opened to its first goal where it opens, and with its grasps.
fn write_picture(folder: &Path, object: &GeneratedObject) -> Result<(), Error> {
    let path = folder.join(format!("{}.urdf", object.description.name));
    let tree = urdf::load(&path, &AssetSearch::default(), &mut MeshCache::default())?.tree;
    let closed = tree.neutral();
    let mut pictures = vec![overview::object_picture(&tree, &closed)?];
    if let Some(articulation) = &object.articulation {
        let mut opened = closed;
        if let Some(column) = tree.column(tree.joint_index(&articulation.joint)?) {
            opened[column] = articulation.goals.first().copied().unwrap_or(0.0);
        }
        pictures.push(overview::object_picture(&tree, &opened)?);
    }
    let handle = tree.link_index(&object.handle_link)?;
    pictures.push(overview::grasps_picture(&tree, handle, &object.grasps)?);
    let path = folder.join("object.png");
    overview::sheet(&pictures, pictures.len())
        .save(&path)
        .map_err(|e| Error::Failed(format!("{}: cannot write: {e}", path.display())))
}

fn check_name(name: &str) -> Result<(), Error> {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !name.is_empty() && name.chars().all(fits) {
        return Ok(());
    }
    Err(Error::Usage(format!(
        "--name: expected letters, digits, `_` and `-`, as in file names, got \"{name}\""
    )))
}

/// Writes a folder under another name and renames it once it is whole; the output must be new or empty.
pub(super) fn written_whole(
    output: &Path,
    write: impl FnOnce(&Path) -> Result<(), Error>,
) -> Result<(), Error> {
    if std::fs::read_dir(output).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Error::Usage(format!(
            "{}: the folder is not empty; choose another with -o, or remove it",
            output.display()
        )));
    }
    let parent = folder_of(output);
    std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, &e))?;
    let temporary = tempfile::Builder::new()
        .prefix(".akrobat-")
        .tempdir_in(parent)
        .map_err(|e| Error::write(output, &e))?;
    let whole = temporary.path().join("whole");
    std::fs::create_dir(&whole).map_err(|e| Error::write(&whole, &e))?;
    write(&whole)?;
    // Renaming replaces an empty folder, and fails for a file of that name.
    std::fs::rename(&whole, output).map_err(|e| Error::write(output, &e))
}
