//! Damage is found, hostile files are refused, and nothing outside the dataset is touched.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking, too")]

#[path = "../examples/sample/mod.rs"]
mod sample;

use std::path::{Path, PathBuf};

use akrobat_model::events::Silent;
use akrobat_packager::dataset::repair::repair;
use akrobat_packager::dataset::{Container, DatasetReader, EpisodeReader};
use akrobat_packager::{DatasetWriter, PackError, validate};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use sample::config;

const CONTAINERS: [Container; 2] = [Container::Hdf5, Container::Mcap];

fn written(container: Container) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    sample::write(folder.path(), container, || {}).unwrap();
    folder
}

fn first_shard(folder: &Path) -> PathBuf {
    let mut shards: Vec<_> =
        std::fs::read_dir(folder.join("shards")).unwrap().map(|e| e.unwrap().path()).collect();
    shards.sort();
    shards.swap_remove(0)
}

/// True where validation says that something is wrong, in whichever way.
fn is_found(folder: &Path) -> bool {
    validate(folder, &Silent).map_or(true, |report| !report.problems.is_empty())
}

#[test]
fn a_flipped_bit_anywhere_is_found() {
    for container in CONTAINERS {
        let folder = written(container);
        assert!(!is_found(folder.path()), "the negative control");
        let shard = first_shard(folder.path());
        for file in
            [shard, folder.path().join("manifest.jsonl"), folder.path().join("dataset.json")]
        {
            let whole = std::fs::read(&file).unwrap();
            let step = (whole.len() / 40).max(1) | 1;
            for place in (0..whole.len()).step_by(step) {
                let mut damaged = whole.clone();
                damaged[place] ^= 1 << (place % 8);
                std::fs::write(&file, damaged).unwrap();
                assert!(is_found(folder.path()), "{} byte {place}", file.display());
            }
            std::fs::write(&file, &whole).unwrap();
        }
        assert!(!is_found(folder.path()), "all is as it was");
    }
}

#[test]
fn truncated_and_missing_files_are_found() {
    for container in CONTAINERS {
        let folder = written(container);
        let shard = first_shard(folder.path());
        let whole = std::fs::read(&shard).unwrap();
        for length in [0, 1, 8, 100, whole.len() / 2, whole.len() - 1] {
            std::fs::write(&shard, &whole[..length]).unwrap();
            assert!(is_found(folder.path()), "{container:?} {length}");
        }
        std::fs::remove_file(&shard).unwrap();
        assert!(is_found(folder.path()));
    }
}

#[test]
fn one_writer_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let first = DatasetWriter::create(folder.path(), config(Container::Hdf5)).unwrap();
    for error in [
        DatasetWriter::resume(folder.path(), config(Container::Hdf5)).unwrap_err(),
        repair(folder.path(), &Silent).map(|_| ()).unwrap_err(),
    ] {
        assert!(matches!(error, PackError::Unwritable { .. }), "{error}");
        assert!(error.to_string().contains("another process"), "{error}");
    }
    first.close().unwrap();
    DatasetWriter::resume(folder.path(), config(Container::Hdf5)).unwrap();
}

/// Rewrites the manifest's place of every episode.
fn with_shard(folder: &Path, shard: &str) {
    let manifest = folder.join("manifest.jsonl");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let shards =
        ["shards/shard_000000.hdf5", "shards/shard_000001.hdf5", "shards/shard_000002.hdf5"];
    let text = shards.iter().fold(text, |text, name| text.replace(name, shard));
    std::fs::write(&manifest, text).unwrap();
}

#[test]
fn manifests_that_lead_out_of_the_folder_are_refused() {
    let hostile =
        ["../outside", "/etc/passwd", "shards/../../outside", "shards/", "shards/.x", "x/y"];
    for shard in hostile {
        let folder = written(Container::Hdf5);
        with_shard(folder.path(), shard);
        let error = DatasetReader::open(folder.path()).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("line 1"), "{error}");
        assert!(DatasetWriter::resume(folder.path(), config(Container::Hdf5)).is_err());
    }
}

#[cfg(unix)]
#[test]
fn symbolic_links_are_not_followed() {
    let outside = tempfile::tempdir().unwrap();
    let precious = outside.path().join("shard_000000.hdf5.partial");
    std::fs::write(&precious, b"precious").unwrap();

    // A shard that is a link is not read.
    let folder = written(Container::Hdf5);
    let shard = first_shard(folder.path());
    let moved = outside.path().join("shard.hdf5");
    std::fs::rename(&shard, &moved).unwrap();
    std::os::unix::fs::symlink(&moved, &shard).unwrap();
    let report = validate(folder.path(), &Silent).unwrap();
    assert!(report.problems.iter().any(|p| p.message.contains("symbolic link")), "{report:?}");

    // Nothing is written or deleted through a linked folder.
    let folder = written(Container::Hdf5);
    std::fs::remove_dir_all(folder.path().join("shards")).unwrap();
    std::os::unix::fs::symlink(outside.path(), folder.path().join("shards")).unwrap();
    assert!(DatasetWriter::resume(folder.path(), config(Container::Hdf5)).is_err());
    assert!(repair(folder.path(), &Silent).is_err());
    assert_eq!(std::fs::read(&precious).unwrap(), b"precious");
    assert!(moved.is_file());
}

/// An HDF5 file whose datasets claim far more than the file holds.
fn write_bomb(path: &Path) {
    let file = hdf5::File::create(path).unwrap();
    file.new_attr::<hdf5::types::VarLenUnicode>().create("format").unwrap();
    let text: hdf5::types::VarLenUnicode = "akrobat.shard".parse().unwrap();
    file.attr("format").unwrap().write_scalar(&text).unwrap();
    file.new_attr::<u32>().create("format_version").unwrap().write_scalar(&1u32).unwrap();
    let episode = file.create_group("data").unwrap().create_group("demo_0").unwrap();
    for (name, rows, columns) in [("claims", 1 << 40, 1024), ("wide", 4, 1 << 29)] {
        let claims = episode.new_dataset::<f32>().chunk((1, columns)).deflate(4);
        claims.shape((rows, columns)).create(name).unwrap();
    }
}

#[test]
fn claimed_sizes_do_not_become_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.hdf5");
    write_bomb(&path);
    let episode = EpisodeReader::open(&path, "demo_0").unwrap();
    for name in ["claims", "wide"] {
        let error = episode.array(name).unwrap_err();
        assert!(matches!(error, PackError::Content { .. }), "{name}: {error}");
        assert!(episode.frame(name, 0).is_err(), "{name}");
    }
}

/// MCAP records with lengths that lead nowhere.
#[test]
fn hostile_lengths_in_logs_are_refused() {
    let folder = written(Container::Mcap);
    let log = first_shard(folder.path());
    let whole = std::fs::read(&log).unwrap();
    // Behind the magic bytes stands the header record: its kind, then its length.
    for length in [u64::MAX, 1 << 40, 1 << 62, 0] {
        let mut damaged = whole.clone();
        damaged[9..17].copy_from_slice(&length.to_le_bytes());
        std::fs::write(&log, damaged).unwrap();
        let report = validate(folder.path(), &Silent).unwrap();
        let place = log.file_name().unwrap().to_string_lossy().into_owned();
        let about = report.problems.iter().filter(|p| p.place.contains(&place)).count();
        assert!(about >= 2, "the checksum and the content: {report:?}");
    }
}

/// Readers survive any bytes: they report or read, within bounds, and never panic.
#[test]
fn mutated_files_are_read_or_refused() {
    for container in CONTAINERS {
        let folder = written(container);
        let files = [
            first_shard(folder.path()),
            folder.path().join("manifest.jsonl"),
            folder.path().join("dataset.json"),
        ];
        for file in files {
            let whole = std::fs::read(&file).unwrap();
            let cases = Config { cases: 48, failure_persistence: None, ..Config::default() };
            let mutations = (
                prop::collection::vec(
                    (any::<prop::sample::Index>(), any::<[u8; 8]>(), 1..9usize),
                    1..6,
                ),
                prop::option::weighted(0.2, any::<prop::sample::Index>()),
            );
            let mut runner = TestRunner::new(cases);
            let outcome = runner.run(&mutations, |(writes, cut)| {
                let mut bytes = whole.clone();
                for (place, noise, count) in &writes {
                    let first = place.index(bytes.len());
                    let end = (first + count).min(bytes.len());
                    bytes[first..end].copy_from_slice(&noise[..end - first]);
                }
                bytes.truncate(cut.map_or(bytes.len(), |cut| cut.index(bytes.len())));
                let changed = bytes != whole;
                std::fs::write(&file, bytes).unwrap();
                prop_assert!(is_found(folder.path()) || !changed, "a change went unnoticed");
                Ok(())
            });
            outcome.unwrap();
            std::fs::write(&file, &whole).unwrap();
        }
    }
}
