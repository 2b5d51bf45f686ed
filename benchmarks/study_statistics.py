"""How often the tests of a study reject, without an effect and with one, in studies drawn from a normal distribution.

Ten participants with three placements and three tasks; participants differ by as much as their tasks scatter. The
effect is one standard deviation of the scatter, between the last placement and the others. With uneven spread, the
scatter of the three placements is as 1 : 2 : 4, as it grows with the distances of real studies.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row, at_most, measured
from mocapella.studies.inference import friedman, mean_test, mixed_effects, repeated_measures

EFFECTS: Final = ("placement", "task", "placement × task")
PARTICIPANTS: Final = 10
MISSING: Final = 0.15
"""Share of the combinations that are left out for the mixed model."""


def run(quick: bool = False) -> list[Row]:
    seeds = range(10 if quick else 100)
    rows = []
    for what, effect, growth in (("no effect", 0.0, 1.0), ("no effect, uneven spread", 0.0, 2.0), ("1 SD", 1.0, 1.0)):
        rejected = [rejections(seed, effect, growth) for seed in seeds]
        for name in rejected[0]:
            share = 100 * float(np.mean([one[name] for one in rejected]))
            goal = at_most(10.0) if not effect and not quick and name != "mixed model, gaps" else None
            rows.append(measured(f"study_statistics: {name} rejects, {what}", share, "%", goal=goal))
    return rows


def rejections(seed: int, effect: float, growth: float) -> dict[str, bool]:
    """Whether each test rejects at 5 % in one drawn study."""
    rng = np.random.default_rng(seed)
    values = (
        rng.normal(size=(PARTICIPANTS, 1, 1)) + rng.normal(size=(PARTICIPANTS, 3, 3)) * growth ** np.arange(3)[:, None]
    )
    values[:, 2] += effect
    p = {
        "one-sided t": mean_test(values[:, 2, 0], 0.0).p_above,
        "repeated measures, ε": repeated_measures(values, EFFECTS)[0].p_corrected,
        "Friedman": friedman("placement", values.mean(axis=2)).p,
        "mixed model, gaps": _with_gaps(values, rng),
    }
    return {name: one < 0.05 for name, one in p.items()}


def _with_gaps(values: NDArray[np.float64], rng: np.random.Generator) -> float:
    kept = [at for at in np.ndindex(*values.shape) if rng.random() >= MISSING]
    factors = [(f"placement {at[1]}", f"task {at[2]}") for at in kept]
    return mixed_effects([float(values[at]) for at in kept], factors, [str(at[0]) for at in kept], EFFECTS)[0].p
