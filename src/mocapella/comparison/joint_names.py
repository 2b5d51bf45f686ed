"""Match the joints of a recording and a reference by name, through topologies and marker sets."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import convert, decode_toml, own_toml, read_whole
from mocapella.errors import SettingsError, one_of
from mocapella.model.hand import LANDMARKS
from mocapella.model.topology import MOST_WEIGHT, topology, topology_names
from mocapella.settings import check

Float64 = NDArray[np.float64]
Terms = Mapping[str, float]
"""Weights of a joint's keypoints, by name; they sum to 1."""

COMMON: Final = "kinect_v2"
"""Topology whose joints stand between two layouts of people."""
_LEAST: Final = 3
"""Least number of a layout's joints that must be there, for keypoints to be taken for it."""
_FIX: Final = 'write a table such as KneeLeft = "LKNE" or KneeLeft = { LKNE = 0.5, LKNEM = 0.5 }'
_PREFIX: Final = re.compile(r"^.*:")
_NO_LETTER: Final = re.compile(r"[\W_]+")


@dataclass(frozen=True)
class MatchedJoint:
    """A joint that both have.

    Attributes:
        name: name of the joint: the recording's, or that of the common layout.
        ours, theirs: keypoints of the recording and of the reference, with weights.
        common: name of the joint in the topology `COMMON` or in a hand; empty if unknown.
    """

    name: str
    ours: Terms
    theirs: Terms
    common: str = ""


def plain_name(name: str) -> str:
    """Return a name without case, prefix (``mixamorig:``), spaces and signs: ``Left_Knee`` and ``left knee`` agree."""
    return _NO_LETTER.sub("", _PREFIX.sub("", name)).casefold()


def matched_joints(
    ours: Sequence[str], theirs: Sequence[str], table: Mapping[str, Terms] | None = None
) -> tuple[MatchedJoint, ...]:
    """Return the joints that a recording and a reference have in common.

    With a table, these are its joints. Otherwise, keypoints of one layout, or of unknown ones, match by equal names,
    and keypoints of two layouts by the joints that both determine.

    Args:
        ours, theirs: names of the keypoints.
        table: keypoints of the reference by joint of the recording.

    Raises:
        SettingsError: there are none, or the table names a joint or keypoint that does not exist; lists both.
    """
    if table:
        return tuple(_of_table(name, terms, ours, theirs) for name, terms in table.items())
    (our_layout, our_joints), (their_layout, their_joints) = layout_of(ours), layout_of(theirs)
    by_name = {plain_name(name): name for name in theirs}
    common = {next(iter(terms)): name for name, terms in our_joints.items() if len(terms) == 1}
    found: list[MatchedJoint] = []
    if our_layout == their_layout or not our_layout or not their_layout:
        found = [
            MatchedJoint(name, {name: 1.0}, {by_name[plain]: 1.0}, common.get(name, ""))
            for name in ours
            if (plain := plain_name(name)) in by_name
        ]
    if not found:
        found = [MatchedJoint(name, own, their_joints[name], name) for name, own in our_joints.items()
                 if name in their_joints]  # fmt: skip
    if not found:
        raise SettingsError(
            f"no joint of the recording ({_some(ours)}) has the name of one of the reference ({_some(theirs)}); name "
            "the pairs in a file, with --map"
        )
    return tuple(found)


def _some(names: Sequence[str], most: int = 40) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _of_table(name: str, terms: Terms, ours: Sequence[str], theirs: Sequence[str]) -> MatchedJoint:
    if name not in ours:
        raise SettingsError(f"--map: the recording has no joint {name!r}; it has {one_of(name, ours)}")
    for marker in terms:
        if marker not in theirs:
            raise SettingsError(f"--map: the reference has no {marker!r} for {name}; it has {one_of(marker, theirs)}")
    values = list(terms.values())
    fits = all(0 < abs(one) <= MOST_WEIGHT for one in values) and math.isclose(sum(values), 1.0, abs_tol=1e-6)
    check(fits, f"--map: {name}", values, f"weights up to {MOST_WEIGHT:g}, not 0, that sum to 1")
    _, joints = layout_of(ours)
    common = next((joint for joint, own in joints.items() if own == {name: 1.0}), "")
    return MatchedJoint(name, {name: 1.0}, dict(terms), common)


def read_joint_map(path: Path) -> dict[str, Terms]:
    """Read a file of pairs: TOML with a marker, or a table of markers with weights, for each joint of the recording.

    Raises:
        InputError: the file cannot be read, is no TOML, or has other values.
        SettingsError: it names no joint.
    """
    data = convert(decode_toml(read_whole(path, fix=_FIX), file=path, fix=_FIX), dict[str, str | dict[str, float]],
                   what="table of joints", file=path, fix=_FIX)  # fmt: skip
    if not data:
        raise SettingsError(f"--map {path}: names no joint; {_FIX}")
    return {name: {terms: 1.0} if isinstance(terms, str) else terms for name, terms in data.items()}


def layout_of(keypoints: Sequence[str]) -> tuple[str, dict[str, Terms]]:
    """Return the layout that most keypoints belong to, and its joints in the common layout by the keypoints' names.

    Returns:
        The layout's name, such as ``body_25`` or ``plug_in_gait``; empty, with no joints, if there is none.
    """
    by_name = {plain_name(name): name for name in keypoints}
    best, most = ("", dict[str, Terms]()), (0, 0)
    for layout, (known, joints) in _layouts().items():
        named = sum(plain_name(name) in by_name for name in known)
        there: dict[str, Terms] = {
            joint: {by_name[plain_name(name)]: weight for name, weight in terms.items()}
            for joint, terms in joints.items()
            if all(plain_name(name) in by_name for name in terms)
        }
        if len(there) >= _LEAST and (named, len(there)) > most:
            best, most = (layout, there), (named, len(there))
    return best


@cache
def _layouts() -> dict[str, tuple[tuple[str, ...], dict[str, Terms]]]:
    """Return the keypoints of each layout, and its joints in the common layout."""
    common = topology(COMMON).joints
    found: dict[str, tuple[tuple[str, ...], dict[str, Terms]]] = {
        COMMON: (common, {name: {name: 1.0} for name in common}),
        "hand": (LANDMARKS, {name: {name: 1.0} for name in LANDMARKS}),
    }
    for name in topology_names():
        one = topology(name)
        weights = one.mappings.get(COMMON, {})
        if weights:
            joints: dict[str, Terms] = {
                common[k]: {one.joints[j]: w for j, w in terms.items()} for k, terms in weights.items()
            }
            found[name] = one.joints, joints
    for name, table in own_toml("mocapella.comparison", "marker_sets.toml").items():
        own: dict[str, Terms] = {joint: {to: 1.0} if isinstance(to, str) else to for joint, to in table.items()}
        found[name] = tuple(dict.fromkeys(marker for terms in own.values() for marker in terms)), own
    return found


def weighted(
    positions: NDArray[np.floating], states: Any, keypoints: Sequence[str], terms: Terms
) -> tuple[Float64, Any]:
    """Return the positions and states of a joint.

    Args:
        positions: (..., keypoints, 3) [m].
        states: (..., keypoints) `JointState`.
        keypoints: their names.
        terms: the joint's keypoints with weights.

    Returns:
        (..., 3), NaN where one of the keypoints is unknown, and (...) the least certain of their states.
    """
    place = [keypoints.index(name) for name in terms]
    point = np.einsum("k,...kc->...c", np.array(list(terms.values())), positions[..., place, :])
    return point, states[..., place].min(axis=-1)
