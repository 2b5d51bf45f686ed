"""Decide which landmarks of the limbs images support, by the evidence beside the model's outline.

The overlap with the region that was segmented does not tell: where an image says nothing, that region is the model's.
So the evidence is counted: along the model's outline near a landmark, the image must have its contour there, too, and
the pixels on both sides must be likelier on their own side than on the other.

An image *shows* a landmark if there is enough of this evidence. Edges of other things are evidence, too, where they lie
along the outline by chance. So images *support* a landmark only if two of them show it, if all together have evidence
at most of its outline, and not counting edges of the room (`sensing/room_edges.py`). An arm must be *distinct*, too:
there must be more edges at its outline than at the outlines of the same arm elsewhere nearby.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.kinematics.silhouette_fit import Outline
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import limbs_of

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

NEAR_M: Final = 0.2
"""Largest distance of a landmark's evidence from it, along its limb [m]."""
LEAST_M: Final = 0.12
"""Least length of outline with evidence, over all cameras that count, that supports a landmark [m]."""
LEAST_SHARE: Final = 0.5
"""A camera counts if this share of a landmark's outline in its image has evidence: edges of other things cross it."""
OVERALL: Final = 0.55
"""Least share of a landmark's outline in all images together that has evidence, for its support. A limb that is
elsewhere is confirmed by some images, by edges of other things, and by most of them hardly ever."""
DISTINCT: Final = 0.28
"""Least excess of the share of edges at an arm's outline over that at its outlines elsewhere, for its support [ratio].
Edges about legs are too many for that: those of furniture, and of the other leg."""
ELSEWHERE_M: Final = np.concatenate([
    0.1 / np.sqrt(3.0) * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64),
    0.15 * np.concatenate([np.eye(3), -np.eye(3)]),
])  # fmt: skip
"""(14, 3) displacements of an arm to the places elsewhere, world [m]."""
ARM_ENDS: Final = ("elbow", "wrist")
"""Ends of the names of landmarks of an arm."""
FEWEST_CAMERAS: Final = 2
"""Least number of cameras that count, if there are so many: in a single one, the distance of a limb is unknown."""
FEWEST_M: Final = 0.04
"""Least length of outline with evidence of a camera that counts for `FEWEST_CAMERAS` [m]."""
LEAST_NATS: Final = 1.0
"""Least evidence of a point of the outline; where both sides look alike it is about 0 [nats]."""
BESIDE_STEPS: Final = 1.5
"""Distance from the outline of the samples that are compared, inwards and outwards [samples]."""
FITS_STEPS: Final = 2.0
"""Largest distance of the image's contour from the model's outline [samples]."""
MOST_NATS: Final = 10.0
"""Bound of a sample's evidence, for and against [nats]."""
LASTS_S: Final = 0.5
"""Duration without support after which it is reported; limbs pass before the body for less [s]."""


class OutlineEvidence(msgspec.Struct, frozen=True, eq=False):
    """How clearly one image shows the model's outline.

    Attributes:
        outline: the model's outline.
        nats: (n,) evidence for each of its points, of `evidence_at` [nats].
        lengths_m: (n,) length of the outline that each point represents, on the body [m].
        open: (n,) whether the image could show the outline at a point: within the image, and not where another person
            is. None: everywhere.
        room: (n,) whether the image's edge at a point is one of the room. None: nowhere.
        excess: (n,) whether the image has an edge at a point, 0 or 1, less the share of places of the outline elsewhere
            at which it has one, of `sensing/edges_elsewhere.py`; NaN where that is not measured. None: nowhere.
    """

    outline: Outline
    nats: Float64
    lengths_m: Float64
    open: Bool | None = None
    room: Bool | None = None
    excess: Float64 | None = None

    @property
    def shown(self) -> float:
        """Share of the model's outline that the image shows, 0 to 1; NaN if the image has none of it."""
        whole = float(self.lengths_m.sum())
        return float(self.lengths_m[self.nats >= LEAST_NATS].sum()) / whole if whole > 0 else float("nan")


class LimbSupport:
    """Measures which landmarks of one body's limbs the images support.

    Args:
        mesh: the body's mesh; landmarks that are on no limb, such as hips and shoulders, are not judged.
        least_nats: least evidence of a point of the outline [nats].

    Attributes:
        parts: for each landmark, the parts whose outline counts for it; empty for landmarks that are not judged.
        arms: (parts,) bool, the parts of arms, whose landmarks must be distinct.
    """

    def __init__(self, mesh: RiggedMesh, least_nats: float = LEAST_NATS) -> None:
        self._least_nats = least_nats
        parents = mesh.tree.parents
        chains = [parts for _, parts in limbs_of(mesh.tree)]
        ends = [
            parts.tolist()
            for parts in chains
            if len(parts) > 1 and not np.isin(parents[np.setdiff1d(np.arange(len(parents)), parts)], parts).any()
        ]
        of = {part: chain[k : k + 2] for chain in ends for k, part in enumerate(chain)}
        self.parts = [of.get(mark.part, []) for mark in mesh.landmarks.values()]
        self._part = np.array([mark.part for mark in mesh.landmarks.values()], np.int64)
        counts = [np.isin(np.arange(len(parents)), some) for some in self.parts]
        self._counts = np.array(counts, np.bool_).reshape(len(counts), len(parents))
        self._judged = self._counts.any(axis=1)
        arm_marks = [mark.part for name, mark in mesh.landmarks.items() if name.endswith(ARM_ENDS)]
        in_arms = [part for chain in ends if np.isin(chain, arm_marks).any() for part in chain]
        self.arms = np.isin(np.arange(len(parents)), in_arms)
        self._of_arm = self._judged & self.arms[self._part]
        self._count = len(parents)

    def supported(self, landmarks: Float64, evidence: Sequence[OutlineEvidence]) -> Bool:
        """Return whether images support each landmark (n,); True for all that are not judged.

        Fewer than `FEWEST_CAMERAS` images support what they show.

        Args:
            landmarks: (n, 3) in the world [m].
            evidence: that of each camera that sees the body.
        """
        whole, sure = (np.zeros((len(evidence), len(landmarks))) for _ in range(2))
        excess, measured = (np.zeros(len(landmarks)) for _ in range(2))
        for row, one in enumerate(evidence):
            counts = np.ones(len(one.nats), np.bool_) if one.open is None else one.open
            clear = one.nats >= self._least_nats
            if one.room is not None:
                clear = clear & ~one.room
            metres, near = np.where(counts, one.lengths_m, 0.0), self._near(landmarks, one)
            whole[row] = np.where(near, metres, 0.0).sum(axis=1)
            sure[row] = np.where(near & clear, metres, 0.0).sum(axis=1)
            if one.excess is not None:
                known = near & ~np.isnan(one.excess)
                excess += np.where(known, metres * np.nan_to_num(one.excess), 0.0).sum(axis=1)
                measured += np.where(known, metres, 0.0).sum(axis=1)
        share = sure.sum(axis=0) / np.maximum(whole.sum(axis=0), 1e-9)
        cameras = ((sure >= LEAST_SHARE * whole) & (sure >= FEWEST_M)).sum(axis=0)
        enough = (share >= OVERALL) & (cameras >= min(FEWEST_CAMERAS, len(evidence)))
        enough &= ~self._of_arm | (measured == 0) | (excess >= DISTINCT * measured)
        return np.asarray(self.shown(landmarks, evidence) & (enough | ~self._judged))

    def shown(self, landmarks: Float64, evidence: Sequence[OutlineEvidence]) -> Bool:
        """Return whether any image shows each landmark (n,); True for all that are not judged.

        Args:
            landmarks: (n, 3) in the world [m].
            evidence: that of each camera that sees the body.
        """
        length = sum((self._shown_m(landmarks, one) for one in evidence), np.zeros(len(landmarks)))
        return np.asarray(~self._judged | (length >= LEAST_M))

    def shown_parts(self, landmarks: Float64, evidence: OutlineEvidence) -> Bool:
        """Return whether one image shows each part (parts,), by `LEAST_M` of outline about one of its landmarks.

        Args:
            landmarks: (n, 3) in the world [m].
            evidence: that of the image's camera.
        """
        shown = np.zeros(self._count, np.bool_)
        shown[self._part[self._shown_m(landmarks, evidence) >= LEAST_M]] = True
        return shown

    def _shown_m(self, landmarks: Float64, evidence: OutlineEvidence) -> Float64:
        """Return the length (n,) of outline with evidence near each landmark in one image, if that counts, else 0."""
        near = self._near(landmarks, evidence)
        sure = np.where(evidence.nats >= self._least_nats, evidence.lengths_m, 0.0)
        whole_m, sure_m = (np.where(near, metres, 0.0).sum(axis=1) for metres in (evidence.lengths_m, sure))
        return np.where(sure_m >= LEAST_SHARE * whole_m, sure_m, 0.0)

    def _near(self, landmarks: Float64, evidence: OutlineEvidence) -> Bool:
        """Return which points of the outline count for each landmark (n, points); none for one that is not judged."""
        outline = evidence.outline
        distances2 = np.square(outline.points[None] - landmarks[:, None]).sum(axis=2)
        return np.asarray(self._counts[:, outline.part] & (distances2 < NEAR_M**2))

    def hidden_parts(self, shown_marks: Bool) -> Bool:
        """Return the parts (parts,) none of whose landmarks images show (n,); False for parts without any."""
        with_marks, shown = np.zeros(self._count, np.bool_), np.zeros(self._count, np.bool_)
        with_marks[self._part] = True
        shown[self._part[shown_marks]] = True
        return with_marks & ~shown


def evidence_at(outline: Outline, phi: Float32, surety: Float32) -> Float64:
    """Return the image's evidence (n,) for each point of a model's outline [nats]; 0 where its contour is elsewhere.

    Args:
        outline: the model's outline.
        phi: (rows, columns) signed distance to the image's contour in the outline's window, above 0 inside [px].
        surety: (rows, columns) log-likelihood ratio of a sample's side of the contour against the other one [nats].
    """
    long = np.linalg.norm(outline.normals, axis=1, keepdims=True)
    unit = outline.normals / np.maximum(long, 1e-9)
    out = np.zeros(len(outline.at))
    fits = np.abs(_nearest(phi, outline, outline.at)) <= FITS_STEPS * outline.step_px
    for side in (-1.0, 1.0):
        at = outline.at + side * BESIDE_STEPS * outline.step_px * unit
        out += 0.5 * np.clip(_nearest(surety, outline, at), -MOST_NATS, MOST_NATS)
    return np.where(fits, out, 0.0)


def _nearest(values: Float32, outline: Outline, at: Float64) -> Float32:
    """Return the value (n,) of the sample nearest to each pixel (n, 2) in the outline's window; 0 outside of it."""
    column, row = np.rint((at - outline.origin_px) / outline.step_px).astype(np.int64).T
    inside = (row >= 0) & (row < values.shape[0]) & (column >= 0) & (column < values.shape[1])
    row, column = np.clip(row, 0, values.shape[0] - 1), np.clip(column, 0, values.shape[1] - 1)
    return np.where(inside, values[row, column], np.float32(0.0))


class SupportConditions:
    """Reports parts of limbs that images have not supported for `LASTS_S`, by their landmarks, and the end of that.

    A part is without support if all of its landmarks are. A fingertip alone is no limb: in small pictures it is
    narrower than a sample, so its support comes and goes. Who leaves the images, or comes, begins anew.

    Args:
        landmarks: the part of each body's landmarks, by the landmark's and the body's name.
    """

    def __init__(self, landmarks: Mapping[str, Mapping[str, int]]) -> None:
        self._landmarks = {name: tuple(some) for name, some in landmarks.items()}
        self._parts = {name: np.array([*some.values()], np.int64) for name, some in landmarks.items()}
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._since: dict[tuple[str, str], tuple[int, int]] = {}
        self._said: dict[str, list[str]] = {}
        self._until: dict[str, tuple[int, int]] = {}

    def memory(self) -> list[object]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return [self._since, self._said, self._until]

    def recall(self, memory: Sequence[dict]) -> None:  # type: ignore[type-arg]
        """Restore the state that `memory` returned, without copying it."""
        self._since, self._said, self._until = memory

    @property
    def lasting(self) -> Sequence[str]:
        """The reported conditions that still last, as clauses of a sentence, one for each body."""
        return [_clause(name, some) for name, some in self._said.items() if some]

    def update(self, number: int, time_ns: int, supported: Mapping[str, Bool]) -> list[str]:
        """Count a frame; return messages about landmarks that have been without support, or have it again.

        Args:
            number: number of the frame, for the messages.
            time_ns: capture time, on the common clock.
            supported: whether images support each landmark, by the body's name, of the present bodies.
        """
        notes: list[str] = []
        for name, marks in self._landmarks.items():
            if name not in supported:
                self._forget(name)
                continue
            parts = self._parts[name]
            shown = np.isin(parts, parts[supported[name]])
            lacking: list[str] = []
            since = number
            for mark, has in zip(marks, shown.tolist(), strict=True):
                if has:
                    self._since.pop((name, mark), None)
                    continue
                begun_ns, begun = self._since.setdefault((name, mark), (time_ns, number))
                if time_ns - begun_ns >= LASTS_S * NS_PER_S:
                    lacking, since = [*lacking, mark], min(since, begun)
            before = self._said.get(name, [])
            if not shown.all():
                self._until.pop(name, None)
            if set(lacking) - set(before):
                # A message stands until all limbs show for as long; else it would come again and again.
                self._said[name] = [mark for mark in marks if mark in lacking or mark in before]
                notes.append(f"from frame {since} on: {_clause(name, self._said[name])}")
            elif before and shown.all():
                begun_ns, begun = self._until.setdefault(name, (time_ns, number))
                if time_ns - begun_ns >= LASTS_S * NS_PER_S:
                    notes.append(f"frame {begun}: images show all limbs{f' of {name}' if name else ''} again")
                    self._forget(name)
        return notes

    def _forget(self, name: str) -> None:
        self._said.pop(name, None)
        self._until.pop(name, None)
        self._since = {of: since for of, since in self._since.items() if of[0] != name}


def _clause(name: str, marks: Sequence[str]) -> str:
    whose = f"{name}'s " if name else ""
    return f"images do not support {whose}{', '.join(marks)}: predicted, not measured"
