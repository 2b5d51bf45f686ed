"""A skeleton for OpenSim with markers at our joints, and the set-ups that scale it and fit it to a TRC.

The model has 12 bodies of average lengths and masses, and the coordinates of our joint angles, with the same
definitions (docs/joint-angles.md), names and signs. It is for scaling and inverse kinematics; there are no muscles.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from mocapella.model.anatomy import Anatomy
from mocapella.model.body_proportions import AVERAGE, HEEL, TOE, lengths_of

Float64 = NDArray[np.float64]
Vector = tuple[float, float, float]

HEIGHT_M: Final = 1.72
"""Height of the generic person [m]."""
MASS_KG: Final = 70.0
_LUMBAR: Final = 0.62
_CHEST: Final = 1.08
"""Height of the middle and the top of the spine over the hips, relative to the shoulders', as of a Kinect v2."""
_SHARES: Final = {
    "pelvis": 0.142, "torso": 0.436, "femur": 0.100, "tibia": 0.0465, "foot": 0.0145, "humerus": 0.028, "ulna": 0.022,
}  # fmt: skip
"""Mass of each body, relative to the person's; the torso's includes the head, the ulna's the hand.

D. A. Winter, Biomechanics and Motor Control of Human Movement, 4th ed. 2009, table 4.1."""
_THICK: Final = {
    "pelvis": 0.09, "torso": 0.10, "femur": 0.06, "tibia": 0.04, "foot": 0.03, "humerus": 0.035, "ulna": 0.03,
}  # fmt: skip
"""Radius of each body's ellipsoid [m]."""
_X: Final = (1.0, 0.0, 0.0)
_Y: Final = (0.0, 1.0, 0.0)
_Z: Final = (0.0, 0.0, 1.0)
MIDDLES: Final = {"hips_middle": ("hip_r", "hip_l"), "shoulders_middle": ("shoulder_r", "shoulder_l")}
"""Markers for the scaling, midway between two points: with them, heights are measured along the spine."""
SOLES: Final = {f"sole_{side}": (f"ankle_{side}", f"heel_{side}", f"toe_{side}") for side in "rl"}
"""Markers for the scaling, nearest a point on the line between two others: with them, a foot has a height of its own.
"""
WEIGHTS: Final = {"pelvis": 1.0, "chest": 1.0, "lumbar": 5.0, "toe": 5.0, "heel": 5.0}
"""Weights of markers in the inverse kinematics; 10 for those at the limbs' joints."""


@dataclass(frozen=True)
class _Coordinate:
    """A coordinate of a joint: a rotation about an axis of the parent, or a translation along it."""

    name: str
    axis: Vector
    translation: bool = False
    locked: bool = False


@dataclass(frozen=True)
class _Segment:
    """A body of the model and the joint at its origin.

    Attributes:
        body: name of the body.
        parent: name of the body that carries it.
        at: place of the joint in the parent [m].
        end: the body's far end [m].
        coordinates: the joint's coordinates, in the order of the rotations.
    """

    body: str
    parent: str
    at: Vector
    end: Vector
    coordinates: tuple[_Coordinate, ...]


@dataclass(frozen=True)
class OpenSimSkeleton:
    """Bodies, joints and markers of the model.

    Attributes:
        segments: bodies, parents first.
        markers: name of a keypoint → its body and its place in it [m].
        points: anatomical point → the keypoint at it.
        made: names of the markers that are no keypoints, of `MIDDLES` and `SOLES`.
    """

    segments: tuple[_Segment, ...]
    markers: Mapping[str, tuple[str, Vector]]
    points: Mapping[str, str]
    made: tuple[str, ...]

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the model's coordinates."""
        return tuple(one.name for segment in self.segments for one in segment.coordinates)


def skeleton_for(keypoints: Sequence[str], anatomy: Anatomy) -> OpenSimSkeleton:
    """Return the generic skeleton with a marker at each anatomical point that is one keypoint.

    Without a lumbar point, the torso bends at the hips, and the extension of the spine is locked at 0: it is part of
    the tilt of the pelvis, as in our angles.

    Args:
        keypoints: names of the keypoints.
        anatomy: their `anatomy_of`.
    """
    own = lengths_of("female", HEIGHT_M, AVERAGE)
    middle = _LUMBAR * own.trunk if "lumbar" in anatomy else 0.0
    top, chest = own.trunk - middle, _CHEST * own.trunk - middle
    segments = [
        _Segment("pelvis", "ground", (0.0, 0.0, 0.0), (0.0, 0.3 * own.trunk, 0.0), (
            _Coordinate("pelvis_tilt", _Z), _Coordinate("pelvis_list", _X), _Coordinate("pelvis_rotation", _Y),
            *(_Coordinate(f"pelvis_t{name}", axis, True) for name, axis in zip("xyz", (_X, _Y, _Z), strict=True)))),
        _Segment("torso", "pelvis", (0.0, middle, 0.0), (0.0, chest, 0.0), (
            _Coordinate("lumbar_extension", _Z, locked="lumbar" not in anatomy), _Coordinate("lumbar_bending", _X),
            _Coordinate("lumbar_rotation", _Y))),
    ]  # fmt: skip
    places: dict[str, tuple[str, Vector]] = {
        "pelvis": ("pelvis", (0.0, 0.0, 0.0)),
        "lumbar": ("pelvis", (0.0, middle, 0.0)),
        "chest": ("torso", (0.0, chest, 0.0)),
    }
    sole, toe = 0.0, own.foot * TOE[1]
    if "heel_r" in anatomy:
        sole = -own.ankle_height + own.foot * 0.5 * (HEEL[0] + TOE[0])
    for side, s in (("r", 1.0), ("l", -1.0)):
        hip, shoulder = s * own.hip_width / 2, s * own.shoulder_width / 2
        x, y = (s, 0.0, 0.0), (0.0, s, 0.0)
        segments += [
            _Segment(f"femur_{side}", "pelvis", (0.0, 0.0, hip), (0.0, -own.thigh, 0.0), (
                _Coordinate(f"hip_flexion_{side}", _Z), _Coordinate(f"hip_adduction_{side}", x),
                _Coordinate(f"hip_rotation_{side}", y))),
            _Segment(f"tibia_{side}", f"femur_{side}", (0.0, -own.thigh, 0.0), (0.0, -own.shank, 0.0), (
                _Coordinate(f"knee_angle_{side}", (0.0, 0.0, -1.0)),)),
            _Segment(f"foot_{side}", f"tibia_{side}", (0.0, -own.shank, 0.0), (toe, sole, 0.0), (
                _Coordinate(f"ankle_angle_{side}", _Z),)),
            _Segment(f"humerus_{side}", "torso", (0.0, top, shoulder), (0.0, -own.upper_arm, 0.0), (
                _Coordinate(f"arm_flex_{side}", _Z), _Coordinate(f"arm_add_{side}", x),
                _Coordinate(f"arm_rot_{side}", y))),
            _Segment(f"ulna_{side}", f"humerus_{side}", (0.0, -own.upper_arm, 0.0), (0.0, -own.forearm, 0.0), (
                _Coordinate(f"elbow_flex_{side}", _Z),)),
        ]  # fmt: skip
        places |= {
            f"hip_{side}": ("pelvis", (0.0, 0.0, hip)),
            f"knee_{side}": (f"tibia_{side}", (0.0, 0.0, 0.0)),
            f"ankle_{side}": (f"foot_{side}", (0.0, 0.0, 0.0)),
            f"toe_{side}": (f"foot_{side}", (toe, sole, 0.0)),
            f"heel_{side}": (f"foot_{side}", (own.foot * HEEL[1], sole, 0.0)),
            f"shoulder_{side}": ("torso", (0.0, top, shoulder)),
            f"elbow_{side}": (f"ulna_{side}", (0.0, 0.0, 0.0)),
            f"wrist_{side}": (f"ulna_{side}", (0.0, -own.forearm, 0.0)),
        }
    points = {point: keypoints[next(iter(terms))] for point, terms in anatomy.items()
              if point in places and len(terms) == 1}  # fmt: skip
    markers = {name: places[point] for point, name in points.items()}
    made = {"hips_middle": ("pelvis", (0.0, 0.0, 0.0)), "shoulders_middle": ("torso", (0.0, top, 0.0))}
    made |= {name: (f"foot{name[-2:]}", (0.0, sole, 0.0)) for name, three in SOLES.items() if set(three) <= set(points)}
    return OpenSimSkeleton(tuple(segments), markers | made, points, tuple(made))


def model_xml(skeleton: OpenSimSkeleton) -> str:
    """Return the text of the model's ``.osim`` file, of OpenSim 4."""
    root = ElementTree.Element("OpenSimDocument", Version="40000")
    model = ElementTree.SubElement(root, "Model", name="mocapella")
    _leaf(model, "length_units", "meters")
    _leaf(model, "force_units", "N")
    _leaf(model, "gravity", "0 -9.80665 0")
    bodies, joints, markers = (_objects(model, kind) for kind in ("BodySet", "JointSet", "MarkerSet"))
    for segment in skeleton.segments:
        _add_body(bodies, segment)
        _add_joint(joints, segment)
    for name, (body, place) in skeleton.markers.items():
        marker = ElementTree.SubElement(markers, "Marker", name=name)
        _leaf(marker, "socket_parent_frame", f"/bodyset/{body}")
        _leaf(marker, "location", _numbers(place))
        _leaf(marker, "fixed", "true")
    return _text(root)


def scale_xml(skeleton: OpenSimSkeleton, begin_s: float, end_s: float) -> str:
    """Return the text of the set-up of OpenSim's scaling: each body by the mean distances of marker pairs.

    Args:
        skeleton: the skeleton.
        begin_s, end_s: times of the TRC between which all markers of the pairs are known [s].
    """
    root = ElementTree.Element("OpenSimDocument", Version="40000")
    tool = ElementTree.SubElement(root, "ScaleTool", name="mocapella")
    for name in ("mass", "height", "age"):
        _leaf(tool, name, f"{MASS_KG:g}" if name == "mass" else "-1")
    _leaf(ElementTree.SubElement(tool, "GenericModelMaker"), "model_file", "model.osim")
    scaler = ElementTree.SubElement(tool, "ModelScaler")
    _leaf(scaler, "apply", "true")
    _leaf(scaler, "scaling_order", "measurements")
    found = _objects(scaler, "MeasurementSet")
    for name, (pairs, scaled) in measurements(skeleton).items():
        one = ElementTree.SubElement(found, "Measurement", name=name)
        _leaf(one, "apply", "true")
        listed = _objects(one, "MarkerPairSet")
        for pair in pairs:
            _leaf(ElementTree.SubElement(listed, "MarkerPair"), "markers", " ".join(pair))
        listed = _objects(one, "BodyScaleSet")
        for body, axes in scaled.items():
            _leaf(ElementTree.SubElement(listed, "BodyScale", name=body), "axes", axes)
    _leaf(scaler, "marker_file", "markers.trc")
    _leaf(scaler, "time_range", f"{begin_s:.6f} {end_s:.6f}")
    _leaf(scaler, "preserve_mass_distribution", "true")
    _leaf(scaler, "output_model_file", "scaled.osim")
    _leaf(scaler, "output_scale_file", "scale_factors.xml")
    return _text(root)


def measurements(skeleton: OpenSimSkeleton) -> dict[str, tuple[list[tuple[str, str]], dict[str, str]]]:
    """Return the measurements of the scaling: pairs of markers, and the axes of the bodies that they scale, by name."""
    point = {**skeleton.points, **{name: name for name in skeleton.made}}
    wanted: dict[str, tuple[list[tuple[str, str]], dict[str, str]]] = {
        "pelvis_width": ([("hip_r", "hip_l")], {"pelvis": "Z"}),
        "shoulder_width": ([("shoulder_r", "shoulder_l")], {"torso": "Z"}),
    }
    if "lumbar" in point:
        wanted["pelvis_height"] = ([("hips_middle", "lumbar")], {"pelvis": "X Y"})
        wanted["torso_height"] = ([("lumbar", "shoulders_middle")], {"torso": "X Y"})
    else:
        wanted["torso_height"] = ([("hips_middle", "shoulders_middle")], {"torso": "X Y", "pelvis": "X Y"})
    for side in "rl":
        heel = f"sole_{side}" in point
        if heel:
            wanted[f"foot_height_{side}"] = ([(f"ankle_{side}", f"sole_{side}")], {f"foot_{side}": "Y"})
        for name, ends, body in (
            ("thigh", ("hip", "knee"), "femur"), ("shank", ("knee", "ankle"), "tibia"),
            ("foot", ("heel" if heel else "ankle", "toe"), "foot"), ("upper_arm", ("shoulder", "elbow"), "humerus"),
            ("forearm", ("elbow", "wrist"), "ulna"),
        ):  # fmt: skip
            wanted[f"{name}_{side}"] = (
                [(f"{ends[0]}_{side}", f"{ends[1]}_{side}")],
                {f"{body}_{side}": "X Z" if heel and body == "foot" else "X Y Z"},
            )
    return {
        name: ([(point[a], point[b]) for a, b in pairs], scaled)
        for name, (pairs, scaled) in wanted.items()
        if all(a in point and b in point for a, b in pairs)
    }


def ik_xml(skeleton: OpenSimSkeleton, end_s: float) -> str:
    """Return the text of the set-up of OpenSim's inverse kinematics of the scaled model.

    Args:
        skeleton: the skeleton.
        end_s: time of the last frame [s].
    """
    root = ElementTree.Element("OpenSimDocument", Version="40000")
    tool = ElementTree.SubElement(root, "InverseKinematicsTool", name="mocapella")
    _leaf(tool, "results_directory", ".")
    _leaf(tool, "model_file", "scaled.osim")
    _leaf(tool, "constraint_weight", "Inf")
    _leaf(tool, "accuracy", "1e-5")
    tasks = _objects(tool, "IKTaskSet")
    for point, name in skeleton.points.items():
        task = ElementTree.SubElement(tasks, "IKMarkerTask", name=name)
        _leaf(task, "apply", "true")
        _leaf(task, "weight", f"{WEIGHTS.get(point.removesuffix('_r').removesuffix('_l'), 10.0):g}")
    _leaf(tool, "marker_file", "markers.trc")
    _leaf(tool, "time_range", f"0 {end_s:.6f}")
    _leaf(tool, "report_errors", "true")
    _leaf(tool, "output_motion_file", "ik.mot")
    return _text(root)


def _add_body(bodies: ElementTree.Element, segment: _Segment) -> None:
    """Add a body with an ellipsoid along it, of its mass and moments of inertia."""
    kind = segment.body.removesuffix("_r").removesuffix("_l")
    mass, thick = MASS_KG * _SHARES[kind], _THICK[kind]
    half = max(float(np.linalg.norm(segment.end)) / 2, thick)
    centre = tuple(0.5 * value for value in segment.end)
    along = int(np.argmax(np.abs(segment.end)))
    radii = [half if axis == along else thick for axis in range(3)]
    inertia = [mass / 5 * (sum(r**2 for r in radii) - radii[axis] ** 2) for axis in range(3)]
    body = ElementTree.SubElement(bodies, "Body", name=segment.body)
    frame = ElementTree.SubElement(
        ElementTree.SubElement(body, "components"), "PhysicalOffsetFrame", name=f"{segment.body}_centre"
    )
    shape = ElementTree.SubElement(ElementTree.SubElement(frame, "attached_geometry"), "Ellipsoid",
                                   name=f"{segment.body}_shape")  # fmt: skip
    _leaf(shape, "socket_frame", "..")
    _leaf(shape, "radii", _numbers(radii))
    _leaf(frame, "socket_parent", "..")
    _leaf(frame, "translation", _numbers(centre))
    _leaf(body, "mass", f"{mass:.6f}")
    _leaf(body, "mass_center", _numbers(centre))
    _leaf(body, "inertia", _numbers([*inertia, 0.0, 0.0, 0.0]))


def _add_joint(joints: ElementTree.Element, segment: _Segment) -> None:
    """Add the joint at a body's origin; its rotations are about z, x and y, in this order."""
    joint = ElementTree.SubElement(joints, "CustomJoint", name=f"{segment.body}_joint")
    parent, child = f"{segment.parent}_offset", f"{segment.body}_offset"
    _leaf(joint, "socket_parent_frame", parent)
    _leaf(joint, "socket_child_frame", child)
    listed = ElementTree.SubElement(joint, "coordinates")
    for one in segment.coordinates:
        coordinate = ElementTree.SubElement(listed, "Coordinate", name=one.name)
        _leaf(coordinate, "default_value", "0")
        _leaf(coordinate, "range", "-10 10" if one.translation else f"{-2 * np.pi:.6f} {2 * np.pi:.6f}")
        _leaf(coordinate, "clamped", "false")
        _leaf(coordinate, "locked", "true" if one.locked else "false")
    frames = ElementTree.SubElement(joint, "frames")
    for name, body, at in ((parent, segment.parent, segment.at), (child, segment.body, (0.0, 0.0, 0.0))):
        frame = ElementTree.SubElement(frames, "PhysicalOffsetFrame", name=name)
        _leaf(frame, "socket_parent", "/ground" if body == "ground" else f"/bodyset/{body}")
        _leaf(frame, "translation", _numbers(at))
        _leaf(frame, "orientation", "0 0 0")
    transform = ElementTree.SubElement(joint, "SpatialTransform")
    turns = [one for one in segment.coordinates if not one.translation]
    shifts = [one for one in segment.coordinates if one.translation]
    for kind, used, axes in (("rotation", turns, (_Z, _X, _Y)), ("translation", shifts, (_X, _Y, _Z))):
        for k, axis in enumerate(axes):
            turning = used[k] if k < len(used) else None
            part = ElementTree.SubElement(transform, "TransformAxis", name=f"{kind}{k + 1}")
            if turning is not None:
                _leaf(part, "coordinates", turning.name)
            _leaf(part, "axis", _numbers(axis if turning is None else turning.axis))
            if turning is None:
                _leaf(ElementTree.SubElement(part, "Constant"), "value", "0")
            else:
                _leaf(ElementTree.SubElement(part, "LinearFunction"), "coefficients", "1 0")


def _objects(parent: ElementTree.Element, kind: str) -> ElementTree.Element:
    """Add a set of OpenSim's; return the element that lists its objects."""
    return ElementTree.SubElement(ElementTree.SubElement(parent, kind), "objects")


def _leaf(parent: ElementTree.Element, name: str, text: str) -> None:
    ElementTree.SubElement(parent, name).text = text


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8" ?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
