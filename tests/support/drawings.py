"""The ROOM stage's drawing and title of a scene; any error of a drawing fails the test."""

import numpy as np

from mocapella.viewer.palette import FILLED, FUSED, INFERRED
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.stage import StageView, TrackingDrawing
from mocapella.viewer.stages import ROOM
from mocapella.viewer.tracking_stage import tracking_title as title_of


class Strict(PluginErrors):
    """Raises what it is told."""

    def tell(self, what: str, error: Exception) -> None:
        raise error


def tracking_drawing(scene, perspective, seen, floors) -> TrackingDrawing:
    return ROOM.draw(scene, scene, StageView(perspective, seen, floors, Strict()))


def tracking_title(drawing, perspective):
    return title_of(ROOM, drawing, perspective)


def is_fused(drawing: TrackingDrawing) -> np.ndarray:
    """(bones,) which strokes are of fused skeletons."""
    fused = [FUSED, FILLED.paint, INFERRED.paint]
    return np.any([(drawing.bones.colours == colour).all(axis=1) for colour in fused], axis=0)
