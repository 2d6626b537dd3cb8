//! Static surroundings.

use crate::{Part, Pose};

/// A static body of a scene.
#[derive(Debug, Clone)]
pub struct SceneBody {
    /// Unique name in the scene (a glTF node's, a URDF link's, or the task's).
    pub name: String,
    /// Semantic class where it is known (`wall`, `floor`, `oven`, …), else the name's stem.
    pub class: String,
    /// Pose of the body.
    pub world_from_body: Pose,
    /// What is seen.
    pub visuals: Vec<Part>,
    /// What collides; where empty, the visuals do.
    pub collisions: Vec<Part>,
}

impl SceneBody {
    /// The parts that collide.
    pub fn collision_parts(&self) -> &[Part] {
        if self.collisions.is_empty() { &self.visuals } else { &self.collisions }
    }
}

/// Everything in the world that is neither the robot nor the manipulated object. Z up, metres.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    /// Name for identities and reports.
    pub name: String,
    /// The bodies.
    pub bodies: Vec<SceneBody>,
    /// Repairs and oddities found while loading, in the user's words.
    pub notes: Vec<String>,
}
