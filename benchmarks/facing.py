"""Which way people face: what a frame costs, and how many labels are wrong in simulated rooms.

The peer is the same in numpy, for all bodies of a frame at once, as the training computes it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.harness import Row, against_peer, at_most, measured
from mocapella.evaluation.facing_simulation import simulated_figures
from mocapella.fusion.facing import FacingFilter
from mocapella.fusion.facing_grid import STEP_S, circular_sd, most_likely_angle, turned_on, unknown
from mocapella.fusion.facing_model import shipped_model, untrained
from mocapella.fusion.facing_shape import view_of
from mocapella.fusion.facing_training import believed, evidence
from mocapella.model.topology import topology
from mocapella.sources.simulate import load_scene

BODIES: Final = 6
SENSORS: Final = ("front", "right", "back", "left")
SCENES: Final = ("walk", "obstacle", "exchange", "around", "self-occlusion", "crowd")
TOPOLOGY: Final = topology("kinect_v2")


def run(quick: bool = False) -> list[Row]:
    rows = [cost(quick)]
    for model, name in ((shipped_model(), "shipped model"), (untrained(), "untrained")):
        for scene in SCENES[:2] if quick else SCENES:
            figures = simulated_figures(load_scene(scene), FacingFilter(TOPOLOGY, model=model), 10.0 if quick else 40.0)
            what = f"facing: wrong labels, simulated {scene}, {name}"
            goal = at_most(1.0) if name == "shipped model" else None
            rows.append(measured(what, figures.wrong_percent, "%", goal=goal))
    return rows


def cost(quick: bool) -> Row:
    """Of one frame that shows `BODIES` people, in turn of each of `SENSORS`."""
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(BODIES, len(TOPOLOGY), 3))
    toward, velocities = rng.uniform(-np.pi, np.pi, BODIES), rng.normal(size=(BODIES, 3))
    facings, people, model, frame = FacingFilter(TOPOLOGY), list(range(BODIES)), shipped_model(), 0
    p = p_angle = np.broadcast_to(unknown(), (BODIES, len(unknown())))
    angles = replace(facings.settings, shape_weight=0.0)

    def ours() -> None:
        nonlocal frame
        frame += 1
        sensor = SENSORS[frame % len(SENSORS)]
        facings.update(sensor, people, positions, toward, frame / 30 / len(SENSORS), velocities)

    def peer() -> None:
        nonlocal p, p_angle
        view, steps = view_of(positions, toward, TOPOLOGY), 1 / 30 / len(SENSORS) / STEP_S
        all_of_it, of_angle = (evidence(view, toward, model, s, np.ones(BODIES)) for s in (facings.settings, angles))
        motion = facings.settings.motion_weight * model.motion_evidence(velocities)
        p = believed(turned_on(p, steps), all_of_it + motion)
        p_angle = believed(turned_on(p_angle, steps), of_angle + motion)
        most_likely_angle(p, p_angle), circular_sd(p)

    number = 100 if quick else 1000
    name = f"facing: a frame of {BODIES} bodies"
    return against_peer(name, ours, peer, "numpy", goal=at_most(5.0 * BODIES), number=number)
