//! The demonstration: a kitchen, three things to open, and robots to open them.

use std::path::{Path, PathBuf};

use crate::error::{AssetError, make_folder, write_file};
use crate::kitchen::{Kitchen, Openable};
use crate::robot::DemoRobot;

/// What [`write`] wrote.
#[derive(Debug, Clone)]
pub struct DemoPaths {
    /// The folder of everything.
    pub folder: PathBuf,
    /// Task files: for each robot a microwave oven, a cabinet door and a drawer.
    pub tasks: Vec<PathBuf>,
    /// Robot files.
    pub robots: Vec<PathBuf>,
    /// The kitchen's URDF.
    pub scene: PathBuf,
    /// Folders to add to the asset search path.
    pub search_folders: Vec<PathBuf>,
}

/// Writes the whole demonstration into `folder`: kitchen, objects, the primitive-shaped robot and its
/// tasks, and TIAGo with its tasks where the folder of an `example-robot-data` installation is given
/// (the one that holds its `robots` folder).
///
/// # Errors
/// Where a file cannot be written.
pub fn write(
    folder: &Path,
    seed: u64,
    example_robot_data: Option<&Path>,
) -> Result<DemoPaths, AssetError> {
    let kitchen = Kitchen::generate(seed)?;
    kitchen.scene.write(&folder.join("scene"))?;
    for openable in &kitchen.openables {
        let description = &openable.appliance.description;
        description.write(&folder.join("objects").join(&description.name))?;
    }
    let mut cast = vec![DemoRobot::Pillar];
    cast.extend(example_robot_data.map(|_| DemoRobot::Tiago));
    make_folder(&folder.join("tasks"))?;
    let mut robots = Vec::new();
    let mut tasks = Vec::new();
    for robot in cast {
        robots.push(robot.write(&folder.join("robots"))?);
        for openable in &kitchen.openables {
            let name = format!("{}_{}", openable.appliance.description.name, robot.name());
            let path = folder.join("tasks").join(format!("{name}.toml"));
            write_file(&path, task_text(&name, seed, robot, openable))?;
            tasks.push(path);
        }
    }
    Ok(DemoPaths {
        folder: folder.to_path_buf(),
        tasks,
        robots,
        scene: folder.join("scene").join("kitchen.urdf"),
        search_folders: example_robot_data.map(Path::to_path_buf).into_iter().collect(),
    })
}

fn task_text(name: &str, seed: u64, robot: DemoRobot, openable: &Openable) -> String {
    let Openable { appliance, body, world_from_root: [x, y, z] } = openable;
    let object = &appliance.description.name;
    let robot = robot.name();
    let goals: Vec<String> = appliance.goals.iter().map(|goal| format!("{goal:.4}")).collect();
    format!(
        r#"name = "{name}"
seed = {seed}

[robot]
file = "../robots/{robot}.toml"

[object]
name = "{object}"
urdf = "../objects/{object}/{object}.urdf"
license = "MIT OR Apache-2.0"
pose = [{x:.4}, {y:.4}, {z:.4}, 1.0, 0.0, 0.0, 0.0]
joint = "{joint}"

[object.handle]
link = "{handle}"

[scene]
name = "kitchen_{seed}"
file = "../scene/kitchen.urdf"
# The static twin of the object.
remove = ["{body}"]

[goal]
positions = [{goals}]
"#,
        joint = appliance.joint,
        handle = appliance.handle_link,
        goals = goals.join(", "),
    )
}
