"""A picture of a study as a value, and as files whose bytes are always the same."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import msgspec

from mocapella.exports.needs import needed

FORMATS: Final = ("svg", "pdf", "png")
"""Formats that each picture is written in."""
COLOURS: Final = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442", "#000000")
"""Colours that colour-blind people tell apart (Okabe and Ito, 2008)."""
HATCHES: Final = ("", "///", "...", "xxx", "\\\\\\", "ooo", "+++", "---")
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
LINES: Final = ("-", "--", "-.", ":")
HEAT: Final = "viridis"
"""Colour map of heat maps: its brightness grows steadily, also in grey."""
_STYLE: Final = {
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "legend.fontsize": 7.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "hatch.linewidth": 0.6,
    "legend.frameon": False,
    "svg.hashsalt": "mocapella",
    "pdf.fonttype": 42,
}
_METADATA: Final[dict[str, dict[str, Any]]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}

_CANVASES: Final = {
    "svg": ("matplotlib.backends.backend_svg", "FigureCanvasSVG"),
    "pdf": ("matplotlib.backends.backend_pdf", "FigureCanvasPdf"),
    "png": ("matplotlib.backends.backend_agg", "FigureCanvasAgg"),
}
_DPI: Final = 200
"""Resolution of pixels [dots per inch]."""


class StudyPicture(msgspec.Struct, frozen=True, eq=False):
    """One picture.

    Attributes:
        name: stem of its files.
        title: its heading, without the compared method and views.
        caption: the drawn quantity and its computation, in one or two sentences.
        about: the method and its views, or what else it is about.
        files: content by format, of `FORMATS`.
    """

    name: str
    title: str
    caption: str
    about: str
    files: dict[str, bytes]


@contextmanager
def drawing() -> Iterator[None]:
    """Draw in the style of these pictures, whatever the user's settings of matplotlib are.

    Raises:
        SettingsError: matplotlib is not installed; names the extra.
    """
    matplotlib = needed("matplotlib", extra="studies")
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def empty_figure(width_in: float, height_in: float) -> Any:
    """Return an empty figure of this size [inch]; call it within `drawing`."""
    return needed("matplotlib.figure", extra="studies").Figure(figsize=(width_in, height_in), layout="constrained")


def rendered(figure: Any, formats: Sequence[str] = FORMATS) -> dict[str, bytes]:
    """Return a figure's content by format, all in one layout; call it within `drawing`."""
    figure.dpi = _DPI
    figure.get_layout_engine().execute(figure)
    figure.set_layout_engine("none")  # the layout takes longer than the drawing
    files = {}
    for name in formats:
        module, canvas = _CANVASES[name]
        content = io.BytesIO()
        made = getattr(needed(module, extra="studies"), canvas)(figure)
        figure.dpi = _DPI  # vector formats set their own
        getattr(made, f"print_{name}")(content, metadata=_METADATA[name])  # `savefig` would draw twice
        files[name] = content.getvalue()
    return files


def file_stem(*words: str) -> str:
    """Return a stem for a picture's files: the words in lower case, nothing but ASCII letters, digits and hyphens."""
    kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in "-".join(words).lower())
    return "-".join(part for part in kept.split("-") if part)
