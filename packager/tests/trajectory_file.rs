//! Trajectory files: exact round trips, same bytes, and refusal of damaged files.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking, too")]

use std::path::Path;

use akrobat_model::robot::BaseKind;
use akrobat_model::trajectory::{ContactException, DensePath, Grasp, Regrasp, TrajectoryHeader};
use akrobat_model::{JointPath, Phase, Pose, Rejection, Trajectory, TrajectorySet, Verdict, pose};
use akrobat_packager::{PackError, trajectory_file};
use proptest::prelude::*;

fn header(robot: usize, object: usize, seed: u64, text: String) -> TrajectoryHeader {
    TrajectoryHeader {
        task_toml: text,
        task_dir: "..".into(),
        task_name: "open".into(),
        scene_id: "kitchen".into(),
        object_id: "microwave".into(),
        robot_id: "robot".into(),
        base_kind: BaseKind::Holonomic,
        content_hashes: [("robot.urdf".to_string(), "ab12".to_string())].into(),
        robot_joints: (0..robot).map(|i| format!("joint_{i}")).collect(),
        object_joints: (0..object).map(|i| format!("door joint_{i}")).collect(),
        active_joint: "door joint_0".into(),
        contact_exceptions: vec![ContactException {
            robot_link: "finger".into(),
            object_link: "door".into(),
            object_part: "handle*".into(),
        }],
        seed,
        planner_config: serde_json::json!({"seeds": 12, "nested": {"z": 1.5, "a": null}}),
        backend: "cpu".into(),
        counts: [("proposed".to_string(), u64::MAX)].into(),
    }
}

fn joint_path(rows: usize, columns: usize) -> impl Strategy<Value = JointPath> {
    // `-0.0`, subnormal and infinite values have to survive too.
    let value =
        prop_oneof![8 => -4.0f32..4.0, 1 => Just(-0.0), 1 => Just(1e-42), 1 => Just(f32::INFINITY)];
    prop::collection::vec(value, rows * columns)
        .prop_map(move |values| JointPath::from_values(columns, values).unwrap())
}

fn dense(robot: usize, object: usize) -> impl Strategy<Value = DensePath> {
    (0usize..40).prop_flat_map(move |samples| {
        let phase = prop::collection::vec((0usize..6).prop_map(|i| Phase::ALL[i]), samples);
        (
            prop::collection::vec(0.0..9.0f64, samples),
            joint_path(samples, robot),
            joint_path(samples, object),
            phase,
        )
            .prop_map(|(times_s, robot, object, phase)| DensePath {
                times_s,
                robot,
                object,
                phase,
            })
    })
}

fn verdict() -> impl Strategy<Value = Option<Verdict>> {
    let rejection = prop::option::of((0usize..11).prop_map(|i| Rejection::ALL[i]));
    prop::option::of((rejection, ".{0,20}", any::<[u32; 6]>(), any::<u32>()).prop_map(
        |(rejection, detail, v, samples)| {
            let v = v.map(|v| f64::from(v) * 1e-9);
            Verdict {
                rejection,
                detail: detail.replace('\0', ""),
                anchor_translation_m: v[0],
                anchor_rotation_rad: v[1],
                velocity_fraction: v[2],
                acceleration_fraction: v[3],
                base_yaw_rad: v[4],
                penetration_m: v[5],
                samples,
            }
        },
    ))
}

fn trajectory(waypoints: usize, robot: usize, object: usize) -> impl Strategy<Value = Trajectory> {
    let pose = (prop::array::uniform3(-5.0..5.0f64), prop::array::uniform3(-3.0..3.0f64))
        .prop_map(|(xyz, rpy)| pose::from_xyz_rpy(xyz, rpy));
    let grasp = (any::<u32>(), "[a-z ]{0,12}", pose, 0.0..0.1f64).prop_map(
        |(id, link, link_from_tool, width_m)| Grasp { id, link, link_from_tool, width_m },
    );
    let regrasp = (any::<u32>(), any::<u32>(), grasp.clone()).prop_map(
        |(first_waypoint, dense_start, grasp)| Regrasp { first_waypoint, dense_start, grasp },
    );
    let grasps = (grasp, prop::collection::vec(regrasp, 0..3));
    let tables =
        (joint_path(waypoints, robot), joint_path(waypoints, object), dense(robot, object));
    let numbers =
        (any::<u64>(), -3.0..3.0f64, -3.0..3.0f64, 0.01..1.0f64, any::<u32>(), any::<u32>());
    ("[0-9a-f]{8}", grasps, tables, numbers, verdict()).prop_map(
        |(id, (grasp, regrasps), (waypoints_robot, waypoints_object, dense), numbers, verdict)| {
            let (seed, start, goal, waypoint_interval_s, manipulation_start, substeps) = numbers;
            Trajectory {
                id,
                seed,
                grasp,
                start,
                goal,
                waypoints_robot,
                waypoints_object,
                waypoint_interval_s,
                manipulation_start,
                substeps,
                regrasps,
                dense,
                verdict,
            }
        },
    )
}

fn trajectory_set() -> impl Strategy<Value = TrajectorySet> {
    (0usize..5, 1usize..31, 1usize..13, 0usize..4).prop_flat_map(
        |(count, waypoints, robot, object)| {
            let trajectories = prop::collection::vec(trajectory(waypoints, robot, object), count);
            (trajectories, any::<u64>(), "[a-zäß\n=\"]{0,200}").prop_map(
                move |(trajectories, seed, text)| TrajectorySet {
                    header: header(robot, object, seed, text),
                    trajectories,
                },
            )
        },
    )
}

/// One fixed set of three trajectories of 30 waypoints and 11 + 2 columns.
fn example() -> TrajectorySet {
    let wave = |row: usize, column: usize| ((row * 7 + column * 3) as f64 * 0.1).sin();
    let path = |rows: usize, columns: usize| {
        let mut path = JointPath::new(columns);
        (0..rows).for_each(|row| path.push((0..columns).map(|column| wave(row, column))));
        path
    };
    let trajectory = |index: usize| {
        let samples = 300 + index;
        Trajectory {
            id: format!("id{index}"),
            seed: index as u64,
            grasp: Grasp {
                id: index as u32,
                link: "door".into(),
                link_from_tool: Pose::identity(),
                width_m: 0.02,
            },
            start: 0.0,
            goal: 1.0,
            waypoints_robot: path(30, 11),
            waypoints_object: path(30, 2),
            waypoint_interval_s: 0.13,
            manipulation_start: 0,
            substeps: 10,
            regrasps: Vec::new(),
            dense: DensePath {
                times_s: (0..samples).map(|i| i as f64 * 0.01).collect(),
                robot: path(samples, 11),
                object: path(samples, 2),
                phase: vec![Phase::Manipulate; samples],
            },
            verdict: None,
        }
    };
    TrajectorySet {
        header: header(11, 2, 5, "x = 1".into()),
        trajectories: (0..3).map(trajectory).collect(),
    }
}

fn in_folder<T>(test: impl FnOnce(&Path) -> T) -> T {
    let folder = tempfile::tempdir().unwrap();
    test(folder.path())
}

fn message(result: Result<TrajectorySet, PackError>) -> String {
    let error = result.unwrap_err();
    assert_eq!(error.exit_code(), 2, "{error}");
    error.to_string()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn sets_round_trip_exactly(set in trajectory_set()) {
        let back = in_folder(|folder| {
            let path = folder.join("t.h5");
            trajectory_file::write(&path, &set).unwrap();
            trajectory_file::read(&path).unwrap()
        });
        prop_assert_eq!(back, set);
    }
}

#[test]
fn the_same_set_gives_the_same_bytes() {
    in_folder(|folder| {
        let (a, b) = (folder.join("a.h5"), folder.join("b.h5"));
        trajectory_file::write(&a, &example()).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(1100));
        trajectory_file::write(&b, &example()).unwrap();
        assert!(std::fs::read(a).unwrap() == std::fs::read(b).unwrap(), "bytes differ");
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), 2, "something temporary is left");
    });
}

#[test]
fn truncated_files_are_refused() {
    in_folder(|folder| {
        let path = folder.join("t.h5");
        trajectory_file::write(&path, &example()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for length in [0, 1, 100, 1000, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(message(trajectory_file::read(&path)).contains("t.h5"));
        }
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(trajectory_file::read(&path).unwrap(), example());
    });
}

/// A flipped byte is refused, or lies where it changes nothing or only text; it never gives other
/// numbers, and never a crash.
#[test]
fn flipped_bytes_never_change_numbers() {
    in_folder(|folder| {
        let path = folder.join("t.h5");
        let set = example();
        trajectory_file::write(&path, &set).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let mut refused = 0;
        for position in (0..bytes.len()).step_by(bytes.len() / 400) {
            let mut damaged = bytes.clone();
            damaged[position] ^= 0x10;
            std::fs::write(&path, &damaged).unwrap();
            match trajectory_file::read(&path) {
                Err(error) => {
                    refused += 1;
                    assert_eq!(error.exit_code(), 2, "{error}");
                }
                Ok(back) => {
                    for (a, b) in back.trajectories.iter().zip(&set.trajectories) {
                        assert_eq!(a.dense, b.dense, "byte {position}");
                        assert_eq!(a.waypoints_robot, b.waypoints_robot, "byte {position}");
                    }
                }
            }
        }
        assert!(refused > 200, "only {refused} of 400 damaged files were refused");
    });
}

#[test]
fn missing_and_misshapen_datasets_are_named() {
    type Damage = fn(&hdf5::File);
    let cases: [(&str, Damage); 6] = [
        ("dense/robot: expected a dataset, got no such dataset", |f| {
            f.unlink("dense/robot").unwrap()
        }),
        ("waypoints/robot: expected shape [3, any, 11], got shape [2, 30, 11]", |f| {
            f.unlink("waypoints/robot").unwrap();
            let new = f.new_dataset::<f32>().shape((2, 30, 11)).create("waypoints/robot").unwrap();
            new.write_raw(&vec![0.0f32; 660]).unwrap();
        }),
        ("seed: expected at most the", |f| {
            f.unlink("start").unwrap();
            f.unlink("seed").unwrap();
            let huge = 1usize << 50;
            f.new_dataset::<u64>().chunk((1024,)).shape((huge,)).create("seed").unwrap();
            f.new_dataset::<f64>().chunk((1024,)).shape((huge,)).create("start").unwrap();
        }),
        ("goal: expected type", |f| {
            f.unlink("goal").unwrap();
            f.new_dataset::<f32>()
                .shape((3,))
                .create("goal")
                .unwrap()
                .write_raw(&[0.0f32; 3])
                .unwrap();
        }),
        ("dense/offset: expected non-decreasing", |f| {
            f.dataset("dense/offset").unwrap().write_raw(&[0u64, 5, 2, 903]).unwrap();
        }),
        ("attribute format_version: expected 1 or 2, got 9", |f| {
            f.attr("format_version").unwrap().write_scalar(&9u32).unwrap();
        }),
    ];
    for (expected, damage) in cases {
        in_folder(|folder| {
            let path = folder.join("t.h5");
            trajectory_file::write(&path, &example()).unwrap();
            damage(&hdf5::File::open_rw(&path).unwrap());
            let message = message(trajectory_file::read(&path));
            assert!(message.contains(expected), "{message:?} lacks {expected:?}");
        });
    }
}

#[test]
fn unwritable_places_are_refused_and_leave_nothing() {
    in_folder(|folder| {
        let error = trajectory_file::write(&folder.join("absent/t.h5"), &example()).unwrap_err();
        assert!(matches!(error, PackError::Unwritable { .. }), "{error}");
        assert_eq!(error.exit_code(), 2);
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), 0);
    });
}

#[test]
fn contradicting_sets_are_refused_and_leave_the_old_file() {
    in_folder(|folder| {
        let path = folder.join("t.h5");
        trajectory_file::write(&path, &example()).unwrap();
        let mut set = example();
        set.trajectories[1].waypoints_robot = JointPath::new(11);
        let error = trajectory_file::write(&path, &set).unwrap_err();
        assert!(error.to_string().contains("waypoints/robot of trajectory 1"), "{error}");
        assert_eq!(trajectory_file::read(&path).unwrap(), example());
    });
}
