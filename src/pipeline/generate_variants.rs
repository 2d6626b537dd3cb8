//! Variants of imported scenes, as a set like that of generated kitchens.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use akrobat_assets::import::variant::Base;
use akrobat_model::Pose;
use akrobat_model::events::Event;
use akrobat_model::hash;
use akrobat_model::load::AssetSearch;
use akrobat_model::urdf;
use rayon::prelude::*;

use super::generate_scene::{
    SceneEntry, SceneSet, SceneTask, check_distinct, finish_set, rounded, set_written_whole,
    task_robots,
};
use super::{Context, overview};
use crate::Error;

const STAGE: &str = "variants";

/// The variants to be made.
#[derive(Debug, Clone)]
pub struct GenerateVariantsRequest {
    /// Folders of imported scenes, used in turn.
    pub scenes: Vec<PathBuf>,
    /// Number of variants in all.
    pub count: usize,
    /// Seed of the first one; the next ones follow.
    pub seed: u64,
    /// Pieces of furniture on free floor, at most.
    pub furniture: usize,
    /// Robot files that tasks are written for; the built-in robot where empty.
    pub robots: Vec<PathBuf>,
    /// Draw each variant and a contact sheet.
    pub pictures: bool,
    /// Number of threads; one for each core where absent. The result does not depend on it.
    pub threads: Option<usize>,
    /// Folder to write: empty or new.
    pub output: PathBuf,
}

/// Makes variants of imported scenes.
///
/// # Errors
/// Where a folder holds no imported scene, nothing fits into it, the output cannot be written, or the user asks
/// to stop.
pub fn generate_variants(
    request: &GenerateVariantsRequest,
    context: &Context<'_>,
) -> Result<SceneSet, Error> {
    set_written_whole(&request.output, request.count, request.threads, |folder| {
        write_set(folder, request, context)
    })
}

fn write_set(
    folder: &Path,
    request: &GenerateVariantsRequest,
    context: &Context<'_>,
) -> Result<SceneSet, Error> {
    let bases = request.scenes.iter().map(|folder| Base::load(folder));
    let bases = bases.collect::<Result<Vec<_>, _>>()?;
    for (index, base) in bases.iter().enumerate() {
        if bases[..index].iter().any(|other| other.name() == base.name()) {
            let message = format!("two of the scenes are called \"{}\"", base.name());
            return Err(Error::Usage(message));
        }
        base.write_shared(&folder.join("shared"))?;
    }
    let robots = task_robots(folder, &request.robots)?;
    let observer = context.observer;
    let began = Instant::now();
    observer.event(&Event::StageStarted { stage: STAGE, total: Some(request.count as u64) });
    let done = AtomicU64::new(0);
    let one = |index: usize| -> Result<(SceneEntry, Option<image::RgbImage>), Error> {
        if observer.cancelled() {
            return Err(Error::Interrupted("nothing was written".into()));
        }
        let base = &bases[index % bases.len()];
        let name = format!("{}_{:04}", base.name(), index / bases.len() + 1);
        let variant = base.vary(request.seed + index as u64, request.furniture)?;
        let place = folder.join(&name);
        let tasks = variant.write(base, &place, &name, &robots)?;
        let picture = if request.pictures { Some(picture(&place)?) } else { None };
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        observer.event(&Event::Progress { stage: STAGE, done });
        let entry = SceneEntry {
            seed: variant.seed,
            confinement: None,
            layout: base.name().into(),
            aisle_m: None,
            free_floor: rounded(variant.free_floor),
            bodies: variant.objects.len() + base.bodies(),
            attempts: 1,
            sha256: hash::of_file(&place.join("scene.urdf"))?,
            tasks: tasks
                .into_iter()
                .map(|(file, class, robot)| SceneTask {
                    file: Path::new(&name).join(file),
                    class: class.name().into(),
                    robot,
                })
                .collect(),
            name,
        };
        Ok((entry, picture))
    };
    let made: Vec<_> = (0..request.count).into_par_iter().map(one).collect::<Result<_, _>>()?;
    observer.event(&Event::StageFinished { stage: STAGE, seconds: began.elapsed().as_secs_f64() });
    let (scenes, pictures): (Vec<SceneEntry>, Vec<_>) = made.into_iter().unzip();
    check_distinct(&scenes)?;
    let pictures: Vec<image::RgbImage> = pictures.into_iter().flatten().collect();
    finish_set(folder, scenes, &pictures)
}

fn picture(folder: &Path) -> Result<image::RgbImage, Error> {
    let (tree, _) = urdf::read(&folder.join("scene.urdf"), &AssetSearch::default())?;
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let bodies = tree.links().iter().zip(poses).map(|(link, pose)| {
        let parts = if link.visuals.is_empty() { &link.collisions } else { &link.visuals };
        (link.name.clone(), pose, parts.clone())
    });
    overview::room_picture(bodies)
}
