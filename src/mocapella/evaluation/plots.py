"""Make and write matplotlib figures; matplotlib is optional."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mocapella.errors import SettingsError


def check_plot(path: Path) -> None:
    """Check that a figure can be written, before the work whose result it shows.

    Args:
        path: file that it will be written to, named in the error.

    Raises:
        SettingsError: matplotlib is not installed, does not know the file's ending, or the folder does not exist.
    """
    figure = new_figure(path, 1.0, 1.0)
    known = figure.canvas.get_supported_filetypes()
    if not path.parent.is_dir() or path.suffix[1:].lower() not in known:
        raise SettingsError(f"{path}: no plot can be written there; name a .png or .svg in a folder that exists")


def new_figure(path: Path, width_in: float, height_in: float) -> Any:
    """Return an empty figure with a constrained layout.

    Args:
        path: file that it will be written to, named in the error.
        width_in, height_in: size [inch].

    Raises:
        SettingsError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SettingsError(
            f"{path}: no plot, because matplotlib is not installed: uv sync --extra plots "
            "(elsewhere: install 'mocapella[plots]')"
        ) from error
    return Figure(figsize=(width_in, height_in), layout="constrained")


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure in the format that the file's name ends with.

    Raises:
        SettingsError: the file cannot be written.
    """
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise SettingsError(f"{path}: {error}; name a .png or .svg in a folder that exists") from error
