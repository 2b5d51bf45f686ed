"""A board that is carried about before cameras, as views: everything true is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.geometry.twists import exp_twist
from mocapella.model.board import Board, BoardView

BOARD = Board("charuco", 6, 5, 0.06)
SIZE = (1280, 720)
LENSES = np.array([
    [900.0, 905.0, 630.0, 350.0, -0.3, 0.1, 0.001, -0.001, -0.01],
    [780.0, 776.0, 650.0, 365.0, 0.08, -0.1, -0.002, 0.001, 0.0],
    [820.0, 822.0, 641.0, 371.0, -0.1, 0.05, 0.0, 0.002, 0.01],
])  # fmt: skip


@dataclass(frozen=True)
class Filmed:
    """Views, and what is true of them."""

    views: list[BoardView]
    lenses: np.ndarray
    T_camera_first: np.ndarray


def film(
    cameras: int = 2,
    instants: int = 20,
    noise_px: float = 0.0,
    seed: int = 0,
    *,
    flat: bool = False,
    nearer: float = 1.0,
) -> Filmed:
    """Cameras that stand around a board at 0.9 m; ``flat``: it is always parallel to the first one's picture."""
    rng = np.random.default_rng(seed)
    yaw = np.radians([0.0, 35.0, -40.0][:cameras])
    middle = np.array([0.0, 0.0, 0.9 / nearer])
    R_camera_first = rotation_about_y(yaw) @ rotation_about_x(np.radians([0.0, -8.0, 10.0][:cameras]))
    T = rigid(R_camera_first, middle - (R_camera_first @ middle[:, None])[:, :, 0])
    centre = BOARD.corners_m.mean(axis=0)
    views = []
    for k in range(instants):
        turn = np.zeros(3) if flat else rng.uniform([-0.6, -0.6, -0.5], [0.6, 0.6, 0.5])
        R = exp_twist(np.r_[np.zeros(3), turn])[:3, :3]
        at = middle + rng.uniform([-0.25, -0.15, -0.15], [0.25, 0.15, 0.15])
        T_first_board = rigid(R, at - R @ centre)
        for c in range(cameras):
            pixel = project(apply(T[c] @ T_first_board, BOARD.corners_m), LENSES[c])
            pixel = pixel + noise_px * rng.standard_normal(pixel.shape)
            inside = ((pixel > 0) & (pixel < np.array(SIZE) - 1)).all(axis=1)
            if inside.any():
                views.append(BoardView(f"c{c}", k, SIZE, np.flatnonzero(inside), pixel[inside]))
    return Filmed(views, LENSES[:cameras], T)


def to_first(T_camera_world: list[np.ndarray]) -> np.ndarray:
    """(cameras, 4, 4) ``T_camera_first``, whatever the world."""
    return np.array([T @ inverse(T_camera_world[0]) for T in T_camera_world])
