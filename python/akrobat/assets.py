"""Where installed packages keep robots."""

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path


def installed_asset_folders() -> list[Path]:
    """Folders of robot descriptions that are installed beside this package."""
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        return []
    # The package is C++ and data: its shared files lie below a prefix of their own.
    folder = Path(str(package.locate_file("cmeel.prefix/share/example-robot-data")))
    return [folder] if folder.is_dir() else []
