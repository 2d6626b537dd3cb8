//! Reading datasets: episodes and their arrays.

use std::ops::Range;
use std::path::{Path, PathBuf};

use bytemuck::Pod;
use hdf5::{Dataset, H5Type};
use rayon::prelude::*;

use super::description::Description;
use super::manifest::{self, Container, DatasetConfig, ManifestEntry, StoredEpisode};
use crate::error::{PackError, Result};
use crate::h5::{H5Reader, read_error};

/// Levels of groups below an episode.
const MAX_DEPTH: usize = 8;

/// Values of an array, in the type they are stored in.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Colours, phases.
    U8(Vec<u8>),
    /// Segment ids, depth in millimetres.
    U16(Vec<u16>),
    /// Joint positions, clouds, depth in metres.
    F32(Vec<f32>),
    /// Times, camera matrices.
    F64(Vec<f64>),
}

/// A row-major array.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length of every axis.
    pub shape: Vec<usize>,
    /// Values.
    pub values: Values,
}

/// A dataset folder.
#[derive(Debug)]
pub struct DatasetReader {
    folder: PathBuf,
    description: Description,
    entries: Vec<ManifestEntry>,
}

impl DatasetReader {
    /// Opens a dataset folder.
    ///
    /// # Errors
    /// [`PackError::Read`], [`PackError::Damaged`] or [`PackError::Content`].
    pub fn open(folder: &Path) -> Result<Self> {
        let description = Description::read(folder)?;
        let (entries, _) = manifest::read(folder)?;
        Ok(Self { folder: folder.to_path_buf(), description, entries })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub(crate) fn description(&self) -> &Description {
        &self.description
    }

    /// What all episodes share.
    pub fn config(&self) -> &DatasetConfig {
        &self.description.config
    }

    /// False where the run that wrote the dataset has not come to its end.
    pub fn is_complete(&self) -> bool {
        self.description.complete
    }

    /// All lines of the manifest, in order: accepted, filtered and quarantined episodes.
    pub fn entries(&self) -> &[ManifestEntry] {
        &self.entries
    }

    /// The stored episodes, in order.
    pub fn episodes(&self) -> impl Iterator<Item = (&str, &StoredEpisode)> {
        self.entries.iter().filter_map(|e| Some((e.id.as_str(), e.stored.as_ref()?)))
    }

    /// The file of a stored episode, which is no symbolic link.
    ///
    /// # Errors
    /// [`PackError::Content`].
    pub fn file_of(&self, stored: &StoredEpisode) -> Result<PathBuf> {
        let path = self.folder.join(&stored.shard);
        let linked = [path.parent().unwrap_or(&path), &path].iter().any(|p| p.is_symlink());
        if linked {
            let expected = "a file in the dataset's folder";
            return Err(PackError::content(&path, "shard", expected, "a symbolic link"));
        }
        Ok(path)
    }

    /// Opens a stored episode of an HDF5 dataset.
    ///
    /// # Errors
    /// [`PackError::Content`] where the dataset holds MCAP logs or the shard lacks the episode, and as
    /// opening its file.
    pub fn episode(&self, stored: &StoredEpisode) -> Result<EpisodeReader> {
        let path = self.file_of(stored)?;
        if self.config().container != Container::Hdf5 {
            return Err(PackError::content(&path, "container", "HDF5 shards", "MCAP logs"));
        }
        EpisodeReader::open(&path, &stored.key)
    }
}

/// One episode of a shard.
#[derive(Debug)]
pub struct EpisodeReader {
    file: H5Reader,
    root: String,
}

impl EpisodeReader {
    /// Opens episode `key` of a shard.
    ///
    /// # Errors
    /// [`PackError::Read`], [`PackError::Damaged`] or [`PackError::Content`].
    pub fn open(shard: &Path, key: &str) -> Result<Self> {
        let file = H5Reader::open(shard)?;
        crate::trajectory_file::check_format(
            &file,
            crate::shard::FORMAT,
            &[crate::shard::FORMAT_VERSION],
        )?;
        let root = format!("data/{key}");
        file.group(&root)?;
        Ok(Self { file, root })
    }

    fn path_of(&self, name: &str) -> String {
        format!("{}/{name}", self.root)
    }

    pub(crate) fn source(&self) -> (&H5Reader, &str) {
        (&self.file, &self.root)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Paths of all numeric arrays below the episode, sorted; hard links are listed under each name. Colours
    /// that are stored as image files are listed as the arrays that they are read as.
    ///
    /// # Errors
    /// [`PackError::Damaged`].
    pub fn array_names(&self) -> Result<Vec<String>> {
        let mut names = Vec::new();
        self.collect("", &mut names)?;
        names.sort();
        Ok(names)
    }

    fn collect(&self, below: &str, names: &mut Vec<String>) -> Result<()> {
        let path = self.path_of(below);
        let path = path.trim_end_matches('/');
        let group = self.file.group(path)?;
        let members = group.member_names().map_err(|e| read_error(self.file.path(), path, &e))?;
        for member in members {
            let name = if below.is_empty() { member } else { format!("{below}/{member}") };
            match self.file.dataset(&self.path_of(&name)) {
                Ok(dataset) if kind_of(&dataset).is_some() => {
                    names.push(match name.strip_suffix("_rgb_encoded") {
                        Some(camera) => format!("{camera}_rgb"),
                        None => name,
                    });
                }
                Ok(_) => {}
                // More levels than we ever write are a loop of links.
                Err(_) if name.matches('/').count() < MAX_DEPTH => self.collect(&name, names)?,
                Err(_) => {
                    let path = self.file.path();
                    return Err(PackError::damaged(path, format!("{name}: groups without end")));
                }
            }
        }
        Ok(())
    }

    /// A text attribute of the episode.
    ///
    /// # Errors
    /// [`PackError::Content`] where it is absent or not text.
    pub fn text(&self, name: &str) -> Result<String> {
        let group = self.file.group(&self.root)?;
        self.file.attr_str(&group, name)
    }

    /// An attribute of the episode that is a list of texts.
    ///
    /// # Errors
    /// [`PackError::Content`] where it is absent or not a list of texts.
    pub fn texts(&self, name: &str) -> Result<Vec<String>> {
        let group = self.file.group(&self.root)?;
        self.file.attr_strings(&group, name)
    }

    /// An attribute of the episode that is one number of exactly this type.
    ///
    /// # Errors
    /// [`PackError::Content`] where it is absent or of another type.
    pub fn number<T: H5Type>(&self, name: &str) -> Result<T> {
        let group = self.file.group(&self.root)?;
        self.file.attr(&group, name)
    }

    /// Number of frames.
    ///
    /// # Errors
    /// [`PackError::Content`] where the attribute is absent.
    pub fn frames(&self) -> Result<u64> {
        // Shards of earlier versions have it without a sign.
        let signed = self.number::<i64>("num_samples");
        let frames = signed.or_else(|_| self.number::<u64>("num_samples").map(u64::cast_signed))?;
        u64::try_from(frames).map_err(|_| {
            let expected = "a number of frames";
            PackError::content(self.path(), "num_samples", expected, frames.to_string())
        })
    }

    /// Length of every axis of an array.
    ///
    /// # Errors
    /// [`PackError::Content`] where it is absent.
    pub fn shape(&self, name: &str) -> Result<Vec<usize>> {
        if let Some(files) = self.color_files(name)? {
            return Ok(files.shape());
        }
        let path = self.path_of(name);
        self.file.dataset(&path)?.get_shape().map_err(|e| read_error(self.file.path(), &path, &e))
    }

    /// A whole array, by its path below the episode: `actions`, `camera_obs/fixed_rgb`, …
    ///
    /// # Errors
    /// [`PackError::Content`] where it is absent or not numeric, [`PackError::Damaged`] where a checksum fails.
    pub fn array(&self, name: &str) -> Result<Array> {
        let rows = self.shape(name)?.first().copied().unwrap_or(1);
        self.rows(name, 0..rows)
    }

    /// One row along an array's first axis: frame `index`.
    ///
    /// # Errors
    /// As [`EpisodeReader::array`], and [`PackError::Content`] where there is no such frame.
    pub fn frame(&self, name: &str, index: usize) -> Result<Array> {
        let mut array = self.rows(name, index..index + 1)?;
        array.shape.remove(0);
        Ok(array)
    }

    /// Rows along an array's first axis. No more memory is asked for than they take.
    ///
    /// # Errors
    /// As [`EpisodeReader::array`], and [`PackError::Content`] where the array has fewer rows.
    pub fn rows(&self, name: &str, rows: Range<usize>) -> Result<Array> {
        if let Some(files) = self.color_files(name)? {
            return files.rows(&self.file, rows);
        }
        let path = self.path_of(name);
        let dataset = self.file.dataset(&path)?;
        let kind = kind_of(&dataset).ok_or_else(|| {
            let expected = "u8, u16, f32 or f64 values";
            PackError::content(self.file.path(), &path, expected, "another type")
        })?;
        match kind {
            Kind::U8 => self.typed_rows(&path, &dataset, rows, Values::U8),
            Kind::U16 => self.typed_rows(&path, &dataset, rows, Values::U16),
            Kind::F32 => self.typed_rows(&path, &dataset, rows, Values::F32),
            Kind::F64 => self.typed_rows(&path, &dataset, rows, Values::F64),
        }
    }

    fn typed_rows<T: H5Type + Pod>(
        &self,
        path: &str,
        dataset: &Dataset,
        rows: Range<usize>,
        wrap: impl Fn(Vec<T>) -> Values,
    ) -> Result<Array> {
        let any = vec![None; dataset.ndim()];
        let (dataset, mut shape) = self.file.checked::<T>(path, &any)?;
        check_rows(&self.file, path, &rows, shape.first().copied().unwrap_or(1))?;
        let values = self.file.rows(path, &dataset, rows.clone())?;
        if let Some(first) = shape.first_mut() {
            *first = rows.len();
        }
        Ok(Array { shape, values: wrap(values) })
    }

    /// The image files behind `name`, where it is the name of colours that are stored so.
    fn color_files(&self, name: &str) -> Result<Option<ColorFiles>> {
        let Some(camera) = name.strip_suffix("_rgb") else { return Ok(None) };
        let path = self.path_of(&format!("{camera}_rgb_encoded"));
        let Ok(dataset) = self.file.dataset(&path) else { return Ok(None) };
        let size = [self.file.attr(&dataset, "height")?, self.file.attr(&dataset, "width")?];
        // The offsets are not linked under `obs/`.
        let camera = camera.rsplit('/').next().unwrap_or(camera);
        let offsets = self.path_of(&format!("camera_obs/{camera}_rgb_offsets"));
        let (offsets, _) = self.file.array::<u64>(&offsets, &[None])?;
        Ok(Some(ColorFiles { path, offsets, size }))
    }
}

/// One camera's colours as image files.
struct ColorFiles {
    path: String,
    /// Where each frame's file begins, and where the last one ends.
    offsets: Vec<u64>,
    /// Height and width.
    size: [u32; 2],
}

impl ColorFiles {
    fn shape(&self) -> Vec<usize> {
        let [height, width] = self.size.map(|length| length as usize);
        vec![self.offsets.len().saturating_sub(1), height, width, 3]
    }

    fn rows(&self, file: &H5Reader, rows: Range<usize>) -> Result<Array> {
        let (dataset, bytes) = file.checked::<u8>(&self.path, &[None])?;
        let mut shape = self.shape();
        check_rows(file, &self.path, &rows, shape[0])?;
        shape[0] = rows.len();
        let damaged = |frame: usize, message: String| {
            PackError::damaged(file.path(), format!("{}: frame {frame} {message}", self.path))
        };
        let images = rows.into_par_iter().map(|frame| {
            let (first, end) = (self.offsets[frame], self.offsets[frame + 1]);
            if first > end || end > bytes[0] as u64 {
                return Err(damaged(frame, format!("lies at {first}..{end} of {bytes:?} bytes")));
            }
            let content = file.rows::<u8>(&self.path, &dataset, first as usize..end as usize)?;
            let [height, width] = self.size;
            crate::color::decode(&content, width, height).map_err(|m| damaged(frame, m))
        });
        let images = images.collect::<Result<Vec<_>>>()?;
        Ok(Array { shape, values: Values::U8(images.concat()) })
    }
}

fn check_rows(file: &H5Reader, path: &str, rows: &Range<usize>, count: usize) -> Result<()> {
    if rows.end <= count {
        return Ok(());
    }
    let expected = format!("a frame below {count}");
    Err(PackError::content(file.path(), path, expected, (rows.end - 1).to_string()))
}

/// Types that arrays of an episode have.
enum Kind {
    U8,
    U16,
    F32,
    F64,
}

fn kind_of(dataset: &Dataset) -> Option<Kind> {
    let dtype = dataset.dtype().ok()?;
    if dtype.is::<u8>() {
        Some(Kind::U8)
    } else if dtype.is::<u16>() {
        Some(Kind::U16)
    } else if dtype.is::<f32>() {
        Some(Kind::F32)
    } else if dtype.is::<f64>() {
        Some(Kind::F64)
    } else {
        None
    }
}
