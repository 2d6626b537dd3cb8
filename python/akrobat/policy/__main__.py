"""The commands `train` and `curve`."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

from akrobat.errors import AkrobatError, InputError


def main(argv: list[str] | None = None) -> int:
    """Runs a command and returns the exit code: 2 for bad input."""
    arguments = _parser().parse_args(argv)
    try:
        result: dict[str, Any] = arguments.run(arguments)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except AkrobatError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(json.dumps(result, indent=2) if arguments.json else result["text"])
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m akrobat.policy", description="Train a small policy on rendered datasets."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    train = commands.add_parser(
        "train",
        help="train on the first episodes of datasets",
        epilog="example: python -m akrobat.policy train data --trajectories 50 -o policy_50; "
        "then: akrobat eval TASK.toml --policy policy_50 --trajectories TRAJ.h5 -o trials",
    )
    train.add_argument("dataset", nargs="+", type=Path, help="folders that akrobat render wrote")
    train.add_argument("--trajectories", type=int, required=True, help="how many episodes to use")
    train.add_argument("-o", "--output", type=Path, required=True, help="policy folder to write")
    train.add_argument("--config", type=Path, help="settings as JSON; see --show-config")
    train.add_argument("--steps", type=int, help="gradient steps")
    train.add_argument("--seed", type=int, default=0, help="of weights and noise")
    train.add_argument("--threads", type=int, help="threads of PyTorch")
    train.add_argument("--json", action="store_true", help="print one JSON document")
    train.set_defaults(run=_train)
    curve = commands.add_parser(
        "curve", help="plot success against the number of training trajectories"
    )
    curve.add_argument("trials", nargs="+", type=Path, help="folders that akrobat eval wrote")
    curve.add_argument("-o", "--output", type=Path, required=True, help="SVG to write")
    curve.add_argument("--json", action="store_true", help="print one JSON document")
    curve.set_defaults(run=_curve)
    return parser


def _train(arguments: argparse.Namespace) -> dict[str, Any]:
    try:
        import torch
    except ImportError as error:
        raise AkrobatError(
            f"training needs PyTorch: pip install 'akrobat[policy]' ({error})"
        ) from error
    from akrobat.policy.data import demonstrations
    from akrobat.policy.folder import FORMAT
    from akrobat.policy.training import save, train

    config = _config(arguments)
    if arguments.output.exists():
        raise InputError(f"{arguments.output}: exists already; choose another with -o")
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    episodes, source = demonstrations(arguments.dataset, arguments.trajectories)
    frames = sum(len(episode.state) for episode in episodes)
    started, last = time.process_time(), 0.0

    def report(step: int, loss: float) -> None:
        nonlocal last
        last = loss
        if sys.stderr.isatty():
            print(f"\rstep {step} of {config.steps}, loss {loss:.4f}", end="", file=sys.stderr)

    network, features, scaling = train(episodes, source, config, report)
    cpu_s = time.process_time() - started
    description = {
        "format": FORMAT,
        "format_version": 1,
        "joints": source.joints,
        "rate_hz": source.rate_hz,
        "rig": source.rig,
        "cloud": source.cloud,
        "trajectories": len(episodes),
        "frames": frames,
        "config": dataclasses.asdict(config),
        "loss": last,
    }
    save(arguments.output, network, features, scaling, description)
    text = (
        f"{arguments.output}: {len(episodes)} trajectories, {frames} frames, "
        f"{config.steps} steps, loss {last:.4f}, {cpu_s:.0f} CPU s"
    )
    return {**description, "cpu_s": cpu_s, "text": text}


def _config(arguments: argparse.Namespace) -> Any:
    from akrobat.policy.training import TrainingConfig

    values: dict[str, Any] = {}
    if arguments.config:
        try:
            values = dict(json.loads(arguments.config.read_text()))
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"{arguments.config}: cannot read: {error}") from error
    known = {field.name for field in dataclasses.fields(TrainingConfig)}
    if wrong := sorted(values.keys() - known):
        choices = ", ".join(sorted(known))
        raise InputError(f"{arguments.config}: unknown key {wrong[0]}; valid choices: {choices}")
    values["seed"] = arguments.seed
    if arguments.steps is not None:
        values["steps"] = arguments.steps
    config = TrainingConfig(**values)
    for name in ("steps", "batch", "chunk", "stride", "executed", "cloud_interval"):
        if not isinstance(getattr(config, name), int) or getattr(config, name) < 1:
            raise InputError(f"{name}: expected a whole number from 1, got {getattr(config, name)}")
    if config.executed > config.chunk:
        raise InputError(
            f"executed: expected at most chunk = {config.chunk}, got {config.executed}"
        )
    return config


def _curve(arguments: argparse.Namespace) -> dict[str, Any]:
    from akrobat.policy.curve import plot, points

    found = points(arguments.trials)
    arguments.output.write_text(plot(found), encoding="utf-8")
    lines = [
        f"{p['trajectories']}: {p['succeeded']} of {p['trials']} ({p['split']})" for p in found
    ]
    return {"points": found, "text": "\n".join([*lines, str(arguments.output)])}


if __name__ == "__main__":
    sys.exit(main())
