//! Writes a small synthetic dataset: `sample_dataset FOLDER [hdf5|mcap]`.

mod sample;

use std::path::Path;
use std::process::ExitCode;

use akrobat_packager::dataset::Container;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (folder, container) = match arguments.as_slice() {
        [folder] => (folder, Container::Hdf5),
        [folder, kind] if kind == "hdf5" => (folder, Container::Hdf5),
        [folder, kind] if kind == "mcap" => (folder, Container::Mcap),
        _ => {
            eprintln!("usage: sample_dataset FOLDER [hdf5|mcap]");
            return ExitCode::from(2);
        }
    };
    match sample::write(Path::new(folder), container, || {}) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(error.exit_code() as u8)
        }
    }
}
