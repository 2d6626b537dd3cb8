//! The collision geometry of the robot's links, the object's links and the scene.

use akrobat_model::{Link, Part, Scene};
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy};

use crate::JudgeError;
use crate::convex::ConvexPiece;
use crate::kinematics::Frame;
use crate::shapes::Triangles;
use crate::travel;

/// What a triangle or a solid of an [`Obstacle`] belongs to.
#[derive(Debug, Clone)]
pub struct Owner {
    /// Scene body, or link and part of the object, for reports.
    pub label: String,
    /// Name of the part.
    pub part: String,
    /// True for what the robot stands on.
    pub is_floor: bool,
}

/// Something the robot must not enter, in its own frame: a link of the object, or the whole scene.
/// All surfaces are there as triangles; what is known to be solid is there as convex solids too.
#[derive(Debug)]
pub struct Obstacle {
    /// Parts or bodies.
    pub owners: Vec<Owner>,
    /// Corners of all triangles.
    pub triangles: Vec<[Vector; 3]>,
    /// Owner of each triangle.
    pub triangle_owners: Vec<u32>,
    /// Index over the triangles.
    pub triangle_bvh: Bvh,
    /// Solids.
    pub solids: Vec<ConvexPiece>,
    /// Owner of each solid.
    pub solid_owners: Vec<u32>,
    /// Index over the solids.
    pub solid_bvh: Bvh,
}

#[derive(Default)]
struct ObstacleBuilder {
    owners: Vec<Owner>,
    triangles: Vec<[Vector; 3]>,
    triangle_owners: Vec<u32>,
    solids: Vec<ConvexPiece>,
    solid_owners: Vec<u32>,
}

impl ObstacleBuilder {
    fn owner(&mut self, owner: Owner) -> u32 {
        self.owners.push(owner);
        self.owners.len() as u32 - 1
    }

    fn triangles(&mut self, owner: u32, triangles: &Triangles) {
        self.triangles.extend(triangles.corners());
        self.triangle_owners.resize(self.triangles.len(), owner);
    }

    /// Adds the solids that the triangles bound; says so where they are not convex.
    fn solids(&mut self, owner: u32, triangles: &Triangles, notes: &mut Vec<String>) {
        match triangles.convex_components() {
            Some(solids) => self.solids.extend(solids),
            None => notes.push(format!(
                "{}: not made of convex solids; the robot is judged against its surface only",
                self.owners[owner as usize].label
            )),
        }
        self.solid_owners.resize(self.solids.len(), owner);
    }

    fn build(self) -> Obstacle {
        let boxes: Vec<Aabb> =
            self.triangles.iter().map(|t| Aabb::from_points(t.iter().copied())).collect();
        let solid_boxes: Vec<Aabb> = self.solids.iter().map(|s| s.bounds).collect();
        Obstacle {
            triangle_bvh: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes),
            solid_bvh: Bvh::from_leaves(BvhBuildStrategy::Binned, &solid_boxes),
            owners: self.owners,
            triangles: self.triangles,
            triangle_owners: self.triangle_owners,
            solids: self.solids,
            solid_owners: self.solid_owners,
        }
    }
}

impl Obstacle {
    /// The box around everything of it; `None` where it is empty.
    pub fn bounds(&self) -> Option<Aabb> {
        let triangles = self.triangles.iter().map(|t| Aabb::from_points(t.iter().copied()));
        travel::around(triangles.chain(self.solids.iter().map(|s| s.bounds)))
    }

    /// A link of the object, in the link's frame: the triangles of its visuals and collision shapes,
    /// and the convex solids among the latter.
    ///
    /// # Errors
    /// [`JudgeError::Shape`].
    pub fn of_link(link: &Link, notes: &mut Vec<String>) -> Result<Self, JudgeError> {
        let mut builder = ObstacleBuilder::default();
        let described = |part: &Part| Owner {
            label: format!("object link \"{}\" (part \"{}\")", link.name, part.name),
            part: part.name.clone(),
            is_floor: false,
        };
        for part in &link.visuals {
            let triangles = finite_triangles(&link.name, part)?;
            let owner = builder.owner(described(part));
            builder.triangles(owner, &triangles);
            if link.collisions.is_empty() {
                builder.solids(owner, &triangles, notes);
            }
        }
        for part in &link.collisions {
            let triangles = finite_triangles(&link.name, part)?;
            let owner = builder.owner(described(part));
            builder.triangles(owner, &triangles);
            builder.solids(owner, &triangles, notes);
        }
        Ok(builder.build())
    }

    /// The scene, in the world frame.
    ///
    /// # Errors
    /// [`JudgeError::Shape`].
    pub fn of_scene(scene: &Scene) -> Result<Self, JudgeError> {
        let mut builder = ObstacleBuilder::default();
        for body in &scene.bodies {
            let world_from_body = Frame::from_pose(&body.world_from_body);
            let class = body.class.to_lowercase();
            let owner = builder.owner(Owner {
                label: format!("scene body \"{}\"", body.name),
                part: body.name.clone(),
                is_floor: class.contains("floor") || class.contains("ground"),
            });
            for part in body.collision_parts() {
                let mut triangles = finite_triangles(&body.name, part)?;
                for vertex in &mut triangles.vertices {
                    *vertex = world_from_body.point(*vertex);
                }
                builder.triangles(owner, &triangles);
                // Furniture is hardly ever convex: that is no news.
                builder.solids(owner, &triangles, &mut Vec::new());
            }
        }
        Ok(builder.build())
    }
}

/// The solids of a link, in the link's frame: the convex parts of its collision shapes, or the
/// convex hull of a shape that is not convex; of its visuals where it has no collision shapes.
///
/// # Errors
/// [`JudgeError::Shape`].
pub fn link_solids(link: &Link, notes: &mut Vec<String>) -> Result<Vec<ConvexPiece>, JudgeError> {
    let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
    let mut solids = Vec::new();
    for part in parts {
        let triangles = finite_triangles(&link.name, part)?;
        if let Some(convex) = triangles.convex_components() {
            solids.extend(convex);
        } else if let Some(hull) = triangles.hull() {
            notes.push(format!(
                "link \"{}\": shape \"{}\" is not convex; its convex hull of {:.1} l is judged",
                link.name,
                part.name,
                hull.volume * 1e3
            ));
            solids.push(hull);
        } else {
            notes.push(format!(
                "link \"{}\": shape \"{}\" is flat and has no inside to be entered",
                link.name, part.name
            ));
        }
    }
    Ok(solids)
}

fn finite_triangles(owner: &str, part: &Part) -> Result<Triangles, JudgeError> {
    let triangles = Triangles::of_part(part);
    if triangles.is_finite() {
        Ok(triangles)
    } else {
        Err(JudgeError::Shape { owner: owner.into(), part: part.name.clone() })
    }
}
