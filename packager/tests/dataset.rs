//! Dataset folders: what is written is read, damage is found, killed runs are resumed.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking, too")]

mod common;
#[path = "../examples/sample/mod.rs"]
mod sample;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use akrobat_model::events::Silent;
use akrobat_packager::dataset::{Container, Values};
use akrobat_packager::{DatasetReader, DatasetWriter, PackError, validate};
use common::{files, problems, written};
use sample::{EPISODES, FRAMES, config, info, observation};

#[test]
fn episodes_read_back() {
    let folder = written(Container::Hdf5);
    let dataset = DatasetReader::open(folder.path()).unwrap();
    assert!(dataset.is_complete());
    assert_eq!(dataset.entries().len(), EPISODES as usize + 1);
    for (index, (id, stored)) in dataset.episodes().enumerate() {
        assert_eq!((id, stored.frames), (info(index as u32).id.as_str(), FRAMES));
        let episode = dataset.episode(stored).unwrap();
        for frame in [0, FRAMES - 1] {
            let expected = observation(index as u32, frame);
            let rgb = episode.frame("camera_obs/fixed_rgb", frame as usize).unwrap();
            assert_eq!(rgb.shape, [48, 64, 3]);
            assert_eq!(rgb.values, Values::U8(expected.cameras[0].rgb.clone()));
            let depth = episode.frame("obs/wrist_depth", frame as usize).unwrap();
            let Values::U16(depth) = depth.values else { panic!("depth is not u16") };
            for (stored, exact) in depth.iter().zip(&expected.cameras[1].depth_m) {
                assert!((f32::from(*stored) / 1000.0 - exact).abs() <= 0.00051);
            }
            let cloud = episode.frame("point_cloud", frame as usize).unwrap();
            assert_eq!(cloud.values, Values::F32(expected.cloud.as_flattened().to_vec()));
        }
    }
}

#[test]
fn actions_lead_to_the_next_frame() {
    let folder = written(Container::Hdf5);
    let dataset = DatasetReader::open(folder.path()).unwrap();
    let (_, stored) = dataset.episodes().next().unwrap();
    let actions = dataset.episode(stored).unwrap().array("actions").unwrap();
    let Values::F32(actions) = actions.values else { panic!("actions are not f32") };
    for (t, row) in actions.chunks(6).enumerate() {
        let reached = observation(0, (t as u32 + 1).min(FRAMES - 1)).robot;
        assert!(row.iter().zip(&reached).all(|(&a, &b)| a == b as f32), "frame {t}");
    }
}

#[test]
fn bytes_do_not_depend_on_threads() {
    for container in [Container::Hdf5, Container::Mcap] {
        let with_threads = |count| {
            let folder = tempfile::tempdir().unwrap();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
            pool.install(|| sample::write(folder.path(), container, || {})).unwrap();
            files(folder.path())
        };
        assert!(with_threads(1) == with_threads(4), "{container:?} differs");
    }
}

#[test]
fn whole_datasets_are_valid_and_damage_is_found() {
    for container in [Container::Hdf5, Container::Mcap] {
        let folder = written(container);
        assert_eq!(problems(folder.path()), "", "{container:?}");
        let report = validate(folder.path(), &Silent).unwrap();
        assert_eq!(report.frames, u64::from(EPISODES * FRAMES));

        let shard = std::fs::read_dir(folder.path().join("shards")).unwrap().next().unwrap();
        let shard = shard.unwrap().path();
        let mut bytes = std::fs::read(&shard).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0xff;
        std::fs::write(&shard, bytes).unwrap();
        assert!(problems(folder.path()).contains("checksum"), "{container:?}");
        std::fs::remove_file(&shard).unwrap();
        assert!(problems(folder.path()).contains("cannot read"), "{container:?}");
    }
}

#[test]
fn bad_content_is_found() {
    type Spoil = fn(&mut akrobat_cameras::Observation);
    let cases: [(&str, Spoil); 5] = [
        ("fixed_rgb: frame 2 is black", |o| o.cameras[0].rgb.fill(0)),
        ("wrist_depth: frame 2 has no depth", |o| o.cameras[1].depth_m.fill(f32::NAN)),
        ("joint_pos: holds NaN", |o| o.robot[3] = f64::NAN),
        ("point_cloud: has points beyond", |o| o.cloud[7][1] = 1e4),
        ("segment 77 has no label", |o| o.cameras[0].segmentation[5] = 77),
    ];
    for (expected, spoil) in cases {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = DatasetWriter::create(folder.path(), config(Container::Hdf5)).unwrap();
        writer.begin_episode(info(0)).unwrap();
        for frame in 0..FRAMES {
            let mut observation = observation(0, frame);
            if frame == 2 {
                spoil(&mut observation);
            }
            writer.push(observation).unwrap();
        }
        writer.finish_episode().unwrap();
        writer.close().unwrap();
        let found = problems(folder.path());
        assert!(found.contains(expected), "{found:?} lacks {expected:?}");
    }
}

#[test]
fn wrong_use_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = DatasetWriter::create(folder.path(), config(Container::Hdf5)).unwrap();
    assert!(writer.push(observation(0, 0)).is_err(), "no episode is open");
    writer.begin_episode(info(0)).unwrap();
    assert!(writer.begin_episode(info(1)).is_err(), "an episode is open");
    let mut small = observation(0, 0);
    small.cameras[0].rgb.truncate(10);
    let message = writer.push(small).unwrap_err().to_string();
    assert!(message.contains("fixed rgb pixels: expected 3072, got 3"), "{message}");
    writer.push(observation(0, 0)).unwrap();
    assert!(writer.push(observation(0, 2)).is_err(), "frame 1 is missing");
    assert!(writer.finish_episode().is_err(), "frames are missing");
}

#[test]
fn folders_in_use_are_refused() {
    let folder = written(Container::Hdf5);
    let error = DatasetWriter::create(folder.path(), config(Container::Hdf5)).unwrap_err();
    assert!(matches!(error, PackError::Unwritable { .. }), "{error}");
    let error = DatasetWriter::resume(folder.path(), config(Container::Mcap)).unwrap_err();
    assert_eq!(error.exit_code(), 2, "{error}");
    let file = folder.path().join("dataset.json/below");
    assert_eq!(DatasetWriter::create(&file, config(Container::Mcap)).unwrap_err().exit_code(), 2);
}

const FOLDER: &str = "AKROBAT_TEST_DATASET_FOLDER";
const CONTAINER: &str = "AKROBAT_TEST_DATASET_MCAP";

/// The process that `killed_runs_resume_to_the_same_bytes` starts and kills.
#[test]
#[ignore = "only of use to the test that kills it"]
fn killed_writer() {
    let folder = std::env::var(FOLDER).expect("the parent names a folder");
    let container =
        if std::env::var_os(CONTAINER).is_some() { Container::Mcap } else { Container::Hdf5 };
    sample::write(Path::new(&folder), container, || std::thread::sleep(Duration::from_millis(5)))
        .unwrap();
}

#[test]
fn killed_runs_resume_to_the_same_bytes() {
    for container in [Container::Hdf5, Container::Mcap] {
        let expected = files(written(container).path());
        let mut interrupted = 0;
        for delay_ms in [15, 60, 110, 170, 230, 280] {
            let folder = tempfile::tempdir().unwrap();
            let mut command = Command::new(std::env::current_exe().unwrap());
            command.args(["--exact", "--ignored", "killed_writer"]).env(FOLDER, folder.path());
            if container == Container::Mcap {
                command.env(CONTAINER, "1");
            }
            let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            std::thread::sleep(Duration::from_millis(delay_ms));
            child.kill().unwrap();
            child.wait().unwrap();
            interrupted += usize::from(files(folder.path()) != expected);
            sample::write(folder.path(), container, || {}).unwrap();
            assert!(files(folder.path()) == expected, "{container:?} after {delay_ms} ms");
        }
        assert!(interrupted > 0, "no run was killed before its end");
    }
}
