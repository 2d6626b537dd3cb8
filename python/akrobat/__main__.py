"""The `akrobat` command."""

import sys

from akrobat import _core


def main() -> int:
    """Runs the command line of this process and returns its exit code."""
    return _core.run(["akrobat", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
