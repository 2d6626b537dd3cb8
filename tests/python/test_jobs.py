"""Any number of processes make the same dataset, whichever of them die."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import akrobat
import pytest

REPOSITORY = Path(__file__).parents[2]
RIG = REPOSITORY / "tests" / "rigs" / "tiny.toml"
EPISODES = 6


class Job:
    """`akrobat render` of six trajectories into shards of one, the same but for its output."""

    def __init__(self, folder: Path, assets: Path) -> None:
        task = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
        file = folder / "six.h5"
        akrobat.plan(task, file, limit=EPISODES, assets=[assets], quiet=True)
        inputs = [file, "--assets", assets, "--rig", RIG, "--backend", "soft"]
        options = ["--phases", "manipulate", "--episodes-per-shard", 1]
        self.arguments = list(map(str, [*inputs, *options]))

    def command(self, output: Path, *more: str) -> list[str]:
        program = [sys.executable, "-m", "akrobat", "--json", "render"]
        return [*program, *self.arguments, "-o", str(output), *more]

    def run(self, output: Path, *more: str) -> dict[str, int]:
        done = subprocess.run(
            self.command(output, *more), capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return dict(json.loads(done.stdout))


@pytest.fixture(scope="module")
def job(shared_assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("job"), shared_assets)


@pytest.fixture(scope="module")
def whole(job: Job, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What one process writes that nobody disturbs."""
    folder = tmp_path_factory.mktemp("whole") / "dataset"
    job.run(folder)
    found = contents(folder)
    assert len(found) == EPISODES + 2
    return found


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_workers_make_the_same_bytes(job: Job, whole: dict[str, bytes], tmp_path: Path) -> None:
    folder = tmp_path / "dataset"
    report = job.run(folder, "--workers", "3")
    assert report["episodes"] == EPISODES
    assert contents(folder) == whole
    # Once more changes nothing.
    assert job.run(folder, "--join")["by_this_process"] == 0
    assert contents(folder) == whole


def test_workers_may_die_at_any_time(job: Job, whole: dict[str, bytes], tmp_path: Path) -> None:
    folder, chance = tmp_path / "dataset", random.Random(7)
    command = job.command(folder, "--join", "--threads", "1")
    workers = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(2)]
    for _ in range(3):
        time.sleep(chance.uniform(0.1, 1.5))
        worker = workers.pop(0)
        worker.send_signal(signal.SIGKILL)
        worker.wait()
        workers.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))
    for worker in workers:
        worker.wait(timeout=300)
    # Should all have died, one more finishes.
    job.run(folder, "--join")
    assert contents(folder) == whole


def test_schedulers_deal_out_shards(job: Job, whole: dict[str, bytes], tmp_path: Path) -> None:
    folder = tmp_path / "dataset"
    assert job.run(folder, "--dry-run")["shards"] == EPISODES
    job.run(folder, "--only-shards", "4-5")
    job.run(folder, "--only-shards", "0,5")
    assert not (folder / "manifest.jsonl").exists()
    assert job.run(folder, "--join")["by_this_process"] == EPISODES - 3
    assert contents(folder) == whole


def test_another_job_in_the_folder_is_refused(job: Job, tmp_path: Path) -> None:
    folder = tmp_path / "dataset"
    job.run(folder, "--only-shards", "0")
    another = job.command(folder, "--join", "--episodes", "0-2")
    refused = subprocess.run(another, capture_output=True, text=True, check=False)
    assert refused.returncode == 2, refused.stderr
    assert "another job" in refused.stderr


def test_a_lone_run_and_a_job_exclude_each_other(job: Job, tmp_path: Path) -> None:
    folder = tmp_path / "dataset"
    process = subprocess.Popen(job.command(folder), stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not (folder / "dataset.json").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGSTOP)
    for more in (["--join"], ["--resume"]):
        refused = subprocess.run(
            job.command(folder, *more), capture_output=True, text=True, check=False
        )
        assert refused.returncode == 2, refused.stderr
    os.kill(process.pid, signal.SIGCONT)
    assert process.wait(timeout=300) == 0


def test_slurm_scripts_name_every_shard(job: Job, tmp_path: Path) -> None:
    script = tmp_path / "job.sh"
    job.run(tmp_path / "dataset", "--slurm", str(script))
    text = script.read_text()
    assert f"#SBATCH --array=0-{EPISODES - 1}\n" in text
    assert subprocess.run(["bash", "-n", script], check=False).returncode == 0
    # The task runs as it stands there.
    environment = {**os.environ, "SLURM_ARRAY_TASK_ID": "2"}
    subprocess.run(["bash", script], env=environment, check=True, capture_output=True)
    assert (tmp_path / "dataset" / ".job" / "parts" / "000002" / "manifest.jsonl").is_file()
