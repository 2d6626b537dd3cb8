"""Many faults, one after the other: `make test-faults`. The fast tests have some of each kind."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import akrobat
import pytest

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).parents[2]
RIG = REPOSITORY / "tests" / "rigs" / "tiny.toml"
EPISODES = 6
KILLS = 100
#: Runs that are killed in a row before one may finish.
KILLS_IN_A_ROW = 5

Contents = dict[str, bytes]


class Job:
    """`akrobat render` of six trajectories into shards of two, the same but for its output."""

    def __init__(self, folder: Path, assets: Path) -> None:
        task = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
        file = folder / "six.h5"
        akrobat.plan(task, file, limit=EPISODES, assets=[assets], quiet=True)
        inputs = [file, "--assets", assets, "--rig", RIG, "--backend", "soft"]
        options = ["--phases", "manipulate", "--episodes-per-shard", 2, "--cloud-points", 256]
        self.arguments = list(map(str, [*inputs, *options]))

    def command(self, output: Path, *more: str) -> list[str]:
        program = [sys.executable, "-m", "akrobat", "--json", "render"]
        return [*program, *self.arguments, "-o", str(output), *more]

    def run(self, output: Path, *more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(output, *more), capture_output=True, text=True, check=False
        )


@pytest.fixture(scope="module")
def job(shared_assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("job"), shared_assets)


@pytest.fixture(scope="module", params=["hdf5", "mcap"])
def container(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def whole(
    job: Job, container: str, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Contents, float]:
    """What a run writes that nobody disturbs, and how long it takes, seconds."""
    folder = tmp_path_factory.mktemp("whole") / "dataset"
    started = time.monotonic()
    done = job.run(folder, "--format", container)
    assert done.returncode == 0, done.stderr
    return contents(folder), time.monotonic() - started


def contents(folder: Path) -> Contents:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def check_whole_shards(folder: Path, reference: Contents) -> None:
    """A file under its final name is what it will be in the end."""
    for path in folder.glob("shards/*"):
        if path.suffix != ".partial":
            assert path.read_bytes() == reference[f"shards/{path.name}"], path.name


def check_whole(folder: Path) -> None:
    program = [sys.executable, "-m", "akrobat", "--json", "validate", str(folder)]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_killed_at_random_instants(
    job: Job, container: str, whole: tuple[Contents, float], tmp_path: Path
) -> None:
    reference, duration_s = whole
    chance = random.Random(2025)
    cut_short = 0
    for row in range(KILLS // 2 // KILLS_IN_A_ROW):
        folder = tmp_path / f"dataset{row}"
        for _ in range(KILLS_IN_A_ROW):
            command = job.command(folder, "--format", container, "--resume")
            silence = subprocess.DEVNULL
            process = subprocess.Popen(command, stdout=silence, stderr=silence)
            time.sleep(chance.uniform(0.0, duration_s))
            process.send_signal(signal.SIGKILL)
            cut_short += process.wait() == -signal.SIGKILL
            check_whole_shards(folder, reference)
        done = job.run(folder, "--format", container, "--resume")
        assert done.returncode == 0, done.stderr
        assert contents(folder) == reference
        check_whole(folder)
        shutil.rmtree(folder)
    assert cut_short > KILLS // 8, "most runs ended before they were killed"


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system that is too small."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or not shutil.which("mount"):
        pytest.skip("only root can mount a file system")
    mount = ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", str(folder)]
    if subprocess.run(mount, check=False, capture_output=True).returncode != 0:
        pytest.skip("no file system can be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_is_survived(
    job: Job, container: str, whole: tuple[Contents, float], disk: Path
) -> None:
    folder, (reference, _) = disk / "dataset", whole
    failed = job.run(folder, "--format", container)
    assert failed.returncode == 1, failed.stderr
    assert "space" in failed.stderr.lower()
    check_whole_shards(folder, reference)
    subprocess.run(["mount", "-o", "remount,size=200m", str(disk)], check=True)
    done = job.run(folder, "--format", container, "--resume")
    assert done.returncode == 0, done.stderr
    assert contents(folder) == reference


def test_a_read_only_disk_is_bad_input(
    job: Job, container: str, whole: tuple[Contents, float], disk: Path
) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    refused = job.run(disk / "dataset", "--format", container)
    assert refused.returncode == 2, refused.stderr
    assert "cannot write" in refused.stderr
    assert str(disk / "dataset") in refused.stderr


def shards_being_made(output: Path) -> list[int]:
    """Processes that make a single shard of a dataset."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"--only-shards" in words and str(output).encode() in words:
            found.append(int(folder.name))
    return found


def kill_with_parent(process: int) -> None:
    """Kills a process that renders and the Ray worker that waits for it."""
    parent = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    for victim in (parent, process):
        os.kill(victim, signal.SIGKILL)


def test_killed_ray_workers_are_replaced(
    job: Job, whole: tuple[Contents, float], container: str, tmp_path: Path
) -> None:
    pytest.importorskip("ray")
    folder, (reference, _) = tmp_path / "dataset", whole
    arguments = [*job.arguments, "-o", str(folder), "--format", container]
    program = [sys.executable, "-m", "akrobat.ray_jobs", *arguments]
    report, log = tmp_path / "report.json", tmp_path / "log"
    with report.open("w") as stdout, log.open("w") as stderr:
        process = subprocess.Popen(program, stdout=stdout, stderr=stderr)
        killed: set[int] = set()
        while process.poll() is None:
            for worker in shards_being_made(folder):
                if worker not in killed and len(killed) < 3:
                    kill_with_parent(worker) if not killed else os.kill(worker, signal.SIGKILL)
                    killed.add(worker)
            time.sleep(0.05)
    assert process.returncode == 0, log.read_text()
    assert len(killed) == 3
    assert json.loads(report.read_text())["episodes"] == EPISODES
    assert contents(folder) == reference
