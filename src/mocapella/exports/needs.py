"""Optional libraries, imported when an export needs one."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from mocapella.errors import SettingsError


def needed(module: str, *, extra: str = "exports") -> Any:
    """Import a library of one of the package's extras.

    Raises:
        SettingsError: it is not installed; says how to install it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:  # it is installed, and one that it needs is not
            raise SettingsError(f"{module} cannot be imported: {error}; install it again") from error
        raise SettingsError(
            f"{module.partition('.')[0]} is not installed: uv sync --extra {extra} (elsewhere: install "
            f"'mocapella[{extra}]')"
        ) from error
