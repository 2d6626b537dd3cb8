"""Success against the number of training trajectories, as a plot."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

from akrobat.errors import InputError

COLORS = {"seen": "#4269d0", "unseen": "#ff725c"}


def points(folders: list[Path]) -> list[dict[str, Any]]:
    """One point for each folder of trials and split, by number of trajectories."""
    found = []
    for folder in folders:
        try:
            summary = json.loads((folder / "summary.json").read_text())
            with open(folder / "trials.csv", newline="", encoding="utf-8") as table:
                rows = list(csv.DictReader(table))
        except (OSError, ValueError) as error:
            raise InputError(f"{folder}: no finished trials of akrobat eval: {error}") from error
        if "trajectories" not in summary:
            raise InputError(f"{folder}: its policy {summary['policy']} was not trained here")
        for split in sorted({row["split"] for row in rows}):
            own = [row for row in rows if row["split"] == split]
            succeeded = sum(int(row["success"]) for row in own)
            low, high = wilson(succeeded, len(own))
            found.append(
                {
                    "trajectories": summary["trajectories"],
                    "split": split,
                    "succeeded": succeeded,
                    "trials": len(own),
                    "low": low,
                    "high": high,
                }
            )
    return sorted(found, key=lambda point: (point["split"], point["trajectories"]))


def wilson(succeeded: int, trials: int) -> tuple[float, float]:
    """The 95% interval of a rate (Wilson 1927)."""
    z = 1.96
    rate = succeeded / trials
    middle = rate + z * z / (2 * trials)
    spread = z * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    scale = 1.0 + z * z / trials
    return max((middle - spread) / scale, 0.0), min((middle + spread) / scale, 1.0)


def plot(found: list[dict[str, Any]]) -> str:
    """The curve as SVG, with 95% intervals; the horizontal axis is logarithmic."""
    counts = sorted({point["trajectories"] for point in found})
    left, width, top, height = 60.0, 480.0, 40.0, 240.0
    first, last = math.log(counts[0]), math.log(max(counts[-1], counts[0] + 1))

    def x(count: int) -> float:
        return left + width * (math.log(count) - first) / (last - first)

    def y(rate: float) -> float:
        return top + height * (1.0 - rate)

    lines = []
    for percent in (0, 25, 50, 75, 100):
        at = y(percent / 100)
        lines.append(
            f'<line x1="{left}" y1="{at}" x2="{left + width}" y2="{at}" stroke="#d8dbe0"/>'
            f'<text x="{left - 8}" y="{at + 4}" text-anchor="end">{percent}%</text>'
        )
    for count in counts:
        lines.append(
            f'<text x="{x(count):.1f}" y="{top + height + 18}" text-anchor="middle">{count}</text>'
        )
    for number, split in enumerate(sorted({point["split"] for point in found})):
        own = [point for point in found if point["split"] == split]
        color = COLORS[split]
        path = " ".join(
            f"{x(p['trajectories']):.1f},{y(p['succeeded'] / p['trials']):.1f}" for p in own
        )
        lines.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        for p in own:
            at, rate = x(p["trajectories"]), p["succeeded"] / p["trials"]
            lines.append(
                f'<line x1="{at:.1f}" y1="{y(p["low"]):.1f}" x2="{at:.1f}" '
                f'y2="{y(p["high"]):.1f}" stroke="{color}"/>'
                f'<circle cx="{at:.1f}" cy="{y(rate):.1f}" r="4" fill="{color}"/>'
            )
        lines.append(
            f'<text x="{left + width - 110}" y="{top + height - 34 + 16 * number}" '
            f'fill="{color}">{split} starts</text>'
        )
    lines.append(
        f'<text x="{left + width / 2}" y="{top + height + 40}" text-anchor="middle">'
        "training trajectories</text>"
    )
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 580 330" '
        'font-family="system-ui, sans-serif" font-size="12">\n'
        '<rect width="580" height="330" fill="white"/>\n'
        '<text x="60" y="22" font-weight="600">Trials that succeed (95% intervals)</text>\n'
        + "\n".join(lines)
        + "\n</svg>\n"
    )
