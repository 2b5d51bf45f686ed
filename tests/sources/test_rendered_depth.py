"""A rendered depth scene as a source: each image when it is due, with the camera's own unit and lens."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.sources.depth_options import DepthOptions, complete
from mocapella.sources.open_depth import open_depth
from mocapella.sources.simulate.rendered_depth import RenderedDepth

STOP = threading.Event()
LENS = (12.0, 12.0, 7.5, 5.5, 0.0, 0.0, 0.0, 0.0, 0.0)


class Scene:
    """Its image tells when it was rendered, in milliseconds."""

    sensor = SimpleNamespace(size_px=(16, 12), unit_m=0.0005)
    lens = np.array(LENS)

    def at(self, at_s: float) -> Any:
        return SimpleNamespace(depth=np.full((12, 16), round(1000 * at_s), np.uint16))


def test_images_are_of_the_instants_at_which_they_are_due() -> None:
    now = [100.0]
    source = RenderedDepth(Scene(), "rendered:scene", DepthOptions(fps=50.0), clock=lambda: now[0])
    state = source.open()
    assert (state.size_px, state.fps, state.unit_m, state.lens) == ((16, 12), 50.0, 0.0005, LENS)
    source.begin(100.0)
    stopped = threading.Event()
    first = source.read(STOP)
    now[0] = 100.5  # nobody has looked for half a second: what was due meanwhile is left out
    second = source.read(STOP)
    assert first is not None
    assert second is not None
    assert (first.time_ns, int(first.image[0, 0]), first.number) == (1, 0, 0)
    assert (second.time_ns, int(second.image[0, 0]), second.number) == (500_000_001, 500, 1)
    stopped.set()
    assert source.read(stopped) is None
    assert complete(state, source.name).size_px == (16, 12)


def test_the_door_opens_a_scene_by_name_seed_and_sensor() -> None:
    pytest.importorskip("mocapella.sources.simulate.depth_scene", reason="comes with the renderer")
    from mocapella.sources.simulate.depth_scene import depth_scene_names

    name = depth_scene_names()[0]
    for text, seed in ((f"rendered:{name}", 0), (f"rendered:{name}/7", 7), (f"rendered:{name}/7/sr305", 7)):
        source = open_depth(text)
        assert isinstance(source, RenderedDepth)
        assert (source.scene.name, source.scene.seed, source.name) == (name, seed, text)
    for text, named in (("rendered:nothing", "unknown scene"), (f"rendered:{name}/x", "rendered:NAME/SEED/SENSOR")):
        with pytest.raises(SettingsError, match=named):
            open_depth(text)
