"""Two cameras see one spot once, and its number stays."""

from mocapella.model.observations import Arrival
from mocapella.testing import check_frame_type, check_part_type, check_tracker
from mocapella.tracker import make_tracker
from mocapella_thermal.frame import HeatFrame
from mocapella_thermal.spots import Spot

ARRIVALS = [
    Arrival(HeatFrame(camera, 1, k, k, k, ((x, 0.0, 36.5),)), k)
    for k in range(10)
    for camera, x in (("north", 0.1 * k), ("south", 0.1 * k - 1.0))
]


def test_a_spot_that_two_cameras_see_is_one_and_keeps_its_number() -> None:
    scenes = check_tracker(lambda: make_tracker("heat", settings={"places": {"south": [1.0, 0.0]}}), ARRIVALS)
    (spot,) = scenes[-1].of("spots")
    assert (spot.id, spot.cameras) == (0, ("north", "south"))
    assert abs(spot.x - 0.9) < 1e-9


def test_frames_and_spots_survive_their_codecs() -> None:
    check_frame_type(HeatFrame("north", 1, 2, 3, 4, ((0.5, 0.0, 36.5), (0.1, 0.2, 60.0))))
    check_part_type("spots", Spot(3, 0.5, 0.0, 36.5, ("north", "south")))
