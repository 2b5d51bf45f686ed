"""Bodies to be fitted to pictures: a woman or a man of 26 degrees of freedom, and a pair of legs.

    body = body_mesh("female", 1.68)
    body = body_mesh("male", proportions=BodyProportions(thigh=0.43, upper_arm=0.31))

**Rest.** x to the person's left, y up, z forwards, the ground at y = 0, x = 0 between the feet [m]. The person stands
straight, the legs straight down, the arms straight and 45° below the horizontal, thumbs forwards.

**Joints** are turns about axes that are fixed at rest; left and right mirror each other, so that a number means the
same on both sides::

    waist           bend forwards, bend to the left
    shoulder        swing forwards, raise sidewards, turn outwards
    elbow           flexion
    hip             flexion, abduction, turn outwards
    knee            flexion
    ankle           flexion, toes up

Three turns in a row lose a degree of freedom where the second brings the axis of the third onto that of the first. The
swing comes first, about the axis that is perpendicular to the arm at rest and to z, because the poles are then where
the arm seldom is: 45° above the horizontal to the side, and across the trunk. Were the raise first, they would be
straight forwards, where people reach, and up to where they pass when they lift an arm. A leg would have to be
stretched sidewards by 90°.

**Flesh** is a smooth union of tapered limbs (`mocapella.geometry.limb_surface`), of breadths and depths of a table in
``body_shapes``. Vertices near a joint go with both of its parts, blended.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.limb_surface import group_distances, polygonise
from mocapella.geometry.twists import revolute
from mocapella.model.body_proportions import BodyProportions, BodyShape, Lengths, Sex, body_shape, lengths_of
from mocapella.model.rigged_mesh import Landmark, RiggedMesh
from mocapella.model.twist_tree import twist_tree
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]

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
}
"""Of each joint: what its turns are called and their limits [degrees], from American Academy of Orthopaedic Surgeons,
*Joint motion: method of measuring and recording* (1965), but for the shoulder's raise: the table has 180° from hanging
arms, here 45° below the rest, and beyond that the arm comes down across the trunk."""
DETAIL: Final = (0.6, 4.0)
_ARM_DOWN: Final = np.sqrt(0.5)
_TRUNK, _ARM, _OTHER_ARM, _LEG, _OTHER_LEG = range(5)
_WITHIN: Final = (0.010, 0.008, 0.008, 0.010, 0.010)
_BETWEEN: Final = 0.030
"""How far limbs of a group and groups flow into each other, over the height: trunk and head, arms, legs."""


def body_mesh(
    sex: Sex = "male",
    height_m: float | None = None,
    proportions: BodyProportions = BodyProportions(),  # noqa: B008 - frozen
    detail: float = 1.0,
) -> RiggedMesh:
    """A person; made once and kept.

    Args:
        sex: whose widths and girths, and whose proportions where they are not known.
        height_m: from the ground to the top of the head; None: as the known segments say, 1.75 or, of a woman, 1.63
            where none is.
        proportions: what is known of the segments.
        detail: how fine the mesh is: so many times as many vertices along a line.

    Raises:
        SettingsError: no such sex, nobody's height or proportions, or detail out of range.
    """
    check(DETAIL[0] <= detail <= DETAIL[1], "detail", detail, f"{DETAIL[0]} to {DETAIL[1]}")
    shape = body_shape(sex)
    if height_m is None and not proportions.known:
        height_m = 1.75 if sex == "male" else 1.63
    return _body(shape, lengths_of(sex, height_m, proportions), proportions.girth, detail)


def joint_places(lengths: Lengths) -> dict[str, Float64]:
    """Where the joints' centres are at rest, and other points that have names: (3,) each [m]."""
    hip = lengths.ankle_height + lengths.shank + lengths.thigh
    neck, top = hip + lengths.trunk, lengths.height
    head, foot = lengths.head, lengths.foot
    places = {
        "pelvis": (0.0, hip, 0.0),
        "waist": (0.0, hip + 0.24 * lengths.trunk, 0.0),
        "neck": (0.0, neck, 0.0),
        "head": (0.0, top, 0.0),
        "nose": (0.0, neck + 0.53 * head, 0.38 * head),
    }
    for side, sign in (("left", 1.0), ("right", -1.0)):
        x = 0.5 * sign * lengths.hip_width
        shoulder = np.array([0.5 * sign * lengths.shoulder_width, neck, 0.0])
        along = np.array([sign * _ARM_DOWN, -_ARM_DOWN, 0.0])
        elbow = shoulder + lengths.upper_arm * along
        wrist = elbow + lengths.forearm * along
        places |= {
            f"{side} eye": (0.10 * sign * head, neck + 0.65 * head, 0.29 * head),
            f"{side} ear": (0.24 * sign * head, neck + 0.60 * head, 0.0),
            f"{side} shoulder": shoulder,
            f"{side} elbow": elbow,
            f"{side} wrist": wrist,
            f"{side} hand": wrist + 0.5 * lengths.hand * along,
            f"{side} fingertip": wrist + lengths.hand * along,
            f"{side} hip": (x, hip, 0.0),
            f"{side} knee": (x, lengths.ankle_height + lengths.shank, 0.0),
            f"{side} ankle": (x, lengths.ankle_height, 0.0),
            f"{side} heel": (x, 0.12 * foot, -0.27 * foot),
            f"{side} toe": (x, 0.08 * foot, 0.73 * foot),
        }
    return {name: np.array(place, dtype=np.float64) for name, place in places.items()}


_PART_OF: Final = {
    **dict.fromkeys(("neck", "head", "nose", "eye", "ear", "shoulder"), "torso"),
    **dict.fromkeys(("pelvis", "waist", "hip"), "pelvis"),
    "elbow": "upper arm",
    **dict.fromkeys(("wrist", "hand", "fingertip"), "forearm"),
    "knee": "thigh",
    "ankle": "shank",
    **dict.fromkeys(("heel", "toe"), "foot"),
}
"""The part that each landmark is told of."""
_JOINT_OF: Final = {
    "torso": "waist",
    "upper arm": "shoulder",
    "forearm": "elbow",
    "thigh": "hip",
    "shank": "knee",
    "foot": "ankle",
}


def _split(name: str) -> tuple[str, str]:
    """("left ", "knee") of "left knee"."""
    side, _, rest = name.partition(" ")
    return (f"{side} ", rest) if side in ("left", "right") else ("", name)


def _axes(joint: str, side: str) -> Float64:
    """(turns, 3) at rest."""
    sign = -1.0 if side == "right " else 1.0
    x, y, z = np.eye(3)
    arm = np.array([sign * _ARM_DOWN, -_ARM_DOWN, 0.0])
    return np.array(
        {
            "waist": [x, -z],
            "shoulder": [np.cross(arm, z), sign * z, -sign * arm],
            "elbow": [np.cross(arm, z)],
            "hip": [-x, sign * z, sign * y],
            "knee": [x],
            "ankle": [-x],
        }[joint]
    )


def _rig(name: str, places: dict[str, Float64], parts: tuple[str, ...]) -> dict[str, Any]:
    """What a mesh of these parts has beside its surface."""
    parents = [-1 if k < 0 else parts.index(PARTS[k]) for p, k in zip(PARTS, _PARENTS, strict=True) if p in parts]
    joint_parts, twists, limits, names = [], [], [], []
    for k, part in enumerate(parts[1:], start=1):
        side, kind = _split(part)
        joint = _JOINT_OF[kind]
        for axis, (turn, least, most) in zip(_axes(joint, side), _JOINTS[joint], strict=True):
            joint_parts.append(k)
            twists.append(revolute(axis, places[f"{side}{joint}"]))
            limits.append(np.radians([least, most]))
            names.append(f"{side}{joint} {turn}")
    of_part = {place: "".join((_split(place)[0], _PART_OF[_split(place)[1]])) for place in places}
    of_part |= {place: _PART_OF[_split(place)[1]] for place in places if _PART_OF[_split(place)[1]] in PARTS}
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


@cache
def _body(shape: BodyShape, lengths: Lengths, girth: float, detail: float) -> RiggedMesh:
    places = joint_places(lengths)
    limbs = _limbs(shape, lengths, girth, places)
    height = lengths.height
    within = height * np.array(_WITHIN)
    nodes = _grid(limbs, lengths, places, detail)
    vertices, faces = polygonise(limbs, within, _BETWEEN * height, nodes, mirrored=True)
    bones, shares = _shares(vertices, limbs, within, places, lengths)
    vertices = _to_height(vertices, lengths)
    return RiggedMesh(
        vertices=vertices, faces=faces.astype(np.int32), bones=bones, shares=shares,
        **_rig(shape.name, places, PARTS),
    )  # fmt: skip


def _to_height(vertices: Float64, lengths: Lengths) -> Float64:
    """Flat soles, and the top of the head, which lies between nodes of the grid, where it belongs."""
    out, neck = vertices.copy(), lengths.height - lengths.head
    above = np.maximum(out[:, 1] - neck, 0.0)
    out[:, 1] += above * (lengths.head / above.max() - 1.0)
    out[:, 1] = np.maximum(out[:, 1], 0.0)
    return out


def _limbs(shape: BodyShape, lengths: Lengths, girth: float, places: dict[str, Float64]) -> Float64:
    """(n, 9), see `limb_surface`."""
    rows: list[list[float]] = []
    h, g, flesh = lengths.height, lengths.height * girth, shape.flesh

    def add(group: int, a: Any, b: Any, ra: float, rb: float) -> None:
        rows.append([*map(float, a), *map(float, b), float(ra), float(rb), group])

    hip, trunk = places["pelvis"][1], lengths.trunk
    for (u0, a0, b0, z0), (u1, a1, b1, z1) in pairwise(flesh.trunk):
        for x in (-1.0, -0.4, 0.4, 1.0):
            add(_TRUNK, [x * (a0 - b0) * g, hip + u0 * trunk, z0 * h], [x * (a1 - b1) * g, hip + u1 * trunk, z1 * h],
                b0 * g, b1 * g)  # fmt: skip
    neck, head = places["neck"][1], lengths.head / 0.182

    def skull(x: float, y: float, z: float) -> Float64:
        return np.array([x * head, neck + (y - 0.818) * head, z * head])

    add(_TRUNK, skull(0, 0.9560, -0.012), skull(0, 0.9560, 0.011), 0.0435 * head, 0.0435 * head)
    add(_TRUNK, skull(0, 0.935, 0.000), skull(0, 0.935, 0.014), 0.040 * head, 0.040 * head)
    add(_TRUNK, skull(0, 0.940, 0.018), skull(0, 0.896, 0.022), 0.034 * head, flesh.jaw * head)
    add(_TRUNK, skull(0, 0.930, 0.053), skull(0, 0.914, 0.062), 0.005 * head, 0.0075 * head)
    add(_TRUNK, skull(0, 0.830, -0.012), skull(0, 0.905, -0.002), 1.08 * flesh.neck * g, 0.98 * flesh.neck * g)
    for sign in (-1.0, 1.0):
        shoulder = places["left shoulder" if sign > 0 else "right shoulder"]
        add(_TRUNK, skull(0, 0.858, -0.012), shoulder * [0.85, 1, 1] + [0, -0.004 * h, -0.006 * h],
            0.8 * flesh.neck * g, 0.025 * g)  # fmt: skip
        add(_TRUNK, [0.045 * g * sign, hip - 0.02 * trunk, -0.022 * g], [0.045 * g * sign, hip - 0.01, -0.022 * g],
            flesh.buttocks * g, flesh.buttocks * g)  # fmt: skip
        if flesh.breasts:
            at = [0.042 * g * sign, hip + 0.70 * trunk, 0.036 * g]
            add(_TRUNK, at, [at[0], at[1] + 0.02 * h, 0.020 * g], flesh.breasts * g, 0.9 * flesh.breasts * g)
        _add_leg(add, _LEG if sign > 0 else _OTHER_LEG, "left" if sign > 0 else "right", shape, lengths, g, places)
        _add_arm(add, _ARM if sign > 0 else _OTHER_ARM, "left" if sign > 0 else "right", shape, lengths, g, places)
    return np.array(sorted(rows, key=lambda row: row[8]))


def _add_leg(
    add: Any, group: int, side: str, shape: BodyShape, lengths: Lengths, g: float, places: dict[str, Float64]
) -> None:
    h = lengths.height
    for name, start, end in (("thigh", "hip", "knee"), ("shank", "knee", "ankle")):
        a, b = places[f"{side} {start}"], places[f"{side} {end}"]
        for (u0, r0, z0), (u1, r1, z1) in pairwise(getattr(shape.flesh, name)):
            add(group, a + u0 * (b - a) + [0, 0, z0 * h], a + u1 * (b - a) + [0, 0, z1 * h], r0 * g, r1 * g)
    ankle, f = places[f"{side} ankle"], lengths.foot / 0.152
    x, sole = ankle[0], -0.003 * f
    inside = 1.0 if side == "left" else -1.0
    add(group, ankle + [0, 0, -0.003 * f], [x, 0.024 * f + sole, -0.018 * f], 0.020 * f, 0.024 * f)
    add(group, ankle + [0, 0, 0.006 * f], [x, 0.022 * f + sole, 0.055 * f], 0.021 * f, 0.020 * f)
    for dx, end in ((-0.012 * inside, 0.095), (0.012 * inside, 0.086)):
        add(group, [x, 0.020 * f + sole, -0.020 * f], [x + dx * f, 0.019 * f + sole, 0.060 * f], 0.021 * f, 0.019 * f)
        add(group, [x + dx * f, 0.019 * f + sole, 0.060 * f], [x + dx * f, 0.016 * f + sole, end * f],
            0.019 * f, 0.0145 * f)  # fmt: skip


def _add_arm(
    add: Any, group: int, side: str, shape: BodyShape, lengths: Lengths, g: float, places: dict[str, Float64]
) -> None:
    h = lengths.height
    for name, start, end in (("upper_arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist")):
        a, b = places[f"{side} {start}"], places[f"{side} {end}"]
        for (u0, r0, z0), (u1, r1, z1) in pairwise(getattr(shape.flesh, name)):
            add(group, a + u0 * (b - a) + [0, 0, z0 * h], a + u1 * (b - a) + [0, 0, z1 * h], r0 * g, r1 * g)
    wrist, tip = places[f"{side} wrist"], places[f"{side} fingertip"]
    along, k = (tip - wrist) / lengths.hand, lengths.hand / 0.108
    thumb = np.array([0.0, 0.0, 1.0])
    for z in (-0.0145, 0.0, 0.0145):
        knuckles = wrist + 0.050 * k * along + z * k * thumb
        add(group, wrist + 0.006 * k * along + 0.45 * z * k * thumb, knuckles, 0.0125 * k, 0.0105 * k)
        end = 0.099 - (0.010 if z else 0.0)
        add(group, knuckles, wrist + end * k * along + 0.8 * z * k * thumb, 0.0105 * k, 0.0085 * k)
    add(group, wrist + (0.012 * along + 0.010 * thumb) * k, wrist + (0.050 * along + 0.033 * thumb) * k,
        0.011 * k, 0.0085 * k)  # fmt: skip


def _steps(bands: list[tuple[float, float, float]]) -> Float64:
    """Coordinates from the first band's start to the last one's end, the bands' steps apart: (start, end, step)."""
    out = [bands[0][0]]
    for _, end, step in bands:
        span = end - out[-1]
        if span > 0:
            count = max(1, round(span / step))
            out += (out[-1] + span / count * np.arange(1, count + 1)).tolist()
    return np.array(out)


def _grid(limbs: Float64, lengths: Lengths, places: dict[str, Float64], detail: float) -> Float64:
    """(a, b, c, 3) nodes of x > 0: fine about head, hands and feet. Beyond the shoulders they follow the arm down."""
    h, fine = lengths.height, 1.25 * lengths.height / detail
    shoulder, wrist, tip = (places[f"left {name}"] for name in ("shoulder", "wrist", "fingertip"))
    r = limbs[:, 6:8].max(axis=1)
    low = (np.minimum(limbs[:, 2], limbs[:, 5]) - r).min() - 0.04 * fine
    high = (np.maximum(limbs[:, 2], limbs[:, 5]) + r).max() + 0.04 * fine
    step = 0.0130 * fine
    half = np.arange(0.5 * step, shoulder[0] + 0.03 * h, step)
    x = np.concatenate([half, _steps([
        (half[-1], wrist[0] - 0.01 * h, 0.020 * fine), (0, tip[0] + 0.025 * h, 0.0110 * fine),
        (0, tip[0] + 0.025 * h + 0.02 * fine, 0.01 * fine),
    ])[1:]])  # fmt: skip
    neck = places["neck"][1]
    y = _steps([
        (-0.03 * fine, lengths.ankle_height + 0.02 * h, 0.0105 * fine),
        (0, 0.93 * places["pelvis"][1], 0.026 * fine), (0, neck - 0.06 * h, 0.0165 * fine),
        (0, neck + 0.03 * h, 0.0125 * fine), (0, lengths.height + 0.03 * fine, 0.0115 * fine),
    ])  # fmt: skip
    z = _steps([(low, high, 0.0135 * fine)])
    nodes = np.empty((len(x), len(y), len(z), 3))
    nodes[..., 0] = x[:, None, None]
    nodes[..., 1] = y[None, :, None] - np.maximum(x - shoulder[0], 0.0)[:, None, None]
    nodes[..., 2] = z
    return nodes


def _smooth(x: Float64, start: float, end: float) -> Float64:
    u = np.clip((x - start) / (end - start), 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def _shares(
    vertices: Float64, limbs: Float64, within: Float64, places: dict[str, Float64], lengths: Lengths
) -> tuple[Int32, Float64]:
    """(n, 4) bones and shares: a joint hands over from one part to the next within about a radius."""
    h = lengths.height
    distance = group_distances(limbs, within, vertices)
    y = vertices[:, 1]
    weights = dict.fromkeys(PARTS, np.zeros(len(vertices)))
    trunk = np.ones(len(vertices))
    for side, sign, arm in (("left", 1.0, _ARM), ("right", -1.0, _OTHER_ARM)):
        shoulder, elbow, knee, ankle, hip = (
            places[f"{side} {name}"] for name in ("shoulder", "elbow", "knee", "ankle", "hip")
        )
        along = np.array([sign * _ARM_DOWN, -_ARM_DOWN, 0.0])
        nearer = _smooth(distance[:, _TRUNK] - distance[:, arm], -0.010 * h, 0.025 * h)
        of_arm = nearer * _smooth((vertices - shoulder) @ along, -0.030 * h, 0.045 * h)
        bent = _smooth((vertices - elbow) @ along, -0.022 * h, 0.022 * h)
        weights[f"{side} upper arm"], weights[f"{side} forearm"] = of_arm * (1 - bent), of_arm * bent
        beside = _smooth(sign * vertices[:, 0], -0.02 * h, 0.02 * h)
        low = _smooth(-distance[:, arm] + distance[:, _LEG : _OTHER_LEG + 1].min(axis=1), -0.03 * h, 0.0)
        of_leg = (1 - low) * beside * _smooth(hip[1] - y, -0.035 * h, 0.060 * h)
        bent, flexed = _smooth(knee[1] - y, -0.026 * h, 0.026 * h), _smooth(ankle[1] - y, -0.012 * h, 0.014 * h)
        in_front = _smooth(vertices[:, 2], 0.010 * h, 0.030 * h) * _smooth(ankle[1] + 0.03 * h - y, 0.0, 0.02 * h)
        flexed = np.maximum(flexed, in_front)
        weights[f"{side} thigh"] = of_leg * (1 - bent)
        weights[f"{side} shank"], weights[f"{side} foot"] = of_leg * bent * (1 - flexed), of_leg * bent * flexed
        trunk = trunk - of_arm - of_leg
    waist = _smooth(y - places["waist"][1], -0.05 * h, 0.05 * h)
    weights["pelvis"], weights["torso"] = trunk * (1 - waist), trunk * waist
    table = np.maximum(np.column_stack([weights[part] for part in PARTS]), 0.0)
    order = np.argsort(-table, axis=1, kind="stable")[:, :4]
    most = np.take_along_axis(table, order, axis=1)
    most[most < 1e-3] = 0.0
    return order.astype(np.int32), most / most.sum(axis=1)[:, None]
