//! Reading datasets: episodes and their arrays.

use std::path::{Path, PathBuf};

use hdf5::{Dataset, H5Type, Hyperslab, SliceOrIndex};

use super::manifest::{self, Container, DatasetConfig, Description, ManifestEntry, StoredEpisode};
use crate::error::{PackError, Result};
use crate::h5::{H5Reader, read_error};

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

    /// Opens a stored episode of an HDF5 dataset.
    ///
    /// # Errors
    /// [`PackError::Content`] where the dataset holds MCAP logs or the shard lacks the episode, and as
    /// opening its file.
    pub fn episode(&self, stored: &StoredEpisode) -> Result<EpisodeReader> {
        let path = self.folder.join(&stored.shard);
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

    /// Paths of all numeric arrays below the episode, sorted; hard links are listed under each name.
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
                Ok(dataset) if kind_of(&dataset).is_some() => names.push(name),
                Ok(_) => {}
                Err(_) => self.collect(&name, names)?,
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

    /// Number of frames.
    ///
    /// # Errors
    /// [`PackError::Content`] where the attribute is absent.
    pub fn frames(&self) -> Result<u64> {
        let group = self.file.group(&self.root)?;
        self.file.attr(&group, "num_samples")
    }

    /// A whole array, by its path below the episode: `actions`, `camera_obs/fixed_rgb`, …
    ///
    /// # Errors
    /// [`PackError::Content`] where it is absent or not numeric, [`PackError::Damaged`] where a checksum fails.
    pub fn array(&self, name: &str) -> Result<Array> {
        let path = self.path_of(name);
        let dataset = self.file.dataset(&path)?;
        let any = vec![None; dataset.ndim()];
        match self.kind(&path, &dataset)? {
            Kind::U8 => self.whole(&path, &any, Values::U8),
            Kind::U16 => self.whole(&path, &any, Values::U16),
            Kind::F32 => self.whole(&path, &any, Values::F32),
            Kind::F64 => self.whole(&path, &any, Values::F64),
        }
    }

    /// One row along an array's first axis: frame `index`.
    ///
    /// # Errors
    /// As [`EpisodeReader::array`], and [`PackError::Content`] where there is no such frame.
    pub fn frame(&self, name: &str, index: usize) -> Result<Array> {
        let path = self.path_of(name);
        let dataset = self.file.dataset(&path)?;
        let frames = dataset.shape().first().copied().unwrap_or(0);
        if index >= frames {
            let expected = format!("a frame below {frames}");
            return Err(PackError::content(self.file.path(), path, expected, index.to_string()));
        }
        match self.kind(&path, &dataset)? {
            Kind::U8 => self.row(&path, &dataset, index, Values::U8),
            Kind::U16 => self.row(&path, &dataset, index, Values::U16),
            Kind::F32 => self.row(&path, &dataset, index, Values::F32),
            Kind::F64 => self.row(&path, &dataset, index, Values::F64),
        }
    }

    fn kind(&self, path: &str, dataset: &Dataset) -> Result<Kind> {
        kind_of(dataset).ok_or_else(|| {
            let expected = "u8, u16, f32 or f64 values";
            PackError::content(self.file.path(), path, expected, "another type")
        })
    }

    fn whole<T: H5Type>(
        &self,
        path: &str,
        shape: &[Option<usize>],
        wrap: impl Fn(Vec<T>) -> Values,
    ) -> Result<Array> {
        let (values, shape) = self.file.array::<T>(path, shape)?;
        Ok(Array { shape, values: wrap(values) })
    }

    fn row<T: H5Type>(
        &self,
        path: &str,
        dataset: &Dataset,
        index: usize,
        wrap: impl Fn(Vec<T>) -> Values,
    ) -> Result<Array> {
        let mut selection = vec![SliceOrIndex::from(index..index + 1)];
        selection.extend(dataset.shape()[1..].iter().map(|&length| SliceOrIndex::from(0..length)));
        let row = dataset
            .read_slice::<T, _, ndarray::IxDyn>(Hyperslab::from(selection))
            .map_err(|e| read_error(self.file.path(), path, &e))?;
        let shape = row.shape()[1..].to_vec();
        Ok(Array { shape, values: wrap(row.into_iter().collect()) })
    }
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
