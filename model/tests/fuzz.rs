//! Real URDF, robot and task files, damaged at random: loading gives a value or an error, soon and in little memory.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

use std::path::Path;
use std::time::{Duration, Instant};

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::{ModelError, fixtures, urdf};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;

const OBJECTS: [&str; 8] = [
    "cabinet_1001/cabinet.urdf",
    "dishwasher_1001/dishwasher.urdf",
    "drawer_1001/drawer.urdf",
    "microwave_1001/microwave.urdf",
    "oven_1001/oven.urdf",
    "refrigerator_1001/refrigerator.urdf",
    "trash_1001/trash.urdf",
    "sektion_cabinet/urdf/sektion_cabinet.urdf",
];
const ROBOT: &str = "summit_xl_franka/summit_xl_franka.urdf";
/// What is put into files: numbers at the edge of what they can be, and what means something to a parser.
const TOKENS: [&str; 20] = [
    "nan",
    "-inf",
    "1e308",
    "-1",
    "0",
    "0 0 0",
    "99999999999999999999",
    "",
    "\"",
    "<",
    "/>",
    "&amp;",
    "<!--",
    "link",
    "joint_0",
    "[",
    "]]",
    "= {",
    "\u{0}",
    "\u{1f916}",
];
/// Far beyond what one file takes on a busy machine, and far below what a loop without end would.
const LONGEST: Duration = Duration::from_secs(20);
const MOST_MEMORY_KB: u64 = 1_000_000;
/// Shape of everything: what counts is how files are read, not how large they are.
const TETRAHEDRON: &str =
    "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

/// One edit at a place given as a share of the text.
#[derive(Debug, Clone)]
enum Edit {
    Cut {
        at: f64,
        bytes: usize,
    },
    Repeat {
        at: f64,
        bytes: usize,
    },
    Insert {
        at: f64,
        token: usize,
    },
    /// Puts a token in place of a number or word.
    Replace {
        at: f64,
        token: usize,
    },
    End {
        at: f64,
    },
}

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let at = || 0.0..1.0f64;
    let token = || 0..TOKENS.len();
    let edit = prop_oneof![
        1 => (at(), 1..200usize).prop_map(|(at, bytes)| Edit::Cut { at, bytes }),
        1 => (at(), 1..400usize).prop_map(|(at, bytes)| Edit::Repeat { at, bytes }),
        1 => (at(), token()).prop_map(|(at, token)| Edit::Insert { at, token }),
        4 => (at(), token()).prop_map(|(at, token)| Edit::Replace { at, token }),
        1 => at().prop_map(|at| Edit::End { at }),
    ];
    prop::collection::vec(edit, 1..5)
}

/// The text after the edits; what they break in UTF-8 is replaced.
fn damaged(text: &str, edits: &[Edit]) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    for edit in edits {
        let place = |at: f64| ((at * bytes.len() as f64) as usize).min(bytes.len());
        match *edit {
            Edit::Cut { at, bytes: count } => {
                let first = place(at);
                bytes.drain(first..(first + count).min(bytes.len()));
            }
            Edit::Repeat { at, bytes: count } => {
                let first = place(at);
                let again = bytes[first..(first + count).min(bytes.len())].to_vec();
                bytes.splice(first..first, again);
            }
            Edit::Insert { at, token } => {
                let first = place(at);
                bytes.splice(first..first, TOKENS[token].bytes());
            }
            Edit::Replace { at, token } => {
                let inside = |b: &u8| b.is_ascii_alphanumeric() || b"._-+".contains(b);
                let middle = place(at);
                let first = bytes[..middle].iter().rposition(|b| !inside(b)).map_or(0, |p| p + 1);
                let length = bytes[first..].iter().take_while(|b| inside(b)).count();
                bytes.splice(first..first + length, TOKENS[token].bytes());
            }
            Edit::End { at } => bytes.truncate(place(at)),
        }
    }
    bytes
}

/// A copy of a URDF whose meshes are small and lie beside it.
fn with_small_meshes(urdf: &Path, folder: &Path) -> String {
    let text = std::fs::read_to_string(urdf).unwrap();
    let mut out = String::new();
    for (index, piece) in text.split("filename=\"").enumerate() {
        if index == 0 {
            out += piece;
            continue;
        }
        let (name, rest) = piece.split_once('"').unwrap();
        let stem = Path::new(name).file_stem().unwrap().to_string_lossy().into_owned();
        std::fs::write(folder.join(format!("{stem}.obj")), TETRAHEDRON).unwrap();
        out += &format!("filename=\"{stem}.obj\"{rest}");
    }
    out
}

/// Loads many damaged copies of `file`, which is in `folder`. Gives how many were refused.
fn refused<T>(
    folder: &Path,
    file: &str,
    text: &str,
    cases: u32,
    load: impl Fn(&Path) -> Result<T, ModelError>,
) -> u32 {
    let path = folder.join(file);
    std::fs::write(&path, text).unwrap();
    load(&path).unwrap_or_else(|e| panic!("the whole file: {e}"));
    let refusals = std::cell::Cell::new(0);
    let mut runner = TestRunner::new(ProptestConfig::with_cases(cases));
    let result = runner.run(&edits(), |edits| {
        std::fs::write(&path, damaged(text, &edits)).unwrap();
        let began = Instant::now();
        if let Err(error) = load(&path) {
            refusals.set(refusals.get() + 1);
            prop_assert!(!error.to_string().is_empty());
        }
        prop_assert!(began.elapsed() < LONGEST, "took {:?}", began.elapsed());
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{file}: {e}"));
    std::fs::write(&path, text).unwrap();
    refusals.get()
}

/// Largest memory of this process so far, kB.
fn peak_memory_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[test]
fn damaged_files_are_read_or_refused() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let search = AssetSearch { folders: vec![folder.to_path_buf()] };
    let mut refusals = Vec::new();
    for object in OBJECTS {
        let text = with_small_meshes(&assets.join("objects").join(object), folder);
        refusals.push(refused(folder, "object.urdf", &text, 60, |path| urdf::read(path, &search)));
    }
    let text = with_small_meshes(&assets.join("robots").join(ROBOT), folder);
    refusals.push(refused(folder, "summit_xl_franka.urdf", &text, 60, |path| {
        urdf::read(path, &search)
    }));

    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    let read = |file: &str| std::fs::read_to_string(configs.join(file)).unwrap();
    let robot = read("robots/summit_franka.toml").replace("robots/summit_xl_franka/", "");
    refusals.push(refused(folder, "summit_franka.toml", &robot, 150, |path| {
        load::robot(path, &search)
    }));
    let drawer = with_small_meshes(&assets.join("objects/drawer_1001/drawer.urdf"), folder);
    std::fs::write(folder.join("drawer.urdf"), drawer).unwrap();
    let task = read("tasks/summit_drawer_empty.toml").replace("../robots/", "");
    let task = task.replace("objects/drawer_1001/", "");
    refusals.push(refused(folder, "task.toml", &task, 150, |path| load::task(path, &search)));

    // Some damage has to be noticed; not all can be.
    assert!(refusals.iter().all(|&count| count > 10), "{refusals:?}");
    if let Some(peak) = peak_memory_kb() {
        assert!(peak < MOST_MEMORY_KB, "{peak} kB");
    }
}
