//! Writes the demonstration's kitchen, objects, robots and tasks:
//! `write_demo FOLDER SEED [EXAMPLE_ROBOT_DATA]`.

use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(folder), Some(seed)) = (arguments.next(), arguments.next()) else {
        return Err("expected FOLDER SEED [EXAMPLE_ROBOT_DATA]".into());
    };
    let robot_data = arguments.next().map(PathBuf::from);
    let paths = akrobat_assets::demo::write(folder.as_ref(), seed.parse()?, robot_data.as_deref())?;
    for task in paths.tasks {
        println!("{}", task.display());
    }
    Ok(())
}
