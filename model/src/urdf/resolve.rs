//! Where the files are that a URDF names.

use std::path::{Path, PathBuf};

use crate::load::AssetSearch;

/// The file that `filename` of a URDF in `urdf_folder` means: `package://name/rest`, `file://path`, or a
/// path relative to the URDF. A package is the nearest folder above the URDF whose `package.xml` has its
/// name, or that is called like it, or such a folder in the search folders.
///
/// # Errors
/// All paths that were tried.
pub fn resolve(
    filename: &str,
    urdf_folder: &Path,
    search: &AssetSearch,
) -> Result<PathBuf, Vec<PathBuf>> {
    let filename = filename.trim().replace('\\', "/");
    let mut tried = Vec::new();
    let uri = ["package://", "model://"].iter().find_map(|scheme| filename.strip_prefix(scheme));
    let candidates = match uri {
        Some(rest) => {
            let (package, rest) = rest.split_once('/').unwrap_or((rest, ""));
            package_candidates(package, rest, urdf_folder, search)
        }
        None => {
            let path = Path::new(filename.strip_prefix("file://").unwrap_or(&filename));
            let folders = std::iter::once(urdf_folder).chain(search.folders.iter().map(|f| &**f));
            folders.map(|folder| folder.join(path)).collect()
        }
    };
    for candidate in candidates {
        if candidate.is_file() {
            return Ok(candidate);
        }
        if !tried.contains(&candidate) {
            tried.push(candidate);
        }
    }
    Err(tried)
}

/// Candidates in order of preference: named by `package.xml`, named by folder, then the path with the
/// package's name stripped.
fn package_candidates(
    package: &str,
    rest: &str,
    urdf_folder: &Path,
    search: &AssetSearch,
) -> Vec<PathBuf> {
    let absolute = std::path::absolute(urdf_folder).unwrap_or_else(|_| urdf_folder.to_path_buf());
    let above: Vec<PathBuf> = absolute.ancestors().map(Path::to_path_buf).collect();
    let roots: Vec<PathBuf> = above.iter().chain(&search.folders).cloned().collect();
    let named_by_manifest = roots.iter().filter(|f| package_name(f).as_deref() == Some(package));
    let named_by_folder = roots.iter().filter(|f| f.file_name().is_some_and(|n| n == package));
    let inside = roots.iter().map(|folder| folder.join(package));
    let inside_by_manifest = search
        .folders
        .iter()
        .flat_map(|f| subfolders(f))
        .filter(|f| package_name(f).as_deref() == Some(package));
    let stripped = search.folders.iter().chain(above.first());
    let roots_of_package = named_by_manifest
        .cloned()
        .chain(named_by_folder.cloned())
        .chain(inside_by_manifest)
        .chain(inside.filter(|folder| folder.is_dir()))
        .chain(stripped.cloned());
    roots_of_package.map(|root| root.join(rest)).collect()
}

fn subfolders(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut folders: Vec<PathBuf> =
        entries.flatten().map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    folders.sort();
    folders
}

/// The `<name>` in a folder's `package.xml`.
fn package_name(folder: &Path) -> Option<String> {
    let text = std::fs::read_to_string(folder.join("package.xml")).ok()?;
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let document = roxmltree::Document::parse_with_options(&text, options).ok()?;
    let name = super::xml::child(document.root_element(), "name")?;
    name.text().map(|text| text.trim().to_owned())
}
