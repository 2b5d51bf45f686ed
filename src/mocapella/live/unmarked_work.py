"""Processing of a camera's images without markers: the newest image, and the refusal of colours."""

from __future__ import annotations

import numpy as np

from mocapella.errors import NotNowError
from mocapella.live.marker_work import DetectedPicture
from mocapella.model.markers import marker_frame
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.markers import MarkerDetector
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture


class UnmarkedWork:
    """The part of a `mocapella.live.camera_service.PictureWork` that is the same for all nodes without markers.

    Args:
        camera: the camera's name.
        acquisition: source of the images; used for its reports only.
        refusal: why colours are refused; names the node that detects markers.

    Attributes:
        newest: the last processed image; None before the first.
        detector: None; there are no markers.
    """

    def __init__(self, camera: str, acquisition: Acquisition, refusal: str) -> None:
        self.camera, self.acquisition, self._refusal = camera, acquisition, refusal
        self.newest: DetectedPicture | None = None
        self.detector: MarkerDetector | None = None

    def keep(self, picture: Picture) -> None:
        """Keep an image (height, width, 3) uint8 BGR as ``newest``, without markers."""
        nothing = marker_frame(
            self.camera, (), time_ns=picture.time_ns, size_px=picture.size_px, positions_px=np.zeros((0, 2))
        )
        self.newest = DetectedPicture(picture, nothing, None)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of markers: none."""
        return ()

    def use(self, profile: ColourProfile) -> None:
        """Refuse colours.

        Raises:
            NotNowError: always; names the node that detects markers.
        """
        raise NotNowError(self._refusal)
