//! Subsets, unions, parts and repaired datasets hold the same episodes as what they were made of.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking, too")]

mod common;
#[path = "../examples/sample/mod.rs"]
mod sample;

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use akrobat_model::events::Silent;
use akrobat_packager::dataset::repair::repair;
use akrobat_packager::dataset::select::{Selection, filter, merge};
use akrobat_packager::dataset::split::{SplitBy, SplitConfig, split};
use akrobat_packager::dataset::summary::summarize;
use akrobat_packager::dataset::{Array, Container, Status, Values, publish_parts};
use akrobat_packager::{
    Codec, ColorEncoding, DatasetReader, DatasetWriter, DepthEncoding, StorageConfig,
};
use common::{files, problems, written};
use sample::{EPISODES, FRAMES, config, info, observation};

const CONTAINERS: [Container; 2] = [Container::Hdf5, Container::Mcap];

/// All arrays of an episode.
fn arrays(dataset: &DatasetReader, id: &str) -> BTreeMap<String, Array> {
    let (_, stored) = dataset.episodes().find(|(known, _)| *known == id).unwrap();
    let episode = dataset.episode(stored).unwrap();
    let names = episode.array_names().unwrap();
    names.into_iter().map(|name| (name.clone(), episode.array(&name).unwrap())).collect()
}

#[test]
fn every_codec_and_encoding_stores_the_same_images() {
    let plain = written(Container::Hdf5);
    let expected = arrays(&DatasetReader::open(plain.path()).unwrap(), "episode-0000");
    let cases = [
        (Codec::Lz4, None, ColorEncoding::Native),
        (Codec::Zstd, Some(9), ColorEncoding::Native),
        (Codec::Blosc, None, ColorEncoding::Native),
        (Codec::Gzip, Some(1), ColorEncoding::Png),
    ];
    for (codec, codec_level, color) in cases {
        let folder = tempfile::tempdir().unwrap();
        let storage = StorageConfig { codec, codec_level, color, ..StorageConfig::default() };
        write_one(folder.path(), storage);
        assert_eq!(problems(folder.path()), "", "{codec:?} {color:?}");
        let dataset = DatasetReader::open(folder.path()).unwrap();
        let found = arrays(&dataset, "episode-0000");
        for (name, array) in &expected {
            // Files are linked under `obs/`, too; there, the name is the same.
            assert_eq!(found.get(name), Some(array), "{codec:?} {color:?} {name}");
        }
        let (_, stored) = dataset.episodes().next().unwrap();
        let frame = dataset.episode(stored).unwrap().frame("camera_obs/wrist_rgb", 7).unwrap();
        assert_eq!(frame.shape, [24, 32, 3]);
    }
}

fn write_one(folder: &Path, storage: StorageConfig) {
    let config = akrobat_packager::DatasetConfig { storage, ..config(Container::Hdf5) };
    let mut writer = DatasetWriter::create(folder, config).unwrap();
    writer.begin_episode(info(0)).unwrap();
    (0..FRAMES).for_each(|frame| writer.push(observation(0, frame)).unwrap());
    writer.finish_episode().unwrap();
    writer.close().unwrap();
}

#[test]
fn impossible_storage_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let storage = StorageConfig { codec_level: Some(11), ..StorageConfig::default() };
    let config = akrobat_packager::DatasetConfig { storage, ..config(Container::Hdf5) };
    let error = DatasetWriter::create(folder.path(), config).unwrap_err();
    assert!(error.to_string().contains("gzip has levels 1 to 9"), "{error}");
}

#[test]
fn depth_in_metres_is_exact() {
    let folder = tempfile::tempdir().unwrap();
    write_one(
        folder.path(),
        StorageConfig { depth: DepthEncoding::Metres, ..StorageConfig::default() },
    );
    assert_eq!(problems(folder.path()), "");
}

#[test]
fn large_shards_are_closed_early() {
    let folder = tempfile::tempdir().unwrap();
    let storage = StorageConfig { shard_bytes: Some(1), ..StorageConfig::default() };
    let config = akrobat_packager::DatasetConfig { storage, ..config(Container::Hdf5) };
    let mut writer = DatasetWriter::create(folder.path(), config).unwrap();
    for index in 0..2 {
        writer.begin_episode(info(index)).unwrap();
        (0..FRAMES).for_each(|frame| writer.push(observation(index, frame)).unwrap());
        writer.finish_episode().unwrap();
    }
    writer.close().unwrap();
    assert!(folder.path().join("shards/shard_000001.hdf5").is_file());
    assert_eq!(problems(folder.path()), "");
}

#[test]
fn quarantined_episodes_leave_their_place_empty() {
    for container in CONTAINERS {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = DatasetWriter::create(folder.path(), config(container)).unwrap();
        for index in 0..EPISODES {
            writer.begin_episode(info(index)).unwrap();
            let frames = if index == 1 { 3 } else { FRAMES };
            (0..frames).for_each(|frame| writer.push(observation(index, frame)).unwrap());
            if index == 1 {
                writer.quarantine_episode("frame 3: camera fixed is black").unwrap();
            } else {
                writer.finish_episode().unwrap();
            }
        }
        writer.close().unwrap();
        assert_eq!(problems(folder.path()), "");
        let dataset = DatasetReader::open(folder.path()).unwrap();
        let line = &dataset.entries()[1];
        assert_eq!((line.status, line.stored.is_none()), (Status::Quarantined, true));
        // The third episode begins the second shard, as it would have with the second one whole.
        let third = dataset.entries()[2].stored.as_ref().unwrap();
        let expected = match container {
            Container::Hdf5 => "shards/shard_000001.hdf5",
            Container::Mcap => "shards/episode_000002.mcap",
        };
        assert_eq!(third.shard, expected);
    }
}

#[test]
fn parts_make_the_same_bytes_as_one_run() {
    for container in CONTAINERS {
        let expected = files(written(container).path());
        let folder = tempfile::tempdir().unwrap();
        let parts: Vec<_> =
            (0..3u32).map(|part| folder.path().join(format!("part{part}"))).collect();
        let per_part = |part: u32| 2 * part..(2 * part + 2).min(EPISODES);
        let shards_before = |part: u32| if container == Container::Hdf5 { part } else { 2 * part };
        // In no particular order.
        for part in [2, 0, 1] {
            let place = &parts[part as usize];
            let mut writer =
                DatasetWriter::create_part(place, config(container), shards_before(part)).unwrap();
            for index in per_part(part) {
                if index == 3 {
                    let reason = "position_limit: joint arm";
                    writer.skip_episode("refused", Status::Filtered, reason).unwrap();
                }
                writer.begin_episode(info(index)).unwrap();
                (0..FRAMES).for_each(|frame| writer.push(observation(index, frame)).unwrap());
                writer.finish_episode().unwrap();
            }
            writer.close().unwrap();
        }
        let output = folder.path().join("dataset");
        std::fs::create_dir(&output).unwrap();
        publish_parts(&output, config(container), &parts).unwrap();
        assert!(files(&output) == expected, "{container:?}");
        // Once more, as after an interruption.
        publish_parts(&output, config(container), &parts).unwrap();
        assert!(files(&output) == expected, "{container:?} again");
    }
}

#[test]
fn filtered_datasets_hold_what_was_asked_for() {
    for container in CONTAINERS {
        let source = written(container);
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("few");
        let selection = Selection { count: Some(3), ..Selection::default() };
        let taken = filter(source.path(), &output, &selection).unwrap();
        assert_eq!((taken.episodes, taken.of, taken.unique_starts), (3, EPISODES as usize, 3));
        assert_eq!(problems(&output), "", "{container:?}");
        if container == Container::Hdf5 {
            let (before, after) = (
                DatasetReader::open(source.path()).unwrap(),
                DatasetReader::open(&output).unwrap(),
            );
            assert_eq!(arrays(&before, "episode-0002"), arrays(&after, "episode-0002"));
            assert_ne!(arrays(&before, "episode-0001"), arrays(&after, "episode-0002"));
        }
        let unknown = Selection { objects: vec!["oven".into()], ..Selection::default() };
        let message = filter(source.path(), &folder.path().join("none"), &unknown).unwrap_err();
        assert!(message.to_string().contains("one of: ball, got oven"), "{message}");
    }
}

/// Episodes that start in the states given by `starts`, a state for each letter.
fn starting_in(folder: &Path, starts: &str) {
    let mut writer = DatasetWriter::create(folder, config(Container::Hdf5)).unwrap();
    for (index, start) in (0..).zip(starts.bytes()) {
        writer.begin_episode(info(index)).unwrap();
        for frame in 0..FRAMES {
            let mut seen = observation(0, frame);
            seen.robot[0] = f64::from(start);
            writer.push(seen).unwrap();
        }
        writer.finish_episode().unwrap();
    }
    writer.close().unwrap();
}

#[test]
fn unique_starts_are_as_many_as_can_be() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("source");
    starting_in(&source, "aaabbc");
    let unique = |count, maximise_unique_starts| {
        let output = folder.path().join(format!("{count}{maximise_unique_starts}"));
        let selection =
            Selection { count: Some(count), maximise_unique_starts, ..Selection::default() };
        let taken = filter(&source, &output, &selection).unwrap();
        assert_eq!((taken.episodes, taken.unique_starts_available), (count, 3));
        taken.unique_starts
    };
    assert_eq!([1, 2, 3, 4].map(|count| unique(count, true)), [1, 2, 3, 3]);
    assert_eq!(unique(3, false), 1, "the first three start alike");
}

#[test]
fn merged_datasets_hold_all_and_refuse_doubles() {
    for container in CONTAINERS {
        let source = written(container);
        let folder = tempfile::tempdir().unwrap();
        let take = |count: usize, name: &str| {
            let output = folder.path().join(name);
            let selection = Selection { count: Some(count), ..Selection::default() };
            filter(source.path(), &output, &selection).unwrap();
            output
        };
        let (two, all) = (take(2, "two"), take(EPISODES as usize, "all"));
        let sources = [two, all];
        let error = merge(&sources, &folder.path().join("refused"), false).unwrap_err();
        assert!(error.to_string().contains("episode-0000"), "{error}");
        let output = folder.path().join("merged");
        let merged = merge(&sources, &output, true).unwrap();
        assert_eq!((merged.episodes, merged.duplicates), (EPISODES as usize, 2));
        assert_eq!(problems(&output), "", "{container:?}");
    }
}

#[test]
fn parts_for_evaluation_start_in_states_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let dataset = folder.path().join("dataset");
    starting_in(&dataset, "aabbccddeeffgghhiijj");
    let deal =
        SplitConfig { by: SplitBy::StartState, fractions: [0.6, 0.2, 0.2], seen: 0.1, seed: 3 };
    let counts = split(&dataset, &deal).unwrap();
    let expected = [("test", 4), ("test_seen", 2), ("train", 10), ("valid", 4)];
    assert_eq!(counts, expected.map(|(part, count)| (part.to_owned(), count)).into());
    assert_eq!(problems(&dataset), "");
    let starts_of = |part: &str| -> HashSet<String> {
        let dataset = DatasetReader::open(&dataset).unwrap();
        let of_part = dataset.entries().iter().filter(|e| e.split.as_deref() == Some(part));
        of_part.map(|entry| entry.stored.as_ref().unwrap().start_state.clone()).collect()
    };
    assert!(starts_of("train").is_disjoint(&starts_of("valid")));
    assert!(starts_of("train").is_disjoint(&starts_of("test")));
    assert!(starts_of("train").is_superset(&starts_of("test_seen")), "seen means seen");

    let manifest = || std::fs::read(dataset.join("manifest.jsonl")).unwrap();
    let before = manifest();
    split(&dataset, &deal).unwrap();
    assert!(manifest() == before, "the same seed deals alike");
    split(&dataset, &SplitConfig { seed: 4, ..deal.clone() }).unwrap();
    assert!(manifest() != before, "another seed deals otherwise");
    let wrong = SplitConfig { fractions: [0.9, 0.2, 0.1], ..deal };
    assert_eq!(split(&dataset, &wrong).unwrap_err().exit_code(), 2);
}

#[test]
fn a_lost_index_is_rebuilt_to_the_same_bytes() {
    for container in CONTAINERS {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = DatasetWriter::create(folder.path(), config(container)).unwrap();
        for index in 0..EPISODES {
            writer.begin_episode(info(index)).unwrap();
            (0..FRAMES).for_each(|frame| writer.push(observation(index, frame)).unwrap());
            writer.finish_episode().unwrap();
        }
        writer.close().unwrap();
        let expected = files(folder.path());
        std::fs::remove_file(folder.path().join("manifest.jsonl")).unwrap();
        std::fs::remove_file(folder.path().join("dataset.json")).unwrap();
        std::fs::write(folder.path().join("shards/left.partial"), b"half").unwrap();
        let repaired = repair(folder.path(), &Silent).unwrap();
        assert_eq!((repaired.episodes, repaired.lost.len()), (EPISODES as usize, 0));
        assert!(files(folder.path()) == expected, "{container:?}");
    }
}

#[test]
fn damaged_shards_are_set_aside_and_named() {
    for container in CONTAINERS {
        let folder = written(container);
        let shard = folder.path().join(match container {
            Container::Hdf5 => "shards/shard_000000.hdf5",
            Container::Mcap => "shards/episode_000000.mcap",
        });
        let bytes = std::fs::read(&shard).unwrap();
        std::fs::write(&shard, &bytes[..bytes.len() * 2 / 3]).unwrap();
        let repaired = repair(folder.path(), &Silent).unwrap();
        let gone = if container == Container::Hdf5 { 2 } else { 1 };
        assert_eq!(repaired.episodes, EPISODES as usize - gone);
        assert_eq!(
            repaired.lost.len(),
            gone + 1,
            "the shard and its episodes: {:?}",
            repaired.lost
        );
        assert_eq!(problems(folder.path()), "", "what is left is whole");
        assert!(folder.path().join("damaged").join(shard.file_name().unwrap()).is_file());
        // What was lost is written again by the same command, and nothing that is there is touched.
        sample::write(folder.path(), container, || {}).unwrap();
        assert_eq!(problems(folder.path()), "");
        let dataset = DatasetReader::open(folder.path()).unwrap();
        assert_eq!(dataset.episodes().count(), EPISODES as usize);
    }
}

#[test]
fn summaries_count_and_measure() {
    let folder = written(Container::Hdf5);
    let summary = summarize(folder.path()).unwrap();
    assert!(summary.complete);
    assert_eq!(summary.episodes, u64::from(EPISODES));
    assert_eq!(summary.filtered, 1);
    assert_eq!(summary.reasons["position_limit: joint arm"], 1);
    assert_eq!(summary.frames, u64::from(EPISODES * FRAMES));
    let shards = files(folder.path());
    let bytes = shards.iter().filter(|(name, _)| name.starts_with("shards/"));
    assert_eq!(summary.bytes, bytes.map(|(_, content)| content.len() as u64).sum::<u64>());

    // What is said of an array is what reading it gives.
    let dataset = DatasetReader::open(folder.path()).unwrap();
    let all: Vec<_> = dataset.episodes().map(|(id, _)| arrays(&dataset, id)).collect();
    let rgb = &summary.arrays["camera_obs/fixed_rgb"];
    assert_eq!((rgb.element.as_str(), rgb.rows), ("uint8", summary.frames));
    let elements: usize =
        all.iter().map(|a| a["camera_obs/fixed_rgb"].shape.iter().product::<usize>()).sum();
    assert_eq!(rgb.raw_bytes, elements as u64);
    assert!(0 < rgb.stored_bytes && rgb.stored_bytes < rgb.raw_bytes, "{rgb:?}");
    assert!(!summary.arrays.contains_key("obs/fixed_rgb"), "a second name of the same images");
    let joints = summary.joints.values().next().unwrap();
    let first: Vec<f64> = all
        .iter()
        .flat_map(|arrays| match &arrays["obs/joint_pos"].values {
            Values::F32(values) => values.chunks(joints.len()).map(|row| f64::from(row[0])),
            other => panic!("{other:?}"),
        })
        .collect();
    let mean = first.iter().sum::<f64>() / first.len() as f64;
    assert!((joints[0].mean - mean).abs() < 1e-9, "{joints:?}");
    assert_eq!(joints[0].max, first.iter().copied().fold(f64::NEG_INFINITY, f64::max));

    let logs = summarize(written(Container::Mcap).path()).unwrap();
    assert_eq!((logs.episodes, logs.frames), (summary.episodes, summary.frames));
    assert!(logs.arrays.is_empty());
}
