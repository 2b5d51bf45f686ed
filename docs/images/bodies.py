"""Makes bodies.png: the bodies there are, at rest and moved.

python docs/images/bodies.py [FILE.png]

Needs matplotlib, of the extra plots.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_y
from mocapella.model.body_meshes import body_mesh, legs_mesh
from mocapella.model.body_proportions import BodyProportions
from mocapella.model.hand import hand_model
from mocapella.model.hand_mesh import hand_mesh, hand_mesh_angles
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.twist_tree import TreePose

LIGHT = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
SKIN = np.array([0.78, 0.62, 0.53])


def moved(mesh: RiggedMesh, **degrees: float) -> TreePose:
    """A pose of angles by their joints' names."""
    angles = np.zeros(len(mesh.joint_names))
    for name, value in degrees.items():
        angles[mesh.joint_names.index(name.replace("_", " "))] = np.radians(value)
    return TreePose(np.eye(4), angles)


def draw(axes, mesh: RiggedMesh, pose: TreePose, title: str, yaw: float) -> None:
    """Triangles from far to near, those that face away left out."""
    R = rotation_about_x(np.radians(8.0)) @ rotation_about_y(np.radians(yaw))
    turned = TreePose(rigid(R, np.zeros(3)) @ pose.T_world_model, pose.angles)
    corners = posed(mesh, turned)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1)[:, None], 1e-12)
    seen = np.flatnonzero(normals[:, 2] > 0)
    order = seen[np.argsort(corners[seen, :, 2].mean(axis=1))]
    shade = (0.3 + 0.7 * np.clip(normals[order] @ LIGHT, 0.0, 1.0))[:, None] * SKIN
    axes.add_collection(PolyCollection(corners[order, :, :2], facecolors=shade, edgecolors=shade, linewidths=0.3))
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.axis("off")
    axes.set_title(title, fontsize=9)


def main(file: Path) -> None:
    """Draw them."""
    man, woman = body_mesh("male", detail=2.0), body_mesh("female", detail=2.0)
    walks = moved(
        woman, left_hip_flexion=30, left_knee_flexion=15, right_hip_flexion=-20, right_knee_flexion=35,
        left_shoulder_swing_forwards=-25, right_shoulder_swing_forwards=35, left_shoulder_raise_sidewards=-32,
        right_shoulder_raise_sidewards=-32, right_elbow_flexion=40, left_elbow_flexion=25, waist_bend_forwards=6,
    )  # fmt: skip
    broad = body_mesh("male", 1.9, BodyProportions(girth=1.25), detail=2.0)
    legs = legs_mesh("male", detail=2.0)
    model = hand_model("full")
    hand = hand_mesh(model.shape("left"), detail=1.5)
    upright = rigid(rotation_about_x(-np.pi / 2), np.zeros(3))
    relaxed = TreePose(upright, hand_mesh_angles(hand, model.natural))
    shown = [
        (man, moved(man), "body_mesh('male')", 20.0),
        (woman, moved(woman), "body_mesh('female')", 20.0),
        (woman, walks, "moved", 60.0),
        (broad, moved(broad), "girth=1.25", 20.0),
        (legs, moved(legs, left_hip_flexion=60, left_knee_flexion=80), "legs_mesh('male')", 40.0),
        (hand, relaxed, "hand_mesh(…)", 30.0),
    ]
    figure = Figure(figsize=(13, 3.6), layout="constrained")
    for axes, (mesh, pose, title, yaw) in zip(figure.subplots(1, len(shown)), shown, strict=True):
        draw(axes, mesh, pose, title, yaw)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "bodies.png")
