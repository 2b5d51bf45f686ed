"""Body meshes to fit to images: a woman or a man with 26 degrees of freedom, and a pair of legs.

    body = body_mesh("female", 1.68)
    body = body_mesh("male", proportions=BodyProportions(thigh=0.43, upper_arm=0.31))

**Rest.** x to the person's left, y up, z forwards, the ground at y = 0, x = 0 between the feet [m]. The person stands
straight, the legs straight down, the arms straight and 45° below the horizontal, thumbs forwards.

**Joints** are rotations about axes fixed at rest; left and right are mirrored, so that an angle means the same on both
sides::

    waist           bend forwards, bend to the left
    shoulder        swing forwards, raise sidewards, turn outwards
    elbow           flexion
    hip             flexion, abduction, turn outwards
    knee            flexion
    ankle           flexion, toes up

A body that is ``supple`` has three more, 29 degrees of freedom: the neck nods and tilts, and the waist turns.

Three successive rotations are singular where the second aligns the third axis with the first (gimbal lock). The swing
is first, about the axis perpendicular to the arm at rest and to z, because its singularities are rare arm poses: 45°
above the horizontal to the side, and across the trunk. With the raise first they would be straight forwards, where
people reach and where an arm passes when it is lifted. A leg's are at an abduction of 90°, beyond its limits.

**Flesh** is a smooth union of tapered limbs (`mocapella.geometry.limb_surface`), with breadths and depths from
``body_shapes``. Vertices near a joint move with a blend of its two parts.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.limb_surface import group_distances, polygonise
from mocapella.geometry.twists import revolute
from mocapella.model.body_flesh import APART, ARM, ARM_DOWN, BETWEEN, LEG, TRUNK, WITHIN, body_limbs, joint_places
from mocapella.model.body_proportions import (
    AVERAGE,
    BodyProportions,
    BodyShape,
    Lengths,
    Sex,
    body_shape,
    lengths_of,
)
from mocapella.model.rigged_mesh import Landmark, RiggedMesh, smooth, strongest
from mocapella.model.twist_tree import twist_tree
from mocapella.settings import check

Float64 = NDArray[np.float64]

PARTS: Final = (
    *("pelvis", "torso", "left upper arm", "left forearm", "right upper arm", "right forearm"),
    *("left thigh", "left shank", "left foot", "right thigh", "right shank", "right foot"),
)
_PARENTS: Final = (-1, 0, 1, 2, 1, 4, 0, 6, 7, 0, 9, 10)
_JOINTS: Final[dict[str, tuple[tuple[str, float, float], ...]]] = {
    "waist": (("bend forwards", -25, 80), ("bend to the left", -35, 35)),
    "shoulder": (("swing forwards", -60, 180), ("raise sidewards", -85, 135), ("turn outwards", -90, 90)),
    "elbow": (("flexion", 0, 150),),
    "hip": (("flexion", -30, 120), ("abduction", -30, 45), ("turn outwards", -45, 45)),
    "knee": (("flexion", 0, 135),),
    "ankle": (("flexion", -50, 20),),
    "neck": (("nod", -45, 45), ("tilt to the left", -45, 45)),
}
"""Each joint's rotations, with names and limits [degrees], by the American Academy of Orthopaedic Surgeons,
*Joint motion: method of measuring and recording* (1965), except the shoulder. Its raise goes from a hanging arm, 45°
below the rest pose, 180° up and 40° inwards across the trunk. Its real range of turning depends on the other angles;
here it is ±90°."""
_TURN_OF_WAIST: Final = ("turn to the left", -45.0, 45.0)
_HEAD: Final = "head"
"""The additional part of a supple body; its parent is the torso."""
DETAIL: Final = (0.8, 4.0)
_ABOVE: Final = ("torso", "upper arm", "forearm")


def body_mesh(
    sex: Sex = "male",
    height_m: float | None = None,
    proportions: BodyProportions = AVERAGE,
    detail: float = 1.0,
    *,
    supple: bool = False,
) -> RiggedMesh:
    """Return the mesh of a person; equal arguments give equal meshes. Results are cached: do not change their arrays.

    Args:
        sex: selects the table of average widths, girths and proportions.
        height_m: from the ground to the top of the head [m]; None: estimated from the known segments, or the average.
        proportions: lengths of the known segments, and girth.
        detail: resolution: factor of the number of vertices along a line; 0.8 to 4.
        supple: whether the neck moves and the waist turns.

    Raises:
        SettingsError: unknown sex, implausible height or proportions, or detail out of range.
    """
    return _mesh(sex, height_m, proportions, detail, legs_only=False, supple=supple)


def legs_mesh(
    sex: Sex = "male", height_m: float | None = None, proportions: BodyProportions = AVERAGE, detail: float = 1.0
) -> RiggedMesh:
    """Return the mesh of a pelvis and legs, with the parts and joints of `body_mesh` below the waist.

    Args:
        sex, height_m, proportions, detail: as in `body_mesh`; the height is the whole person's [m].

    Raises:
        SettingsError: as `body_mesh`.
    """
    return _mesh(sex, height_m, proportions, detail, legs_only=True)


def _mesh(
    sex: Sex,
    height_m: float | None,
    proportions: BodyProportions,
    detail: float,
    *,
    legs_only: bool,
    supple: bool = False,
) -> RiggedMesh:
    check(DETAIL[0] <= detail <= DETAIL[1], "detail", detail, f"{DETAIL[0]} to {DETAIL[1]}")
    shape = body_shape(sex)
    if height_m is None and not proportions.known:
        height_m = shape.height_m
    return _made(
        shape, lengths_of(sex, height_m, proportions), proportions.girth, detail, legs_only=legs_only, supple=supple
    )


_PART_OF: Final = {
    **dict.fromkeys(("neck", "head", "nose", "eye", "ear", "shoulder"), "torso"),
    **dict.fromkeys(("pelvis", "waist", "hip"), "pelvis"),
    "elbow": "upper arm",
    **dict.fromkeys(("wrist", "hand", "fingertip"), "forearm"),
    "knee": "thigh",
    "ankle": "shank",
    **dict.fromkeys(("heel", "toe"), "foot"),
}
"""The part that each landmark belongs to."""
_JOINT_OF: Final = {
    "torso": "waist",
    "upper arm": "shoulder",
    "forearm": "elbow",
    "thigh": "hip",
    "shank": "knee",
    "foot": "ankle",
    _HEAD: "neck",
}
_OF_HEAD: Final = ("head", "nose", "eye", "ear")


def _split(name: str) -> tuple[str, str]:
    """Split "left knee" into ("left ", "knee")."""
    side, _, rest = name.partition(" ")
    return (f"{side} ", rest) if side in ("left", "right") else ("", name)


def _turns(joint: str, supple: bool) -> tuple[tuple[str, float, float], ...]:
    return (*_JOINTS[joint], _TURN_OF_WAIST) if supple and joint == "waist" else _JOINTS[joint]


def _axes(joint: str, side: str) -> Float64:
    """Return (rotations, 3) axes of a joint at rest."""
    sign = -1.0 if side == "right " else 1.0
    x, y, z = np.eye(3)
    arm = np.array([sign * ARM_DOWN, -ARM_DOWN, 0.0])
    return np.array(
        {
            "waist": [x, -z, y],
            "neck": [x, -z],
            "shoulder": [np.cross(arm, z), sign * z, -sign * arm],
            "elbow": [np.cross(arm, z)],
            "hip": [-x, sign * z, sign * y],
            "knee": [x],
            "ankle": [-x],
        }[joint]
    )


def _rig(name: str, places: dict[str, Float64], parts: tuple[str, ...]) -> dict[str, Any]:
    """Return the tree, names and landmarks of a mesh with these parts."""
    supple = _HEAD in parts
    parents = [-1 if k < 0 else parts.index(PARTS[k]) for p, k in zip(PARTS, _PARENTS, strict=True) if p in parts]
    if supple:
        parents.append(parts.index("torso"))
    joint_parts, twists, limits, names = [], [], [], []
    for k, part in enumerate(parts[1:], start=1):
        side, kind = _split(part)
        joint = _JOINT_OF[kind]
        for axis, (turn, least, most) in zip(_axes(joint, side), _turns(joint, supple), strict=False):
            joint_parts.append(k)
            twists.append(revolute(axis, places[f"{side}{joint}"]))
            limits.append(np.radians([least, most]))
            names.append(f"{side}{joint} {turn}")
    of_part = {place: "".join((_split(place)[0], _PART_OF[_split(place)[1]])) for place in places}
    of_part |= {place: _PART_OF[_split(place)[1]] for place in places if _PART_OF[_split(place)[1]] in PARTS}
    of_part |= {place: _HEAD for place in places if supple and _split(place)[1] in _OF_HEAD}
    return {
        "name": name,
        "tree": twist_tree(parents, joint_parts, twists, limits, root=places["pelvis"]),
        "part_names": parts,
        "joint_names": tuple(names),
        "landmarks": {
            place: Landmark(parts.index(of_part[place]), point)
            for place, point in places.items()
            if of_part[place] in parts
        },
    }


@lru_cache(maxsize=32)  # bounded: a tracker may try many sizes
def _made(
    shape: BodyShape, lengths: Lengths, girth: float, detail: float, *, legs_only: bool, supple: bool
) -> RiggedMesh:
    limbs = body_limbs(shape.flesh, lengths, girth, legs_only=legs_only)
    places, height = joint_places(lengths), lengths.height
    within = height * np.array(WITHIN)
    nodes = _grid(limbs, lengths, places, detail)
    vertices, faces = polygonise(limbs, within, BETWEEN * height, nodes, mirrored=True)
    parts = tuple(part for part in PARTS if not legs_only or _split(part)[1] not in _ABOVE)
    weights = _weights(vertices, group_distances(limbs, within, np.abs(vertices)), places, height)
    if legs_only:
        weights["pelvis"] = weights["pelvis"] + weights["torso"]
    if supple:
        parts = (*parts, _HEAD)
        height_of_neck = places["neck"][1]
        share = smooth(vertices[:, 1], height_of_neck - 0.005 * height, height_of_neck + 0.04 * height)
        weights[_HEAD], weights["torso"] = share * weights["torso"], (1.0 - share) * weights["torso"]
    bones, shares = strongest(np.column_stack([weights[part] for part in parts]))
    vertices[:, 1] = np.maximum(vertices[:, 1], 0.0)  # flat soles
    if not legs_only:
        vertices = _to_height(vertices, lengths)
    return RiggedMesh(
        vertices=vertices, faces=faces.astype(np.int32), bones=bones, shares=shares,
        **_rig(f"{shape.name} legs" if legs_only else shape.name, places, parts),
    )  # fmt: skip


def _to_height(vertices: Float64, lengths: Lengths) -> Float64:
    """Move the top of the head, which lies between nodes of the grid, to its exact height."""
    out, neck = vertices.copy(), lengths.height - lengths.head
    above = np.maximum(out[:, 1] - neck, 0.0)
    out[:, 1] += above * (lengths.head / above.max() - 1.0)
    return out


def _steps(bands: list[tuple[float, float, float]]) -> Float64:
    """Return coordinates through all bands (start, end, step), each with its step."""
    out = [bands[0][0]]
    for _, end, step in bands:
        span = end - out[-1]
        if span > 0:
            count = max(1, round(span / step))
            out += (out[-1] + span / count * np.arange(1, count + 1)).tolist()
    return np.array(out)


def _grid(limbs: Float64, lengths: Lengths, places: dict[str, Float64], detail: float) -> Float64:
    """Return (a, b, c, 3) grid nodes with x > 0: fine near head, hands and feet, and along the arm."""
    h, fine = lengths.height, 1.25 * lengths.height / detail
    shoulder, wrist, tip = (places[f"left {name}"] for name in ("shoulder", "wrist", "fingertip"))
    r = limbs[:, 6:8].max(axis=1)
    low = (np.minimum(limbs[:, 2], limbs[:, 5]) - r).min() - 0.04 * fine
    high = (np.maximum(limbs[:, 2], limbs[:, 5]) + r).max() + 0.04 * fine
    step = 0.0130 * fine
    half = np.arange(min(0.5 * step, 0.4 * APART * h), shoulder[0] + 0.03 * h, step)
    x = np.concatenate([half, _steps([
        (half[-1], wrist[0] - 0.01 * h, 0.020 * fine), (0, tip[0] + 0.025 * h, 0.0110 * fine),
    ])[1:]])  # fmt: skip
    neck = places["neck"][1]
    y = _steps([
        (-0.012 * h - 0.02 * fine, lengths.ankle_height + 0.02 * h, 0.0105 * fine),
        (0, 0.93 * places["pelvis"][1], 0.026 * fine), (0, neck - 0.06 * h, 0.0165 * fine),
        (0, neck + 0.03 * h, 0.0125 * fine), (0, lengths.height + 0.03 * fine, 0.0115 * fine),
    ])  # fmt: skip
    z = _steps([(low, high, 0.0135 * fine)])
    nodes = np.empty((len(x), len(y), len(z), 3))
    nodes[..., 0] = x[:, None, None]
    nodes[..., 1] = y[None, :, None] - np.maximum(x - shoulder[0], 0.0)[:, None, None]
    nodes[..., 2] = z
    return nodes


def _weights(vertices: Float64, distance: Float64, places: dict[str, Float64], h: float) -> dict[str, Float64]:
    """Return each part's weight for each vertex; it changes from part to part within about a radius of a joint.

    Args:
        vertices: (n, 3).
        distance: (n, 3) from the groups of limbs, the nearer arm and leg.
        places: positions of the joints.
        h: the height.
    """
    y, near_trunk = vertices[:, 1], smooth(-distance[:, TRUNK], -0.025 * h, -0.005 * h)
    of_hand = smooth(distance[:, LEG] - distance[:, ARM], -0.03 * h, 0.0)
    weights, trunk = {}, np.ones(len(vertices))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder, elbow, knee, ankle, hip = (
            places[f"{side} {name}"] for name in ("shoulder", "elbow", "knee", "ankle", "hip")
        )
        along = np.array([sign * ARM_DOWN, -ARM_DOWN, 0.0])
        nearer = smooth(distance[:, TRUNK] - distance[:, ARM], -0.010 * h, 0.025 * h)
        of_arm = nearer * smooth((vertices - shoulder) @ along, -0.030 * h, 0.045 * h)
        bent = smooth((vertices - elbow) @ along, -0.022 * h, 0.022 * h)
        weights[f"{side} upper arm"], weights[f"{side} forearm"] = of_arm * (1 - bent), of_arm * bent
        # Between the legs half of the weight is the pelvis', the rest is shared by both legs.
        x = sign * vertices[:, 0]
        held = 0.5 * near_trunk * (1.0 - smooth(np.abs(x), 0.0, 0.035 * h))
        beside = near_trunk * smooth(x, -0.03 * h, 0.03 * h) + (1.0 - near_trunk) * np.heaviside(x, 0.5)
        of_leg = (1 - of_hand) * (1 - held) * beside * smooth(hip[1] - y, -0.035 * h, 0.060 * h)
        bent, flexed = smooth(knee[1] - y, -0.026 * h, 0.026 * h), smooth(ankle[1] - y, -0.012 * h, 0.014 * h)
        instep = smooth(vertices[:, 2], 0.010 * h, 0.030 * h) * smooth(ankle[1] + 0.03 * h - y, 0.0, 0.02 * h)
        flexed = np.maximum(flexed, instep)
        weights[f"{side} thigh"] = of_leg * (1 - bent)
        weights[f"{side} shank"], weights[f"{side} foot"] = of_leg * bent * (1 - flexed), of_leg * bent * flexed
        trunk = trunk - of_arm - of_leg
    waist = smooth(y - places["waist"][1], -0.05 * h, 0.05 * h)
    return weights | {"pelvis": trunk * (1 - waist), "torso": trunk * waist}
