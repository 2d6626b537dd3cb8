"""`akrobat render` on a Ray cluster: one Ray task for each shard.

    python -m akrobat.ray_jobs drawer.h5 -o /shared/dataset [options of `akrobat render`]

Ray places the tasks, and starts a task anew when its worker or its machine dies. A shard is made
in a folder of its own and renamed into place when it is whole, and its bytes do not depend on who
made it: so nothing is lost, doubled or half-written. Inputs and output must be in folders that all
machines share.
Needs `pip install 'akrobat[ray]'`.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

from akrobat.errors import InputError, RunError

#: How often Ray tries a shard again after its worker died or it failed.
MAX_RETRIES = 3


def render(
    arguments: Sequence[str], *, cpus_per_shard: int = 1, address: str | None = None
) -> dict[str, Any]:
    """Renders with the arguments of `akrobat render` on Ray, and returns the report.

    :param arguments: trajectory file, `-o` and any options that do not share work themselves
    :param cpus_per_shard: cores of one task
    :param address: a running cluster; one on this machine where absent
    """
    try:
        import ray
    except ImportError as error:
        raise InputError("Ray is not installed: pip install 'akrobat[ray]'") from error
    shards = _akrobat([*arguments, "--dry-run"])["shards"]
    if not ray.is_initialized():
        ray.init(address=address, include_dashboard=False, log_to_driver=False)
    make = ray.remote(num_cpus=cpus_per_shard, max_retries=MAX_RETRIES, retry_exceptions=True)(
        _make_shard
    )
    ray.get([make.remote(list(arguments), shard, cpus_per_shard) for shard in range(shards)])
    return _akrobat([*arguments, "--join"])


def _make_shard(arguments: list[str], shard: int, threads: int) -> None:
    _akrobat([*arguments, "--only-shards", str(shard), "--threads", str(threads)])


def _akrobat(arguments: Sequence[str]) -> dict[str, Any]:
    """Runs `akrobat render` in a process of its own, which ends with its Ray worker."""
    command = [sys.executable, "-m", "akrobat", "--json", "--quiet", "render", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # 3: finished, with episodes that the judge had refused or that were given up.
    if done.returncode in (0, 3):
        return dict(json.loads(done.stdout))
    message = done.stderr.strip() or f"akrobat render ended with {done.returncode}"
    raise (InputError if done.returncode == 2 else RunError)(message)


def _shut_down() -> None:
    import ray

    ray.shutdown()


def main() -> int:
    """Runs the command line of this module."""
    # Ray tells of workers that died on stdout, where the report alone belongs.
    with contextlib.redirect_stdout(sys.stderr):
        report = render(sys.argv[1:])
        _shut_down()
    print(json.dumps(report, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
