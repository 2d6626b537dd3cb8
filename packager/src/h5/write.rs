//! Writing attributes, arrays and strings.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use hdf5::file::{FileCloseDegree, LibraryVersion};
use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, File, Group, H5Type, Location};

use super::{DIGEST_ATTRIBUTE, H5Reader, digest, write_error};
use crate::codec::Compression;
use crate::error::{PackError, Result};
use crate::whole_file::PartialFile;

/// Values of a chunk that holds many short rows.
const CHUNK_VALUES: usize = 1 << 16;

/// An HDF5 file being written under its temporary name.
#[derive(Debug)]
pub(crate) struct H5Writer {
    file: File,
    partial: PartialFile,
}

impl H5Writer {
    /// Starts the file that will be `path`.
    pub fn create(path: &Path) -> Result<Self> {
        crate::codec::register();
        let partial = PartialFile::create(path)?;
        let file = File::with_options()
            .with_fapl(|fapl| {
                // Format 1.10 is the oldest whose metadata is checksummed throughout.
                fapl.libver_bounds(LibraryVersion::V110, LibraryVersion::V110)
                    .fclose_degree(FileCloseDegree::Strong)
                    // Nobody else knows the file's temporary name.
                    .file_locking(false)
            })
            .with_fcpl(|fcpl| fcpl.obj_track_times(false))
            .create(partial.path())
            .map_err(|e| write_error(path, "/", &e))?;
        Ok(Self { file, partial })
    }

    /// The final name, for messages.
    pub fn path(&self) -> &Path {
        self.partial.final_path()
    }

    /// The root group.
    pub fn root(&self) -> GroupWriter {
        GroupWriter { group: (*self.file).clone(), path: self.path().to_path_buf() }
    }

    /// Bytes in the file so far.
    pub fn size(&self) -> u64 {
        self.file.size()
    }

    /// Hands everything written so far to the system.
    pub fn flush(&self) -> Result<()> {
        self.file.flush().map_err(|e| write_error(self.path(), "/", &e))
    }

    /// Adds the checksum of everything in the file to the root's attributes.
    pub fn seal(&self) -> Result<()> {
        self.flush()?;
        let sha256 =
            digest(&self.file).map_err(|e| write_error(self.path(), DIGEST_ATTRIBUTE, &e))?;
        self.root().attr_str(DIGEST_ATTRIBUTE, &sha256)
    }

    /// Closes the file and gives it its final name.
    pub fn finish(self) -> Result<()> {
        self.flush()?;
        let path = self.path().to_path_buf();
        self.file.close().map_err(|e| write_error(&path, "/", &e))?;
        self.partial.commit()
    }
}

/// A group being filled.
#[derive(Debug, Clone)]
pub(crate) struct GroupWriter {
    group: Group,
    path: PathBuf,
}

impl GroupWriter {
    fn item(&self, name: &str) -> String {
        format!("{}/{name}", self.group.name().trim_end_matches('/'))
    }

    fn error<'a>(&'a self, name: &'a str) -> impl Fn(hdf5::Error) -> PackError + 'a {
        move |e| write_error(&self.path, &self.item(name), &e)
    }

    /// A new group below this one.
    pub fn group(&self, name: &str) -> Result<Self> {
        let builder = self.group.create_group_builder().obj_track_times(false);
        let group = builder.create(name).map_err(self.error(name))?;
        Ok(Self { group, path: self.path.clone() })
    }

    /// A group that was made before.
    pub fn existing(&self, name: &str) -> Result<Self> {
        let group = self.group.group(name).map_err(self.error(name))?;
        Ok(Self { group, path: self.path.clone() })
    }

    /// A second name, `name` below this group, for the object at the absolute path `target`.
    pub fn link(&self, target: &str, name: &str) -> Result<()> {
        self.group.link_hard(target, name).map_err(self.error(name))
    }

    /// An empty dataset of `shape` with chunks of `chunk`, to be filled later.
    pub fn chunked<T: H5Type>(
        &self,
        name: &str,
        shape: &[usize],
        chunk: &[usize],
        compression: Compression,
    ) -> Result<Dataset> {
        let chunk_bytes = chunk.iter().product::<usize>() * size_of::<T>();
        let filters = compression.filters(size_of::<T>(), chunk_bytes);
        let builder = self.group.new_dataset_builder().obj_track_times(false);
        let builder = builder.chunk(chunk.to_vec()).set_filters(&filters);
        builder.empty::<T>().shape(shape.to_vec()).create(name).map_err(self.error(name))
    }

    /// An empty list of bytes that grows by whole chunks of `chunk` bytes, with checksums.
    pub fn growing_bytes(&self, name: &str, chunk: usize) -> Result<Dataset> {
        let builder = self.group.new_dataset_builder().obj_track_times(false).chunk((chunk,));
        builder
            .fletcher32()
            .empty::<u8>()
            .shape(hdf5::SimpleExtents::resizable([0usize]))
            .create(name)
            .map_err(self.error(name))
    }

    /// Copies an object with everything below it, as it is stored, to `name` below this group.
    pub fn copy_from(&self, source: &H5Reader, object: &str, name: &str) -> Result<()> {
        let error = self.error(name);
        let text = |text: &str| std::ffi::CString::new(text).map_err(|e| e.to_string().into());
        let (from, to) = text(object).and_then(|from| Ok((from, text(name)?))).map_err(&error)?;
        let copied = hdf5::sync::sync(|| {
            // SAFETY: both places are open, and the names are NUL-terminated and outlive the call.
            let status = unsafe {
                hdf5_sys::h5o::H5Ocopy(
                    source.root().id(),
                    from.as_ptr(),
                    self.group.id(),
                    to.as_ptr(),
                    hdf5_sys::h5p::H5P_DEFAULT,
                    hdf5_sys::h5p::H5P_DEFAULT,
                )
            };
            if status < 0 { Err(hdf5::Error::query()?) } else { Ok(()) }
        });
        copied.map_err(error)
    }

    /// Removes what was made below this group.
    pub fn remove(&self, name: &str) -> Result<()> {
        self.group.unlink(name).map_err(self.error(name))
    }

    /// A whole array, chunked along its first axis.
    pub fn array<T: H5Type>(&self, name: &str, shape: &[usize], values: &[T]) -> Result<Dataset> {
        let count = shape.iter().product::<usize>();
        if count != values.len() {
            let got = values.len().to_string();
            return Err(PackError::inconsistent(
                &self.path,
                self.item(name),
                format!("{count} values for shape {shape:?}"),
                got,
            ));
        }
        if values.is_empty() {
            return self.unfiltered::<T>(name, shape);
        }
        let row = count / shape[0];
        let mut chunk = shape.to_vec();
        chunk[0] = (CHUNK_VALUES / row).clamp(1, shape[0]);
        let dataset = self.chunked::<T>(name, shape, &chunk, Compression::PORTABLE)?;
        dataset.write_raw(values).map_err(self.error(name))?;
        Ok(dataset)
    }

    /// Strings of any length; they carry no checksum, as HDF5 has none for them.
    pub fn strings<S: AsRef<str>>(&self, name: &str, values: &[S]) -> Result<Dataset> {
        let values =
            values.iter().map(|v| self.string(name, v.as_ref())).collect::<Result<Vec<_>>>()?;
        let dataset = self.unfiltered::<VarLenUnicode>(name, &[values.len()])?;
        if !values.is_empty() {
            dataset.write_raw(&values).map_err(self.error(name))?;
        }
        Ok(dataset)
    }

    fn unfiltered<T: H5Type>(&self, name: &str, shape: &[usize]) -> Result<Dataset> {
        let builder = self.group.new_dataset_builder().obj_track_times(false).no_chunk();
        builder.empty::<T>().shape(shape.to_vec()).create(name).map_err(self.error(name))
    }

    fn string(&self, name: &str, value: &str) -> Result<VarLenUnicode> {
        VarLenUnicode::from_str(value).map_err(|_| {
            PackError::inconsistent(&self.path, self.item(name), "text without NUL", "NUL in text")
        })
    }

    /// A text attribute of the group.
    pub fn attr_str(&self, name: &str, value: &str) -> Result<()> {
        self.attr_value(&self.group, name, &self.string(name, value)?)
    }

    /// An attribute of the group that is one number.
    pub fn attr<T: H5Type>(&self, name: &str, value: T) -> Result<()> {
        self.attr_value(&self.group, name, &value)
    }

    /// An attribute of the group that is a list of numbers.
    pub fn attr_list<T: H5Type>(&self, name: &str, values: &[T]) -> Result<()> {
        let builder = self.group.new_attr::<T>().shape([values.len()]);
        let attr = builder.create(name).map_err(self.error(name))?;
        if values.is_empty() {
            return Ok(());
        }
        attr.write_raw(values).map_err(self.error(name))
    }

    /// An attribute of the group that is a list of texts.
    pub fn attr_strings<S: AsRef<str>>(&self, name: &str, values: &[S]) -> Result<()> {
        let values =
            values.iter().map(|v| self.string(name, v.as_ref())).collect::<Result<Vec<_>>>()?;
        self.attr_list(name, &values)
    }

    /// A text attribute of one of the group's datasets.
    pub fn dataset_attr_str(&self, dataset: &Dataset, name: &str, value: &str) -> Result<()> {
        self.attr_value(dataset, name, &self.string(name, value)?)
    }

    /// An attribute of one of the group's datasets that is one number.
    pub fn dataset_attr<T: H5Type>(&self, dataset: &Dataset, name: &str, value: T) -> Result<()> {
        self.attr_value(dataset, name, &value)
    }

    /// An attribute of one of the group's datasets that is a list of numbers.
    pub fn dataset_attr_list<T: H5Type>(
        &self,
        dataset: &Dataset,
        name: &str,
        values: &[T],
    ) -> Result<()> {
        let attr = dataset.new_attr::<T>().shape([values.len()]).create(name);
        let attr = attr.map_err(self.error(name))?;
        match values {
            [] => Ok(()),
            values => attr.write_raw(values).map_err(self.error(name)),
        }
    }

    fn attr_value<T: H5Type>(&self, owner: &Location, name: &str, value: &T) -> Result<()> {
        let attr = owner.new_attr::<T>().create(name).map_err(self.error(name))?;
        attr.write_scalar(value).map_err(self.error(name))
    }
}
