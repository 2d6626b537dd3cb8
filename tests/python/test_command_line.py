"""The installed command is the same command line as the Rust binary's."""

import json
import subprocess
import sys

import pytest
from akrobat import _core


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "akrobat", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_prints_schemas() -> None:
    result = run("schema", "rig", "--json")
    assert result.returncode == 0
    assert json.loads(result.stdout)["title"] == "Rig"


@pytest.mark.parametrize("arguments", [["juggle"], ["schema", "--check", "/nonexistent"]])
def test_bad_usage_exits_with_2(arguments: list[str]) -> None:
    result = run(*arguments)
    assert result.returncode == 2
    assert "error:" in result.stderr
    assert result.stdout == ""


def test_runs_inside_a_process_too(capfd: pytest.CaptureFixture[str]) -> None:
    assert _core.run(["akrobat", "schema", "robot"]) == 0
    assert json.loads(capfd.readouterr().out)["title"] == "RobotFile"
