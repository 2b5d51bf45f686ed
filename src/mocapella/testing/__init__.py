"""Fakes and checks for the tests of plug-ins, and of programs that use Mocapella.

    from mocapella.testing import check_frame_type, check_tracker, walking_arrivals

    check_frame_type(MyFrame(...))                                 # codec: to bytes and back, damaged bytes
    check_tracker(lambda: make_tracker("mine"), my_arrivals)       # repeatable, restored to the bit

Nothing here needs pytest: a failed check raises `AssertionError` and says what differs. Mocapella's own tests use this
package; the program itself never imports it. ``docs/extending.md`` shows it at work.
"""

from mocapella.testing.camera import FakeCamera
from mocapella.testing.codecs import check_frame_type, check_part_type
from mocapella.testing.frames import example_frames
from mocapella.testing.server import FakeServer, sensor_health, session_status
from mocapella.testing.trackers import check_tracker
from mocapella.testing.walking import Walker, WalkerSensor, standing_at, walking_arrivals

__all__ = [
    "FakeCamera",
    "FakeServer",
    "Walker",
    "WalkerSensor",
    "check_frame_type",
    "check_part_type",
    "check_tracker",
    "example_frames",
    "sensor_health",
    "session_status",
    "standing_at",
    "walking_arrivals",
]
