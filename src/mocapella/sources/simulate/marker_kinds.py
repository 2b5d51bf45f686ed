"""Kinds of fingertip markers for `mocapella.sources.simulate.marker_scene`: shape, material and gloss.

All sizes are factors of the fingertip's radius, which is about 7 mm. The numbers are ours: they were chosen from how
such markers look, not measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class MarkerKind:
    """Shape and gloss of a kind of fingertip marker.

    Attributes:
        half: half axes across and along the finger.
        back: distance of the centre from the middle of the finger's round end, towards the palm.
        tube: whether it is a tube with straight ends around the finger; otherwise an ellipse of colour on it.
        border: half axes of a grey ellipse beneath it; None for no border.
        gloss: gloss of the colour; None takes the paint's.
        shine: exponent of the highlight; a larger one is a smaller highlight.
    """

    half: tuple[float, float]
    back: float = 0.0
    tube: bool = False
    border: tuple[float, float] | None = None
    gloss: float | None = None
    shine: float = 30.0


MARKER_KINDS: Final = {
    "painted": MarkerKind((1.02, 1.3)),
    "grey-bordered": MarkerKind((0.78, 1.2), back=0.15, border=(1.04, 1.7)),
    "shrink-tube": MarkerKind((1.08, 1.5), back=0.6, tube=True, gloss=0.5, shine=40.0),
    "nail": MarkerKind((0.62, 0.8), back=0.25, gloss=0.9, shine=90.0),
}
"""Paint over the fingertip; paint with a border of grey paint; shrink tube, open at the end; varnish on the nail."""
GREY: Final = (0.18, 0.18, 0.18)
"""Reflectance of the grey border: matt, between skin and dark paint in brightness."""
