"""Runs that are interrupted, or that run out of disk, leave nothing half-written."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import akrobat
import h5py
import pytest
from mcap.reader import make_reader

REPOSITORY = Path(__file__).parents[2]
TASK = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
RIG = """
name = "small"

[[cameras]]
name = "fixed"
width = 160
height = 120
focal_mm = 50.0
mount = { on = "look_at_handle", offset = [1.6, 0.8, 0.9] }
"""
SUFFIX = {"hdf5": ".hdf5", "mcap": ".mcap"}
#: Longest time that any wait may take, seconds.
PATIENCE_S = 120
INTERRUPTED = "interrupted: "

Contents = dict[str, bytes]


class RenderJob:
    """`akrobat render` of two trajectories, the same but for its output."""

    def __init__(self, trajectories: Path, assets: Path, rig: Path) -> None:
        self._inputs = [str(trajectories), "--assets", str(assets), "--rig", str(rig)]

    def command(
        self, output: Path, container: str, *more: str, phases: str = "manipulate"
    ) -> list[str]:
        options = ["--backend", "soft", "--phases", phases, "--format", container]
        program = [sys.executable, "-m", "akrobat", "render"]
        return [*program, *self._inputs, "-o", str(output), *options, "--threads", "1", *more]


@pytest.fixture(scope="module")
def job(
    drawer_file: Path, shared_assets: Path, tmp_path_factory: pytest.TempPathFactory
) -> RenderJob:
    rig = tmp_path_factory.mktemp("rig") / "small.toml"
    rig.write_text(RIG)
    return RenderJob(drawer_file, shared_assets, rig)


@pytest.fixture(scope="module")
def whole(job: RenderJob, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Contents]:
    """What runs that nobody disturbs write, by container."""
    folder = tmp_path_factory.mktemp("whole")
    for container in SUFFIX:
        subprocess.run(job.command(folder / container, container), check=True, capture_output=True)
    datasets = {container: contents(folder / container) for container in SUFFIX}
    assert len(datasets["mcap"]) == len(datasets["hdf5"]) + 1 == 4
    return datasets


def contents(folder: Path) -> Contents:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module", autouse=True)
def ctrl_c_is_heard() -> Iterator[None]:
    """Shells have what they start in the background ignore ctrl-c, and children inherit that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def start(command: list[str]) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def wait_until(reached: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not reached():
        assert process.poll() is None, f"it ended first: {process.communicate()}"
        assert time.monotonic() < deadline, "not reached in time"
        time.sleep(0.002)


def disturb(process: subprocess.Popen[str], number: signal.Signals) -> tuple[int, str]:
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE_S)
    return process.returncode, errors


def begun(folder: Path) -> bool:
    return (folder / "dataset.json").exists()


def drawing(folder: Path) -> bool:
    """A shard is being written and has some content."""
    return any(path.stat().st_size > 0 for path in partial_files(folder))


def partial_files(folder: Path) -> list[Path]:
    return list(folder.glob("shards/*.partial"))


def finished_one(folder: Path) -> bool:
    return any(path.suffix in SUFFIX.values() for path in folder.glob("shards/*"))


def is_complete(folder: Path) -> bool:
    return bool(json.loads((folder / "dataset.json").read_text())["complete"])


def check_shards_are_whole(folder: Path, reference: Contents) -> None:
    """Every file under its final name is readable, and is what it will be in the end."""
    for path in folder.glob("shards/*"):
        if path.suffix == ".partial":
            continue
        assert path.read_bytes() == reference[f"shards/{path.name}"]
        if path.suffix == ".hdf5":
            with h5py.File(path, "r") as file:
                assert len(file["data"]) > 0
        else:
            with open(path, "rb") as stream:
                assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) > 0
    manifest = folder / "manifest.jsonl"
    lines = manifest.read_text().splitlines() if manifest.exists() else []
    for stored in (json.loads(line)["stored"] for line in lines):
        content = (folder / stored["shard"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == stored["shard_sha256"]


def check_resumes(
    job: RenderJob, folder: Path, container: str, reference: Contents
) -> dict[str, int]:
    command = [*job.command(folder, container, "--resume"), "--json"]
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert contents(folder) == reference
    report: dict[str, int] = json.loads(result.stdout)
    return report


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["killed", "ctrl-c"])
@pytest.mark.parametrize(
    "place",
    [("hdf5", begun), ("hdf5", drawing), ("mcap", drawing), ("mcap", finished_one)],
    ids=["hdf5-begun", "hdf5-drawing", "mcap-drawing", "mcap-finished-one"],
)
def test_interrupted_renderings_resume(
    job: RenderJob,
    whole: dict[str, Contents],
    tmp_path: Path,
    place: tuple[str, Callable[[Path], bool]],
    number: signal.Signals,
) -> None:
    container, instant = place
    folder, reference = tmp_path / "dataset", whole[container]
    process = start(job.command(folder, container))
    wait_until(lambda: instant(folder), process)
    status, errors = disturb(process, number)
    if number == signal.SIGKILL:
        assert status == -signal.SIGKILL
    else:
        assert status == 1, errors
        assert INTERRUPTED in errors
        assert str(folder) in errors
        assert "--resume" in errors
        assert not partial_files(folder)
    assert contents(folder) != reference, "it was finished before it could be interrupted"
    check_shards_are_whole(folder, reference)
    if begun(folder):
        assert not is_complete(folder)
    stored = len(list(folder.glob("shards/*" + SUFFIX[container])))
    report = check_resumes(job, folder, container, reference)
    if instant is finished_one:
        # What was whole was kept.
        assert report["resumed"] >= stored - 1
        assert report["resumed"] + report["episodes"] == 2


def test_resuming_notices_another_configuration(
    job: RenderJob, whole: dict[str, Contents], tmp_path: Path
) -> None:
    folder = tmp_path / "dataset"
    for name, content in whole["hdf5"].items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    command = job.command(folder, "hdf5", "--resume", phases="all")
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    assert result.returncode == 2, result.stderr
    assert str(folder) in result.stderr
    assert contents(folder) == whole["hdf5"]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["killed", "ctrl-c"])
@pytest.mark.parametrize("delay_s", [0.5, 3.0])
def test_interrupted_plans_write_nothing(
    shared_assets: Path, tmp_path: Path, number: signal.Signals, delay_s: float
) -> None:
    output = tmp_path / "trajectories.h5"
    command = [sys.executable, "-m", "akrobat", "plan", str(TASK), "-o", str(output)]
    process = start([*command, "--assets", str(shared_assets), "--limit", "5000"])
    time.sleep(delay_s)
    assert process.poll() is None
    status, errors = disturb(process, number)
    assert not list(tmp_path.iterdir())
    if number == signal.SIGINT:
        assert status == 1, errors
        assert INTERRUPTED in errors


def test_ctrl_c_reaches_python_callers(
    drawer_file: Path, shared_assets: Path, tmp_path: Path
) -> None:
    """In the Python API, Ctrl-C is a KeyboardInterrupt and leaves whole shards too."""
    folder = tmp_path / "dataset"
    program = (
        "import akrobat, sys\n"
        "try:\n"
        "    akrobat.render(sys.argv[1], sys.argv[2], backend='soft', assets=[sys.argv[3]])\n"
        "except KeyboardInterrupt:\n"
        "    print('stopped', file=sys.stderr)\n"
        "    sys.exit(7)\n"
    )
    inputs = map(str, (drawer_file, folder, shared_assets))
    process = start([sys.executable, "-c", program, *inputs])
    wait_until(lambda: drawing(folder), process)
    status, errors = disturb(process, signal.SIGINT)
    assert (status, errors.splitlines()[-1]) == (7, "stopped"), errors
    assert not partial_files(folder)
    assert not is_complete(folder)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of one megabyte."""
    folder = tmp_path / "small_disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or not shutil.which("mount"):
        pytest.skip("only root can mount a small file system")
    if subprocess.run(mount, check=False, capture_output=True).returncode != 0:
        pytest.skip("no file system can be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("container", list(SUFFIX))
def test_a_full_disk_is_a_failure(job: RenderJob, small_disk: Path, container: str) -> None:
    folder = small_disk / "dataset"
    command = job.command(folder, container)
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    assert result.returncode == 1, result.stderr
    assert "error: " in result.stderr
    assert str(folder) in result.stderr
    assert "space" in result.stderr.lower()
    assert not list(folder.glob("shards/*"))
    assert not is_complete(folder)


def test_a_full_disk_leaves_no_trajectory_file(drawer_file: Path, small_disk: Path) -> None:
    free = shutil.disk_usage(small_disk).free - drawer_file.stat().st_size // 2
    (small_disk / "filler").write_bytes(bytes(free))
    with pytest.raises(akrobat.RunError, match=r"trajectories\.h5"):
        akrobat.Trajectories.read(drawer_file).write(small_disk / "trajectories.h5")
    assert [path.name for path in small_disk.iterdir()] == ["filler"]
    (small_disk / "filler").unlink()
    akrobat.Trajectories.read(drawer_file).write(small_disk / "trajectories.h5")


@pytest.mark.parametrize("verb", ["plan", "render"])
def test_an_unwritable_output_is_bad_input(
    shared_assets: Path, drawer_file: Path, tmp_path: Path, verb: str
) -> None:
    # Permissions do not stop root, but nobody can create anything below a file.
    below_a_file = tmp_path / "file" / "output"
    below_a_file.parent.write_text("not a folder")
    source = TASK if verb == "plan" else drawer_file
    command = [sys.executable, "-m", "akrobat", verb, str(source), "-o", str(below_a_file)]
    command += ["--assets", str(shared_assets)]
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    assert result.returncode == 2
    assert str(below_a_file) in result.stderr
    assert "cannot write" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
