"""Real distributions of Python packages in a folder, as an installer leaves them: modules and a dist-info."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def distribution(
    folder: Path,
    name: str,
    entry_points: Mapping[str, Mapping[str, str]],
    modules: Mapping[str, str] | None = None,
    version: str = "1.0",
) -> Path:
    """Lay out a package.

    Args:
        folder: to be put on `sys.path`.
        name: of the distribution.
        entry_points: ``module:name`` by group and name.
        modules: source text by path.
        version: of the distribution.
    """
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8")
    with (info / "entry_points.txt").open("w", encoding="utf-8") as file:
        for group, of in entry_points.items():
            file.write(f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in of.items()))
    for path, text in (modules or {}).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return folder


HEADER = "from mocapella.sources.source import Source\n"
_SOURCE = 'Source(interface={interface}, name="{name}", summary="Lamps.", frame_types=(), command="{command}")'


def source_text(name: str, *, interface: int = 1, command: str = "lamps:command", as_name: str = "SOURCE") -> str:
    """A module's text that describes a source."""
    return f"{HEADER}{as_name} = {_SOURCE.format(interface=interface, name=name, command=command)}\n"


GOOD = {"good": "good_lamp:SOURCE"}
GOOD_MODULES = {
    "good_lamp.py": source_text("good", command="good_command:run"),
    "good_command.py": "def run(loud: bool = False) -> None:\n    '''Serve a lamp.'''\n    print('lamp', loud)\n",
}
BAD = {
    "absent": ("no_such_module_of_lamps:SOURCE", "cannot be imported (ModuleNotFoundError: No module named"),
    "leaving": ("leaving_lamp:SOURCE", "cannot be imported (SystemExit: 3)"),
    "nameless": ("good_lamp:LAMP", "cannot be imported (AttributeError"),
    "simulate": ("good_lamp:SOURCE", "mocapella 0.1.0 has this name; uninstall one of the two"),
    "later": ("later_lamp:SOURCE", "written for interface 2, and this Mocapella has 1; update"),
    "other": ("mocapella.schema.frame_types:ARMS", "is a FrameType, not a Source; update"),
    "renamed": ("good_lamp:SOURCE", "calls itself 'good'; its package must register that name"),
}
"""Sources that cannot be used: reference, and what is said of them."""
BAD_MODULES = {"leaving_lamp.py": "raise SystemExit(3)\n", "later_lamp.py": source_text("later", interface=2)}


def lamps(folder: Path) -> Path:
    """A distribution with a good source, every kind of bad one, and a group that there is not."""
    points = {
        "mocapella.sources": {**GOOD, **{name: reference for name, (reference, _) in BAD.items()}},
        "mocapella.source": {"typed-wrong": "good_lamp:SOURCE"},
    }
    return distribution(folder, "lamps", points, {**GOOD_MODULES, **BAD_MODULES})
