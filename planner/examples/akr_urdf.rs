//! Writes a robot that holds an object as one URDF (the AKR), for other planners, as one JSON object.
//!
//!     akr_urdf TASK.toml ASSETS LINK "x y z qw qx qy qz" WIDTH_M
//!
//! LINK is the held link, the seven numbers the tool in it. The output has the URDF's text, the joints that move, where all
//! others rest, and where the link that stands for the object's root must stay.

use std::path::{Path, PathBuf};

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::trajectory::Grasp;
use akrobat_model::{pose, urdf};
use akrobat_planner::akr;
use serde_json::{Map, json};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [task, assets, link, tool, width] = &arguments[..] else {
        return Err("usage: akr_urdf TASK.toml ASSETS LINK \"x y z qw qx qy qz\" WIDTH_M".into());
    };
    let search = AssetSearch { folders: vec![PathBuf::from(assets)] };
    let task = load::task(Path::new(task), &search)?;
    let numbers: Vec<f64> = tool.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
    let numbers: [f64; 7] = numbers.try_into().map_err(|_| "expected seven numbers")?;
    let link_from_tool = pose::from_xyz_wxyz(numbers).ok_or("expected a pose")?;
    let grasp = Grasp { id: 0, link: link.clone(), link_from_tool, width_m: width.parse()? };
    let akr = akr::assemble(&task.robot, &task.object, &grasp)?;
    let joints = akr.tree.joints();
    let variables: Vec<&str> = akr.variables.iter().map(|&j| joints[j].name.as_str()).collect();
    let dof = akr.tree.dof_joints().iter();
    let rest: Map<String, serde_json::Value> = dof
        .map(|&j| (joints[j].name.clone(), akr.tree.joint_position(j, &akr.rest).into()))
        .collect();
    let world_from_link = task.object.world_from_root * akr.root_link_from_object.inverse();
    let report = json!({
        "urdf": urdf::to_string(&akr.tree),
        "variables": variables,
        "rest": rest,
        "anchor_link": akr.tree.links()[akr.object_root].name,
        "world_from_anchor_link": pose::to_xyz_wxyz(&world_from_link),
    });
    println!("{report}");
    Ok(())
}
