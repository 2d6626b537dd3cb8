//! One robot from several descriptions: arms on a base, or on a box.

use std::path::PathBuf;

use akrobat_model::load::AssetSearch;
use akrobat_model::mesh_io::MeshCache;
use akrobat_model::{Joint, KinematicTree, Link, Material, ModelError, Part, Pose, Shape, urdf};

use crate::import::Ledger;

/// What carries the arms.
#[derive(Debug, Clone)]
pub enum Carrier {
    /// A base with a URDF of its own.
    Urdf(PathBuf),
    /// A box on the floor: edge lengths along x, y, z, metres.
    Box([f64; 3]),
}

/// The link of a box that arms are bolted on.
const BOX_TOP: &str = "box_top";

/// Where one arm stands on its carrier.
#[derive(Debug, Clone, PartialEq)]
pub struct Mount {
    /// Link of the carrier; its root where absent, the top of a box.
    pub link: Option<String>,
    /// Pose of the arm's root in that link.
    pub link_from_arm: Pose,
    /// What the arm's links and joints are called from then on; empty where one arm needs no prefix.
    pub prefix: String,
}

/// The carrier with an arm on each mount.
pub(super) fn mounted(
    path: &std::path::Path,
    arm: KinematicTree,
    carrier: &Carrier,
    mounts: &[Mount],
    search: &AssetSearch,
    cache: &mut MeshCache,
    ledger: &mut Ledger,
) -> Result<KinematicTree, ModelError> {
    let mut tree = match carrier {
        Carrier::Urdf(base) => {
            let loaded = urdf::load(base, search, cache)?;
            loaded.notes.into_iter().for_each(|note| ledger.repaired(note));
            loaded.tree
        }
        Carrier::Box(size) => box_base(*size)?,
    };
    let (base_name, arm_name) = (tree.name.clone(), arm.name.clone());
    for mount in mounts {
        let link = match &mount.link {
            Some(link) => tree.link_index(link)?,
            None if matches!(carrier, Carrier::Box(_)) => tree.link_index(BOX_TOP)?,
            None => tree.root(),
        };
        let mut prefix = mount.prefix.clone();
        if prefix.is_empty() && clashes(&tree, &arm) {
            prefix = format!("{arm_name}_");
            ledger.repaired(format!(
                "names of \"{arm_name}\" that \"{base_name}\" has as well start with \"{prefix}\""
            ));
        }
        tree = tree.attach(link, mount.link_from_arm, prefixed(&arm, &prefix)?).map_err(|e| {
            ModelError::invalid(path, format!("{e}: give each mount a prefix of its own"))
        })?;
    }
    let name = format!("{base_name}_{arm_name}");
    KinematicTree::new(name, tree.links().to_vec(), tree.joints().to_vec())
}

fn clashes(base: &KinematicTree, arm: &KinematicTree) -> bool {
    let links =
        |tree: &KinematicTree| tree.links().iter().map(|l| l.name.clone()).collect::<Vec<_>>();
    let joints =
        |tree: &KinematicTree| tree.joints().iter().map(|j| j.name.clone()).collect::<Vec<_>>();
    links(arm).iter().any(|name| links(base).contains(name))
        || joints(arm).iter().any(|name| joints(base).contains(name))
}

fn prefixed(tree: &KinematicTree, prefix: &str) -> Result<KinematicTree, ModelError> {
    let rename = |name: &str| format!("{prefix}{name}");
    let links = tree.links().iter().map(|l| Link { name: rename(&l.name), ..l.clone() });
    let joints = tree.joints().iter().map(|j| Joint { name: rename(&j.name), ..j.clone() });
    KinematicTree::new(tree.name.clone(), links.collect(), joints.collect())
}

/// A box that stands on the floor: its root lies there, and its top is a link.
fn box_base(size: [f64; 3]) -> Result<KinematicTree, ModelError> {
    if !size.iter().all(|s| s.is_finite() && *s > 0.0) {
        let message = format!("expected three lengths above 0, got {size:?}");
        return Err(ModelError::bad_value("box", message));
    }
    let material = Material {
        name: "grey".into(),
        base_color: [0.25, 0.26, 0.28, 1.0],
        ..Material::default()
    };
    let part = Part {
        name: "box".into(),
        link_from_part: Pose::translation(0.0, 0.0, -size[2] / 2.0),
        shape: Shape::Box { size },
        material: Some(material),
    };
    let top = Link {
        name: BOX_TOP.into(),
        visuals: vec![part.clone()],
        collisions: vec![part],
        inertial: None,
    };
    let floor = Link { name: "box_floor".into(), ..Link::default() };
    let joint =
        crate::import::layout::fixed("box_stand", 0, 1, Pose::translation(0.0, 0.0, size[2]));
    KinematicTree::new("box".into(), vec![floor, top], vec![joint])
}
