//! A checksum of everything that a file says, texts included, which HDF5 itself does not protect.

use hdf5::types::{FloatSize, IntSize, TypeDescriptor, VarLenUnicode};
use hdf5::{Container, Group};
use sha2::{Digest, Sha256};

/// Root attribute that holds the digest, and is no part of it.
pub(crate) const DIGEST_ATTRIBUTE: &str = "content_sha256";

/// Lower-case hexadecimal SHA-256 over names, shapes, values and attributes of all groups and datasets, in
/// the order of their names.
pub(crate) fn digest(root: &Group) -> hdf5::Result<String> {
    let mut hash = Sha256::new();
    add_group(&mut hash, root)?;
    Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

fn add_group(hash: &mut Sha256, group: &Group) -> hdf5::Result<()> {
    add_attributes(hash, group)?;
    let mut names = group.member_names()?;
    names.sort();
    for name in names {
        add_bytes(hash, name.as_bytes());
        match group.dataset(&name) {
            Ok(dataset) => {
                add_attributes(hash, &dataset)?;
                add_values(hash, &dataset)?;
            }
            Err(_) => add_group(hash, &group.group(&name)?)?,
        }
    }
    Ok(())
}

fn add_attributes(hash: &mut Sha256, owner: &hdf5::Location) -> hdf5::Result<()> {
    let mut names = owner.attr_names()?;
    names.sort();
    for name in names.iter().filter(|name| *name != DIGEST_ATTRIBUTE) {
        add_bytes(hash, name.as_bytes());
        add_values(hash, &*owner.attr(name)?)?;
    }
    Ok(())
}

fn add_values(hash: &mut Sha256, container: &Container) -> hdf5::Result<()> {
    use TypeDescriptor as Type;
    let shape: Vec<u8> = container.shape().iter().flat_map(|&d| (d as u64).to_le_bytes()).collect();
    add_bytes(hash, &shape);
    if container.shape().contains(&0) {
        return Ok(());
    }
    match container.dtype()?.to_descriptor()? {
        Type::VarLenUnicode => {
            for text in container.read_raw::<VarLenUnicode>()? {
                add_bytes(hash, text.as_bytes());
            }
        }
        Type::Boolean => add_each(hash, &container.read_raw::<bool>()?, |v| [u8::from(v)]),
        Type::Unsigned(IntSize::U1) => add_each(hash, &container.read_raw()?, u8::to_le_bytes),
        Type::Unsigned(IntSize::U4) => add_each(hash, &container.read_raw()?, u32::to_le_bytes),
        Type::Unsigned(IntSize::U8) => add_each(hash, &container.read_raw()?, u64::to_le_bytes),
        Type::Float(FloatSize::U4) => add_each(hash, &container.read_raw()?, f32::to_le_bytes),
        Type::Float(FloatSize::U8) => add_each(hash, &container.read_raw()?, f64::to_le_bytes),
        other => {
            return Err(format!("{}: type {other} is not written here", container.name()).into());
        }
    }
    Ok(())
}

/// Prefixed with the length, so that neighbours cannot run into each other.
fn add_bytes(hash: &mut Sha256, bytes: &[u8]) {
    hash.update((bytes.len() as u64).to_le_bytes());
    hash.update(bytes);
}

fn add_each<T: Copy, const N: usize>(hash: &mut Sha256, values: &[T], bytes: fn(T) -> [u8; N]) {
    values.iter().for_each(|&value| hash.update(bytes(value)));
}
