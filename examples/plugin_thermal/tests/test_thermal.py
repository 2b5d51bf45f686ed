"""Two cameras see one spot once, and its number stays."""

from mocapella.model.observations import Arrival
from mocapella.schema import decode_frame, decode_scene, encode_frame, encode_scene
from mocapella.tracker import make_tracker
from mocapella_thermal.frame import HeatFrame


def test_a_spot_that_two_cameras_see_is_one_and_keeps_its_number() -> None:
    tracker = make_tracker("heat", settings={"places": {"south": [1.0, 0.0]}})
    for k in range(10):
        for camera, x in (("north", 0.1 * k), ("south", 0.1 * k - 1.0)):
            frame = decode_frame(encode_frame(HeatFrame(camera, 1, k, k, k, ((x, 0.0, 36.5),))))
            scene = decode_scene(encode_scene(tracker.update(Arrival(frame, k))))
    (spot,) = scene.of("spots")
    assert (spot.id, spot.cameras) == (0, ("north", "south"))
    assert abs(spot.x - 0.9) < 1e-9


def test_a_tracker_goes_on_from_a_snapshot() -> None:
    one, other = make_tracker("heat"), make_tracker("heat")
    arrivals = [Arrival(HeatFrame("north", 1, k, k, k, ((0.1 * k, 0.0, 36.5),)), k) for k in range(4)]
    for arrival in arrivals[:2]:
        one.update(arrival)
    other.restore(one.snapshot())
    assert [encode_scene(one.update(a)) for a in arrivals[2:]] == [encode_scene(other.update(a)) for a in arrivals[2:]]
