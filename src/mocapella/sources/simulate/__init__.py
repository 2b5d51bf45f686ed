"""A simulated room: articulated people, obstacles, and sensors that see them as a Kinect v2 would.

    room = load_scene("obstacle", seed=1)
    for item in SimulatedSensor(room, "front").frames(0.0, 10.0):
        item.due_s, item.frame, item.truth

``docs/simulation.md`` describes the models, their sources and their limits.
"""

from mocapella.sources.simulate.device import Noise, SensorSettings
from mocapella.sources.simulate.occlusion import Box, Cylinder
from mocapella.sources.simulate.room import PersonSettings, Room, SceneSettings, build_room
from mocapella.sources.simulate.scenes import load_scene, scene_names, scene_settings, scene_summaries, settings_from
from mocapella.sources.simulate.sensor import SimulatedFrame, SimulatedSensor, merge

__all__ = [
    "Box",
    "Cylinder",
    "Noise",
    "PersonSettings",
    "Room",
    "SceneSettings",
    "SensorSettings",
    "SimulatedFrame",
    "SimulatedSensor",
    "build_room",
    "load_scene",
    "merge",
    "scene_names",
    "scene_settings",
    "scene_summaries",
    "settings_from",
]
