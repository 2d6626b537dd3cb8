//! Collision spheres of a robot: fitted to its link meshes, or imported from cuRobo's YAML.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_model::{KinematicTree, Link, ModelError, Part, Pose, Robot, TriMesh};
use nalgebra::Vector3;
use serde::Serialize;

use crate::esdf::{Esdf, Triangles, collect_triangles};
use crate::reuse::{Fingerprint, Reuse};

/// A sphere that stands for a part of a link.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Sphere {
    /// Index of the link in the robot's tree.
    pub link: usize,
    /// Centre in the link's frame, metres.
    pub center: [f64; 3],
    /// Radius, metres.
    pub radius: f64,
}

/// How well the spheres of one link stand for its surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SphereFit {
    /// Link name.
    pub link: String,
    /// Number of spheres.
    pub count: usize,
    /// Fraction of surface samples inside some sphere.
    pub coverage: f64,
    /// Largest distance by which a sphere reaches beyond the surface, metres.
    pub protrusion_m: f64,
}

/// Spheres of a robot, with the report of their fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SphereModel {
    /// All spheres, grouped by link.
    pub spheres: Vec<Sphere>,
    /// One report for each link with geometry.
    pub fits: Vec<SphereFit>,
}

/// How closely spheres are fitted to a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closeness {
    /// How far a sphere may reach beyond the surface, metres.
    pub protrusion_m: f64,
    /// Largest number of spheres of one link.
    pub most_per_link: usize,
    /// Fitting stops where this fraction of the surface is covered.
    pub coverage: f64,
}

impl Closeness {
    /// What planning uses: spheres of about `voxel_m` in diameter, or by the size of the link.
    fn of_link(extent: &Vector3<f64>, voxel_m: Option<f64>) -> Self {
        let protrusion_m = voxel_m.map_or(0.06 * extent.norm(), |v| v / 2.0).clamp(0.006, 0.04);
        Self { protrusion_m, most_per_link: 64, coverage: 0.975 }
    }
}

/// Number of candidate centres and of surface samples, at most.
const MAX_CANDIDATES: usize = 2500;
const MAX_SAMPLES: usize = 2500;

/// The spheres of a robot: imported where a YAML is named, else fitted.
///
/// # Errors
/// [`ModelError`] of the YAML.
pub fn of_robot(robot: &Robot, yaml: Option<&Path>) -> Result<SphereModel, ModelError> {
    match yaml {
        Some(path) => import_curobo(robot, path),
        None => Ok(fit(&robot.tree, robot.file.spheres.voxel_m)),
    }
}

/// The spheres of a robot, from the YAML that its file names or fitted once for all tasks that have it.
pub(crate) fn of_robot_reusing(robot: &Robot, reuse: &Reuse) -> Result<SphereModel, ModelError> {
    if let Some(path) = &robot.spheres_path {
        return import_curobo(robot, path);
    }
    let voxel_m = robot.file.spheres.voxel_m;
    let mut geometry = Fingerprint::default();
    geometry.numbers(voxel_m.as_slice());
    for link in robot.tree.links() {
        geometry.text(&link.name);
        geometry.triangles(&link_triangles(link));
    }
    Ok(SphereModel::clone(&reuse.spheres(geometry, || fit(&robot.tree, voxel_m))))
}

/// Fits spheres to every link that has geometry.
pub fn fit(tree: &KinematicTree, voxel_m: Option<f64>) -> SphereModel {
    fit_with(tree, &|extent| Closeness::of_link(extent, voxel_m))
}

/// Fits spheres to every link that has geometry, all as closely.
pub fn fit_closely(tree: &KinematicTree, closeness: Closeness) -> SphereModel {
    fit_with(tree, &|_| closeness)
}

/// Fits at most `most` spheres in all, as closely as that allows: thicker links get larger ones. Links in `arm` are
/// fitted three times as closely as others: they fold up beside one another, and spheres that reach far beyond them
/// would touch wherever they go. Links in `fine` (fingers) are fitted closely in any case, since grasps are planned
/// to the millimetre. Every link keeps one sphere at least, so a tree of very many links can exceed `most`.
pub fn fit_within(tree: &KinematicTree, most: usize, arm: &[usize], fine: &[usize]) -> SphereModel {
    let surfaces = LinkSurface::of_tree(tree);
    let fitted = |looseness: f64| {
        cover_all(&surfaces, &|surface| {
            if fine.contains(&surface.index) {
                return Closeness { protrusion_m: 0.006, most_per_link: 8, coverage: 0.95 };
            }
            // The middle edge of its box: how thick a slender link is, and how wide a flat one.
            let [a, b, c] = surface.extent.into();
            let thickness = a.max(b).min(a.max(c)).min(b.max(c));
            let share = if arm.contains(&surface.index) { 0.5 } else { 1.5 };
            let protrusion_m = (share * looseness * thickness).clamp(0.008, 0.07);
            Closeness { protrusion_m, most_per_link: 64, coverage: 0.97 }
        })
    };
    let mut looseness = 0.03;
    loop {
        let model = fitted(looseness);
        looseness *= 1.25;
        if model.spheres.len() <= most || looseness > 0.5 {
            return model;
        }
    }
}

fn fit_with(
    tree: &KinematicTree,
    closeness: &(dyn Fn(&Vector3<f64>) -> Closeness + Sync),
) -> SphereModel {
    cover_all(&LinkSurface::of_tree(tree), &|surface| closeness(&surface.extent))
}

fn cover_all(
    surfaces: &[LinkSurface],
    closeness: &(dyn Fn(&LinkSurface) -> Closeness + Sync),
) -> SphereModel {
    use rayon::prelude::*;
    let fitted: Vec<_> =
        surfaces.par_iter().map(|surface| surface.cover(&closeness(surface))).collect();
    let mut model = SphereModel { spheres: Vec::new(), fits: Vec::new() };
    for (spheres, report) in fitted {
        model.spheres.extend(spheres);
        model.fits.push(report);
    }
    model
}

/// The triangles that collide of a link, in its frame; its visuals where it has no collision parts.
pub fn link_triangles(link: &Link) -> Triangles {
    let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
    let mut triangles = Triangles::new();
    for mesh in parts.iter().map(Part::triangulate) {
        collect_triangles(&mesh, &Pose::identity(), &mut triangles);
    }
    triangles
}

/// A link's surface, as fitting needs it.
struct LinkSurface {
    index: usize,
    name: String,
    extent: Vector3<f64>,
    field: Esdf,
    samples: Vec<Vector3<f64>>,
}

impl LinkSurface {
    /// The surfaces of all links that have geometry.
    fn of_tree(tree: &KinematicTree) -> Vec<Self> {
        use rayon::prelude::*;
        let indices: Vec<usize> = (0..tree.links().len()).collect();
        indices.par_iter().filter_map(|&index| Self::new(index, &tree.links()[index])).collect()
    }

    fn new(index: usize, link: &Link) -> Option<Self> {
        let triangles = link_triangles(link);
        if triangles.is_empty() {
            return None;
        }
        let corners = triangles.iter().flatten();
        let low = corners.clone().fold(Vector3::repeat(f64::INFINITY), |a, c| a.inf(c));
        let high = corners.fold(Vector3::repeat(f64::NEG_INFINITY), |a, c| a.sup(c));
        let extent = high - low;
        let voxel = (extent.product().max(1e-9) / 30_000.0).cbrt().clamp(0.003, 0.03);
        let pad = Vector3::repeat(3.0 * voxel);
        let field = Esdf::build(&triangles, low - pad, high + pad, voxel, &[low - pad]);
        let samples = surface_samples(&triangles, voxel, MAX_SAMPLES);
        Some(Self { index, name: link.name.clone(), extent, field, samples })
    }

    fn cover(&self, closeness: &Closeness) -> (Vec<Sphere>, SphereFit) {
        let protrusion = closeness.protrusion_m;
        let mut candidates = interior_candidates(&self.field, protrusion);
        thin_out(&mut candidates, MAX_CANDIDATES);
        let mut shallow: Vec<_> = self.samples.iter().map(|s| (*s, protrusion)).collect();
        thin_out(&mut shallow, MAX_CANDIDATES / 2);
        candidates.extend(shallow);

        let chosen = greedy_cover(&candidates, &self.samples, closeness);
        let inside = |s: &Vector3<f64>| chosen.iter().any(|(c, r)| (s - c).norm() <= *r);
        let covered = self.samples.iter().filter(|s| inside(s)).count();
        let beyond = chosen.iter().map(|(c, r)| r + self.field.distance(c));
        let report = SphereFit {
            link: self.name.clone(),
            count: chosen.len(),
            coverage: covered as f64 / self.samples.len().max(1) as f64,
            protrusion_m: beyond.fold(0.0, f64::max),
        };
        let sphere = |&(center, radius): &(Vector3<f64>, f64)| Sphere {
            link: self.index,
            center: center.into(),
            radius,
        };
        (chosen.iter().map(sphere).collect(), report)
    }
}

/// Centres inside the surface, each with the radius that reaches `protrusion` beyond it.
fn interior_candidates(field: &Esdf, protrusion: f64) -> Vec<(Vector3<f64>, f64)> {
    let mut out = Vec::new();
    let [nx, ny, nz] = field.size();
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let center =
                    field.low() + Vector3::new(x as f64, y as f64, z as f64) * field.voxel_m();
                let distance = field.distance(&center);
                if distance < 0.0 {
                    out.push((center, protrusion - distance));
                }
            }
        }
    }
    out
}

fn thin_out<T>(items: &mut Vec<T>, most: usize) {
    let step = items.len().div_ceil(most).max(1);
    let mut index = 0;
    items.retain(|_| {
        index += 1;
        (index - 1) % step == 0
    });
}

/// Greedy set cover: the candidate that covers most samples not yet covered, until enough are.
fn greedy_cover(
    candidates: &[(Vector3<f64>, f64)],
    samples: &[Vector3<f64>],
    closeness: &Closeness,
) -> Vec<(Vector3<f64>, f64)> {
    let covers: Vec<Vec<u32>> = candidates
        .iter()
        .map(|(c, r)| {
            let inside = |s: &Vector3<f64>| (s - c).norm_squared() <= r * r;
            (0..samples.len() as u32).filter(|&s| inside(&samples[s as usize])).collect()
        })
        .collect();
    let mut covered = vec![false; samples.len()];
    let mut gains: Vec<usize> = covers.iter().map(Vec::len).collect();
    let mut remaining = samples.len();
    let enough = samples.len() - (samples.len() as f64 * closeness.coverage) as usize;
    let mut chosen = Vec::new();
    while remaining > enough && chosen.len() < closeness.most_per_link {
        // Gains only shrink: a candidate whose stale gain is not the best need not be counted again.
        let mut best = (0, 0);
        for (index, gain) in gains.iter_mut().enumerate() {
            if *gain > best.0 {
                *gain = covers[index].iter().filter(|&&s| !covered[s as usize]).count();
                if *gain > best.0 {
                    best = (*gain, index);
                }
            }
        }
        if best.0 == 0 {
            break;
        }
        for &sample in &covers[best.1] {
            covered[sample as usize] = true;
        }
        remaining -= best.0;
        chosen.push(candidates[best.1]);
    }
    chosen
}

/// Points on a surface, about `spacing_m` apart: a regular barycentric grid on every triangle.
pub fn surface_samples(
    triangles: &[[Vector3<f64>; 3]],
    spacing_m: f64,
    most: usize,
) -> Vec<Vector3<f64>> {
    let mut out = Vec::new();
    for [a, b, c] in triangles {
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let steps = (longest / spacing_m).ceil().max(1.0);
        let count = steps as usize;
        for i in 0..=count {
            for j in 0..=count - i {
                out.push(a + (b - a) * (i as f64 / steps) + (c - a) * (j as f64 / steps));
            }
        }
    }
    thin_out(&mut out, most);
    out
}

/// Reads the `collision_spheres` of a cuRobo robot YAML. Links are renamed as the robot file says.
///
/// # Errors
/// [`ModelError`] where the file is unreadable, not of that form, or names an unknown link.
pub fn import_curobo(robot: &Robot, path: &Path) -> Result<SphereModel, ModelError> {
    let text = std::fs::read_to_string(path).map_err(|e| ModelError::read(path, e))?;
    let document: serde_yaml_ng::Value =
        serde_yaml_ng::from_str(&text).map_err(|e| ModelError::invalid(path, e.to_string()))?;
    let section = find_key(&document, "collision_spheres").ok_or_else(|| {
        ModelError::invalid(path, "expected a `collision_spheres` mapping (cuRobo robot YAML)")
    })?;
    let by_link: BTreeMap<String, Vec<YamlSphere>> = serde_yaml_ng::from_value(section.clone())
        .map_err(|e| {
            ModelError::invalid(
                path,
                format!("collision_spheres: expected link: [{{center, radius}}]: {e}"),
            )
        })?;
    let mut model = SphereModel { spheres: Vec::new(), fits: Vec::new() };
    for (name, spheres) in by_link {
        let name = robot.file.spheres.rename.get(&name).cloned().unwrap_or(name);
        let link = robot.tree.link_index(&name)?;
        let first = model.spheres.len();
        for sphere in spheres.iter().filter(|s| s.radius > 0.0) {
            model.spheres.push(Sphere { link, center: sphere.center, radius: sphere.radius });
        }
        model.fits.push(measure(&robot.tree, link, &model.spheres[first..]));
    }
    Ok(model)
}

#[derive(serde::Deserialize)]
struct YamlSphere {
    center: [f64; 3],
    radius: f64,
}

fn find_key<'a>(value: &'a serde_yaml_ng::Value, key: &str) -> Option<&'a serde_yaml_ng::Value> {
    let mapping = value.as_mapping()?;
    mapping.get(key).or_else(|| mapping.values().find_map(|inner| find_key(inner, key)))
}

/// Coverage and protrusion of given spheres on a link's surface.
fn measure(tree: &KinematicTree, link: usize, spheres: &[Sphere]) -> SphereFit {
    let triangles = link_triangles(&tree.links()[link]);
    let samples = surface_samples(&triangles, 0.01, MAX_SAMPLES);
    let inside = |s: &Vector3<f64>| {
        spheres.iter().any(|sphere| (s - Vector3::from(sphere.center)).norm() <= sphere.radius)
    };
    let covered = samples.iter().filter(|s| inside(s)).count();
    let nearest = |sphere: &Sphere| {
        let center = Vector3::from(sphere.center);
        samples.iter().map(|s| (s - center).norm()).fold(f64::INFINITY, f64::min)
    };
    SphereFit {
        link: tree.links()[link].name.clone(),
        count: spheres.len(),
        coverage: covered as f64 / samples.len().max(1) as f64,
        protrusion_m: spheres.iter().map(|s| s.radius - nearest(s)).fold(0.0, f64::max),
    }
}

/// Meshes of several parts, for callers that need triangles in another frame.
pub fn part_meshes<'a>(parts: impl IntoIterator<Item = &'a Part>) -> Vec<TriMesh> {
    parts.into_iter().flat_map(Part::triangulate).collect()
}

/// Spheres as the `collision_spheres` of a cuRobo robot YAML, which [`import_curobo`] reads.
pub fn to_curobo_yaml(tree: &KinematicTree, model: &SphereModel) -> String {
    use std::fmt::Write as _;
    let mut text = String::from("collision_spheres:\n");
    for (index, link) in tree.links().iter().enumerate() {
        let own: Vec<&Sphere> = model.spheres.iter().filter(|s| s.link == index).collect();
        if own.is_empty() {
            continue;
        }
        // A JSON string is a YAML string; writing to a String cannot fail.
        let _ = writeln!(text, "  {}:", serde_json::Value::from(link.name.as_str()));
        for Sphere { center: [x, y, z], radius, .. } in own {
            let _ =
                writeln!(text, "    - {{center: [{x:.5}, {y:.5}, {z:.5}], radius: {radius:.5}}}");
        }
    }
    text
}
