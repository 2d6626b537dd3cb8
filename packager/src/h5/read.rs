//! Reading with every claim checked: types, shapes, and sizes against what the file can hold.

use std::path::{Path, PathBuf};

use hdf5::filters::Filter;
use hdf5::types::VarLenUnicode;
use hdf5::{Container, Dataset, File, H5Type, Location};

use super::{DEFLATE_MAX_RATIO, MAX_RATIO, read_error};
use crate::error::{PackError, Result};

/// An HDF5 file that may be damaged or hostile.
#[derive(Debug)]
pub(crate) struct H5Reader {
    file: File,
    path: PathBuf,
    file_bytes: u64,
}

impl H5Reader {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Self> {
        let metadata = std::fs::metadata(path).map_err(|e| PackError::read(path, e))?;
        std::fs::File::open(path).map_err(|e| PackError::read(path, e))?;
        if !metadata.is_file() {
            return Err(PackError::damaged(path, "expected an HDF5 file, got a folder or device"));
        }
        // Whole files are never written to. A lock would fail where the file system knows none, and where a
        // process that was started while the file was written still holds the writer's.
        let mut options = File::with_options();
        let file = options.with_fapl(|fapl| fapl.file_locking(false)).open(path).map_err(|e| {
            PackError::damaged(path, format!("not a whole HDF5 file: {}", super::message(&e)))
        })?;
        Ok(Self { file, path: path.to_path_buf(), file_bytes: metadata.len() })
    }

    /// The file's name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The root group.
    pub fn root(&self) -> &hdf5::Group {
        &self.file
    }

    /// A group by its absolute path.
    pub fn group(&self, name: &str) -> Result<hdf5::Group> {
        self.file
            .group(name)
            .map_err(|_| PackError::content(&self.path, name, "a group", "no such group"))
    }

    /// A dataset by its absolute path.
    pub fn dataset(&self, name: &str) -> Result<Dataset> {
        self.file
            .dataset(name)
            .map_err(|_| PackError::content(&self.path, name, "a dataset", "no such dataset"))
    }

    /// Values and shape of a dataset of exactly this type. `expected` gives each axis' length;
    /// `None` takes any.
    pub fn array<T: H5Type + bytemuck::Pod>(
        &self,
        name: &str,
        expected: &[Option<usize>],
    ) -> Result<(Vec<T>, Vec<usize>)> {
        let (dataset, shape) = self.checked::<T>(name, expected)?;
        let rows = shape.first().copied().unwrap_or(1);
        Ok((self.rows(name, &dataset, 0..rows)?, shape))
    }

    /// A dataset of exactly this type and shape, and its shape, which the file can hold.
    pub fn checked<T: H5Type>(
        &self,
        name: &str,
        expected: &[Option<usize>],
    ) -> Result<(Dataset, Vec<usize>)> {
        let dataset = self.dataset(name)?;
        let shape = self.checked_shape(name, &dataset, expected)?;
        self.check_type::<T>(name, &dataset)?;
        self.check_storage::<T>(name, &dataset, &shape)?;
        Ok((dataset, shape))
    }

    /// Texts of a one-dimensional dataset.
    pub fn strings(&self, name: &str, expected: usize) -> Result<Vec<String>> {
        let (dataset, shape) = self.checked::<VarLenUnicode>(name, &[Some(expected)])?;
        if shape.contains(&0) {
            return Ok(Vec::new());
        }
        let values: Vec<VarLenUnicode> =
            dataset.read_raw().map_err(|e| read_error(&self.path, name, &e))?;
        values.iter().map(|v| self.text(name, v)).collect()
    }

    /// An attribute that is one number.
    pub fn attr<T: H5Type>(&self, owner: &Location, name: &str) -> Result<T> {
        let (mut values, item) = self.attr_values::<T>(owner, name)?;
        let count = values.len();
        values.pop().filter(|_| count == 1).ok_or_else(|| {
            PackError::content(&self.path, item, "one value", format!("{count} values"))
        })
    }

    /// An attribute that is a list of numbers.
    pub fn attr_list<T: H5Type>(&self, owner: &Location, name: &str) -> Result<Vec<T>> {
        Ok(self.attr_values(owner, name)?.0)
    }

    /// A text attribute.
    pub fn attr_str(&self, owner: &Location, name: &str) -> Result<String> {
        self.text(name, &self.attr::<VarLenUnicode>(owner, name)?)
    }

    /// An attribute that is a list of texts.
    pub fn attr_strings(&self, owner: &Location, name: &str) -> Result<Vec<String>> {
        let values = self.attr_list::<VarLenUnicode>(owner, name)?;
        values.iter().map(|v| self.text(name, v)).collect()
    }

    /// An attribute that holds JSON.
    pub fn attr_json<T: serde::de::DeserializeOwned>(
        &self,
        owner: &Location,
        name: &str,
    ) -> Result<T> {
        serde_json::from_str(&self.attr_str(owner, name)?).map_err(|e| {
            let item = attr_item(owner, name);
            PackError::content(&self.path, item, "JSON of the documented form", e.to_string())
        })
    }

    fn attr_values<T: H5Type>(&self, owner: &Location, name: &str) -> Result<(Vec<T>, String)> {
        let item = attr_item(owner, name);
        let attr = owner.attr(name).map_err(|_| {
            PackError::content(&self.path, &item, "an attribute", "no such attribute")
        })?;
        self.check_type::<T>(&item, &attr)?;
        let shape = attr.get_shape().map_err(|e| read_error(&self.path, &item, &e))?;
        self.check_bytes::<T>(&item, &shape, self.file_bytes)?;
        if shape.contains(&0) {
            return Ok((Vec::new(), item));
        }
        let values = attr.read_raw().map_err(|e| read_error(&self.path, &item, &e))?;
        Ok((values, item))
    }

    fn checked_shape(
        &self,
        name: &str,
        dataset: &Dataset,
        expected: &[Option<usize>],
    ) -> Result<Vec<usize>> {
        let shape = dataset.get_shape().map_err(|e| read_error(&self.path, name, &e))?;
        let fits = shape.len() == expected.len()
            && shape.iter().zip(expected).all(|(&got, want)| want.is_none_or(|w| w == got));
        if fits {
            return Ok(shape);
        }
        let axes: Vec<String> =
            expected.iter().map(|axis| axis.map_or("any".into(), |n| n.to_string())).collect();
        Err(PackError::content(
            &self.path,
            name,
            format!("shape [{}]", axes.join(", ")),
            format!("shape {shape:?}"),
        ))
    }

    fn check_storage<T>(&self, name: &str, dataset: &Dataset, shape: &[usize]) -> Result<()> {
        let stored = dataset.storage_size().min(self.file_bytes);
        let ratio = match (dataset.is_chunked(), dataset.filters()) {
            (false, _) => 1,
            (true, filters) if filters.iter().any(|f| matches!(f, Filter::User(..))) => MAX_RATIO,
            (true, _) => DEFLATE_MAX_RATIO,
        };
        self.check_bytes::<T>(name, shape, stored.saturating_mul(ratio))
    }

    /// Refuses a shape that claims more than the file can hold, before memory is asked for.
    fn check_bytes<T>(&self, item: &str, shape: &[usize], limit: u64) -> Result<()> {
        let bytes = shape.iter().try_fold(size_of::<T>() as u64, |n, &d| n.checked_mul(d as u64));
        match bytes {
            Some(bytes) if bytes <= limit => Ok(()),
            _ => Err(PackError::content(
                &self.path,
                item,
                format!("at most the {limit} bytes that the file can hold of it"),
                format!("shape {shape:?} of {} bytes each", size_of::<T>()),
            )),
        }
    }

    fn check_type<T: H5Type>(&self, item: &str, container: &Container) -> Result<()> {
        let dtype = container.dtype().map_err(|e| read_error(&self.path, item, &e))?;
        if dtype.is::<T>() {
            return Ok(());
        }
        Err(PackError::content(
            &self.path,
            item,
            format!("type {}", T::type_descriptor()),
            dtype.to_descriptor().map_or("another type".into(), |t| format!("type {t}")),
        ))
    }

    fn text(&self, item: &str, value: &VarLenUnicode) -> Result<String> {
        // The library's own conversion trusts the file to hold UTF-8.
        match std::str::from_utf8(value.as_bytes()) {
            Ok(text) => Ok(text.to_owned()),
            Err(e) => Err(PackError::content(&self.path, item, "UTF-8 text", e.to_string())),
        }
    }
}

fn attr_item(owner: &Location, name: &str) -> String {
    format!("{} attribute {name}", owner.name())
}
