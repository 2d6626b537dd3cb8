"""What stands in a policy folder; needs no PyTorch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from akrobat.errors import InputError

FORMAT = "akrobat.policy"


def describe(folder: Path) -> dict[str, Any]:
    """What is known of a policy folder.

    :raise InputError: where it holds none
    """
    file = folder / "policy.json"
    try:
        description: dict[str, Any] = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot read: {error}") from error
    if description.get("format") != FORMAT:
        raise InputError(f"{file}: expected the format {FORMAT}, got {description.get('format')}")
    return description
