"""Plans the 700 MotionBenchMaker problems of the Panda; Pinocchio and coal judge every path.

    python benchmarks/motionbenchmaker.py PROBLEMS.tar.bz2 [--rounds 5] [--json]

PROBLEMS is the archive of MotionBenchMaker's problems (`problems/SET/{scene,request}NNNN.yaml`).
The planner is `planner/examples/motionbenchmaker.rs`, built here if need be; the robot is the Panda
of PyPI's `example-robot-data`, with spheres fitted to its collision meshes. The judge reads the
same URDF and the same YAML, and checks the meshes every 0.01 rad (largest joint) along every path,
with the pairs that the scene's matrix forbids, and the ends and limits of the joints.

Needs `pin`, `example-robot-data`, `pyyaml`. Exit code 1 where less than 99 % is solved and judged
good.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tarfile
import tempfile
from itertools import pairwise
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import yaml

ROOT = Path(__file__).resolve().parent.parent
STEP_RAD = 0.01
# Goals and limits are written with many digits, paths in double precision.
TOLERANCE_RAD = 1e-6
WANTED = 0.99
# Median planning times as published, milliseconds. None of these ran here.
PUBLISHED = {
    "VAMP RRT-Connect, search alone, one core of a desktop (its README, 2024)": 0.035,
    "cuRobo 0.7.6, RTX 6000 Ada, MotionBenchMaker's 800 problems (its benchmark page)": 31.0,
}


def robot_files() -> tuple[Path, Path]:
    """The Panda's URDF and the folder that its `package://` paths start from."""
    import importlib.util

    for folder in map(Path, sys.path):
        data = folder / "cmeel.prefix" / "share" / "example-robot-data"
        urdf = data / "robots" / "panda_description" / "urdf" / "panda.urdf"
        if urdf.is_file():
            return urdf, data
    found = importlib.util.find_spec("example_robot_data")
    raise SystemExit(f"panda.urdf of example-robot-data not found ({found}): pip install it")


def run_planner(problems: Path, urdf: Path, assets: Path, options: list[str]) -> dict:
    """Builds and runs the Rust side."""
    build = ["cargo", "build", "--release", "--quiet", "--workspace"]
    subprocess.run([*build, "--example", "motionbenchmaker"], check=True, cwd=ROOT)
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    binary = target / "release" / "examples" / "motionbenchmaker"
    command = [str(binary), str(problems), str(urdf), str(assets), *options]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)


class MeshJudge:
    """Checks paths of the Panda on its meshes."""

    def __init__(self, urdf: Path, assets: Path):
        self.model = pin.buildModelFromUrdf(str(urdf))
        packages = [str(assets), str(assets.parent)]
        kind = pin.GeometryType.COLLISION
        self.robot = pin.buildGeomFromUrdf(self.model, str(urdf), kind, package_dirs=packages)
        self.data = self.model.createData()

    def judge(self, folder: Path, problem: dict) -> str | None:
        """Why a path is refused, or nothing."""
        number = problem["problem"]
        folder = folder / problem["set"]
        scene = yaml.load((folder / f"scene{number}.yaml").read_bytes(), yaml.CSafeLoader)
        request = yaml.load((folder / f"request{number}.yaml").read_bytes(), yaml.CSafeLoader)
        goal = {
            c["joint_name"]: c["position"]
            for c in request["goal_constraints"][0]["joint_constraints"]
        }
        state = request["start_state"]["joint_state"]
        start = dict(zip(state["name"], state["position"], strict=True))
        joints = [n for n in self.model.names if n in goal]
        columns = [self.model.joints[self.model.getJointId(n)].idx_q for n in joints]
        rest = pin.neutral(self.model)
        for name, value in start.items():
            rest[self.model.joints[self.model.getJointId(name)].idx_q] = value
        path = np.array(problem["path"])
        ends = [start[n] for n in joints], [goal[n] for n in joints]
        if max(np.abs(path[0] - ends[0]).max(), np.abs(path[-1] - ends[1]).max()) > TOLERANCE_RAD:
            return "does not lead from start to goal"
        # A few goals of the data lie just beyond the limits of this description.
        low = np.minimum(self.model.lowerPositionLimit[columns], np.min(ends, axis=0))
        high = np.maximum(self.model.upperPositionLimit[columns], np.max(ends, axis=0))
        low, high = low - TOLERANCE_RAD, high + TOLERANCE_RAD
        if ((path < low) | (path > high)).any():
            return "leaves the joint limits"
        geometry = self.geometry(scene)
        data = geometry.createData()
        for a, b in pairwise(path):
            count = max(1, int(np.ceil(np.abs(b - a).max() / STEP_RAD)))
            for t in np.linspace(0.0, 1.0, count + 1):
                q = rest.copy()
                q[columns] = a + (b - a) * t
                if pin.computeCollisions(self.model, self.data, geometry, data, q, True):
                    return collision(geometry, data)
        return None

    def geometry(self, scene: dict) -> pin.GeometryModel:
        """The robot among the scene's solids, with the pairs that must not touch."""
        geometry = self.robot.copy()
        own = range(len(geometry.geometryObjects))
        link = [g.name.rsplit("_", 1)[0] for g in geometry.geometryObjects]
        matrix = scene["allowed_collision_matrix"]
        row = {name: i for i, name in enumerate(matrix["entry_names"])}
        for i in own:
            for j in range(i + 1, len(link)):
                known = link[i] in row and link[j] in row and link[i] != link[j]
                if known and not matrix["entry_values"][row[link[i]]][row[link[j]]]:
                    geometry.addCollisionPair(pin.CollisionPair(i, j))
        for item in scene["world"]["collision_objects"]:
            places = zip(item["primitives"], item["primitive_poses"], strict=True)
            for primitive, place in places:
                x, y, z, w = place["orientation"]
                at = pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(place["position"]))
                size = primitive["dimensions"]
                if primitive["type"] == "box":
                    shape = coal.Box(*size)
                elif primitive["type"] == "cylinder":
                    shape = coal.Cylinder(size[1], size[0])
                else:
                    raise SystemExit(f"{item['id']}: unknown primitive {primitive['type']}")
                name = f"{item['id']}#{len(geometry.geometryObjects)}"
                index = geometry.addGeometryObject(pin.GeometryObject(name, 0, at, shape))
                for i in own:
                    # The first link does not move: what it touches, it has always touched.
                    if geometry.geometryObjects[i].parentJoint > 0:
                        geometry.addCollisionPair(pin.CollisionPair(i, index))
        return geometry


def collision(geometry: pin.GeometryModel, data: pin.GeometryData) -> str:
    for pair, result in zip(geometry.collisionPairs, data.collisionResults, strict=True):
        if result.isCollision():
            objects = geometry.geometryObjects
            return f"{objects[pair.first].name} touches {objects[pair.second].name}"
    return "collision"


def quantile(values: list[float], fraction: float) -> float:
    return float(np.quantile(values, fraction)) if values else float("nan")


def summary(problems: list[dict]) -> dict:
    """Rates and times of one set."""
    solved = [p for p in problems if p["solved"]]
    total = [p["search_us"] + p["simplify_us"] for p in solved]
    search = [p["search_us"] for p in solved]
    lengths = [path_length(p["path"]) for p in solved]
    return {
        "problems": len(problems),
        "solved": len(solved),
        "judged_good": sum(p["refused"] is None for p in solved),
        "search_us_median": quantile(search, 0.5),
        "search_us_p95": quantile(search, 0.95),
        "total_us_median": quantile(total, 0.5),
        "total_us_p95": quantile(total, 0.95),
        "total_us_mean": float(np.mean(total)) if total else float("nan"),
        "path_length_rad_median": quantile(lengths, 0.5),
    }


def path_length(path: list[list[float]]) -> float:
    return float(np.linalg.norm(np.diff(np.array(path), axis=0), axis=1).sum())


def text(report: dict) -> str:
    """The table, for people."""
    lines = [
        f"{platform.machine()}, {os.cpu_count()} cores; {report['spheres']} spheres; "
        f"least of {report['rounds']} rounds",
        f"{'set':24} {'solved':>9} {'judged':>7} {'search us':>10} {'p95':>8} "
        f"{'in all us':>10} {'p95':>8} {'length rad':>10}",
    ]
    for name, row in report["sets"].items():
        lines.append(
            f"{name:24} {row['solved']:4}/{row['problems']:4} {row['judged_good']:7} "
            f"{row['search_us_median']:10.0f} {row['search_us_p95']:8.0f} "
            f"{row['total_us_median']:10.0f} {row['total_us_p95']:8.0f} "
            f"{row['path_length_rad_median']:10.2f}"
        )
    lines += [f"published, not run here: {name}: {ms} ms" for name, ms in PUBLISHED.items()]
    lines += [f"not solved: {p}" for p in report["unsolved"]]
    lines += [f"refused: {p}" for p in report["refused"]]
    return "\n".join(lines)


def main() -> int:
    """Runs the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("archive", type=Path, help="panda.tar.bz2 of MotionBenchMaker")
    parser.add_argument(
        "--rounds", type=int, default=5, help="runs of each problem; the least time counts"
    )
    parser.add_argument("--set", help="one set only")
    parser.add_argument("--option", action="append", default=[], help="NAME=VALUE for the planner")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    urdf, assets = robot_files()
    options = ["--rounds", str(arguments.rounds)]
    options += ["--set", arguments.set] if arguments.set else []
    for option in arguments.option:
        name, value = option.split("=", 1)
        options += [f"--{name}", value]
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(arguments.archive) as archive:
            archive.extractall(folder, filter="data")
        problems = Path(folder) / "problems"
        report = run_planner(problems, urdf, assets, options)
        judge = MeshJudge(urdf, assets)
        for problem in report["problems"]:
            problem["refused"] = judge.judge(problems, problem) if problem["solved"] else None
    rows = report.pop("problems")
    names = sorted({p["set"] for p in rows})
    report["sets"] = {name: summary([p for p in rows if p["set"] == name]) for name in names}
    report["sets"]["all"] = summary(rows)
    label = "{set}/{problem}: ".format
    report["unsolved"] = [label(**p) + p["reason"] for p in rows if not p["solved"]]
    report["refused"] = [label(**p) + p["refused"] for p in rows if p["refused"]]
    report["published_ms"] = PUBLISHED
    print(json.dumps(report, indent=1) if arguments.json else text(report))
    everything = report["sets"]["all"]
    return 0 if everything["judged_good"] >= WANTED * everything["problems"] else 1


if __name__ == "__main__":
    sys.exit(main())
