"""Replay of the same episodes by `akrobat replay` and by ManiSkill's `replay_trajectory`.

    eval "$(scripts/vulkan.sh)"
    .cache/maniskill/bin/python benchmarks/maniskill.py --assets ../shared/assets --limit 10

plans a task, renders it with one small camera, exports it and lets both replay it: Akrobat the
trajectory file, with its audit, ManiSkill the export's actions, in the environment that
`akrobat.maniskill` gives it, without observations. Prints how many episodes each says succeed, and
the CPU time of an episode: of ManiSkill, the difference between a run of all episodes and one of
the first, so that imports and loading do not count. Needs what `make test-maniskill` installs
and, for ManiSkill, a Vulkan driver.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import akrobat
from akrobat.physics import PhysicsConfig, Replayer

REPOSITORY = Path(__file__).parents[1]
TASKS = REPOSITORY / "configs" / "tasks"
RIG = REPOSITORY / "configs" / "rigs" / "one_camera.toml"


def main() -> None:
    """Prints one row for each of both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", nargs="?", default="panda_microwave_empty")
    parser.add_argument("--assets", type=Path, action="append", default=[])
    parser.add_argument("--limit", type=int, default=10)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        file = folder / "planned.h5"
        task = TASKS / f"{arguments.task}.toml"
        akrobat.plan(task, file, limit=arguments.limit, assets=arguments.assets, quiet=True)
        export(file, folder, arguments.assets)
        print("| replay | succeed | CPU s/episode | episodes/CPU h |")
        print("|---|---|---|---|")
        print(row("`akrobat replay`", *ours(file, arguments.assets)))
        print(row("ManiSkill's", *theirs(folder, arguments.limit, arguments.assets)))


def row(name: str, succeeded: int, count: int, cpu_s: float) -> str:
    """A row of the table."""
    return f"| {name} | {succeeded} of {count} | {cpu_s:.2f} | {3600 / cpu_s:.0f} |"


def export(file: Path, folder: Path, assets: list[Path]) -> None:
    """Renders and exports for ManiSkill."""
    akrobat.render(
        file,
        folder / "data",
        backend="soft",
        rig=RIG,
        cloud={"points": 0},
        assets=assets,
        quiet=True,
    )
    command = [sys.executable, "-m", "akrobat", "export", str(folder / "data"), "--to", "maniskill"]
    subprocess.run([*command, "-o", str(folder / "export"), "--quiet"], check=True)


def ours(file: Path, assets: list[Path]) -> tuple[int, int, float]:
    """Successes, episodes, CPU seconds of an episode."""
    trajectories = akrobat.Trajectories.read(file)
    replayer = Replayer(akrobat.Task.of_trajectories(file, assets), PhysicsConfig.of())
    started = time.process_time()
    count = len(trajectories)
    audits = [replayer.replay(trajectories, episode) for episode in range(count)]
    cpu_s = time.process_time() - started
    return sum(audit.success for audit in audits), count, cpu_s / count


def theirs(folder: Path, count: int, assets: list[Path]) -> tuple[int, int, float]:
    """Successes, episodes, CPU seconds of an episode."""
    places = ":".join(str(place.resolve()) for place in (TASKS, *assets))
    environment = {**os.environ, "AKROBAT_ASSET_PATH": places}

    def run(episodes: int) -> tuple[str, float]:
        command = [sys.executable, "-W", "ignore", "-m", "mani_skill.trajectory.replay_trajectory"]
        command += ["--traj-path", str(folder / "export" / "trajectory.h5"), "--obs-mode", "none"]
        command += ["--sim-backend", "physx_cpu", "--count", str(episodes)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            command, stdout=subprocess.PIPE, text=True, check=True, env=environment
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return done.stdout, cpu_s

    _, first_s = run(1)
    printed, all_s = run(count)
    (succeeded,) = re.findall(rf"(\d+)/{count}=", printed)
    return int(succeeded), count, (all_s - first_s) / (count - 1)


if __name__ == "__main__":
    main()
