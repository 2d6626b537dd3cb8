//! What tests ask of a dataset folder.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_model::events::Silent;
use akrobat_packager::dataset::Container;
use akrobat_packager::validate;

/// Content of all files of a dataset by their relative path.
pub fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for below in [folder.to_path_buf(), folder.join("shards")] {
        let entries = std::fs::read_dir(below).into_iter().flatten();
        for entry in entries.flatten().filter(|e| e.path().is_file()) {
            let name = entry.path().strip_prefix(folder).unwrap().to_string_lossy().into_owned();
            files.insert(name, std::fs::read(entry.path()).unwrap());
        }
    }
    files
}

/// The sample dataset in a folder of its own.
pub fn written(container: Container) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    super::sample::write(folder.path(), container, || {}).unwrap();
    folder
}

/// What `validate` finds wrong, a line each.
pub fn problems(folder: &Path) -> String {
    let report = validate(folder, &Silent).unwrap();
    report.problems.iter().map(|p| format!("{}: {}\n", p.place, p.message)).collect()
}
