"""The ROOM stage's drawing and title of a scene; any error of a drawing fails the test."""

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
