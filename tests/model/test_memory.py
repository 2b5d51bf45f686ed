"""Laws of remembering: what is packed comes out again, and nothing else can be made of bytes."""

from __future__ import annotations

import pickle
from collections import Counter, deque
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mocapella.errors import InputError, MocapellaError, WireError
from mocapella.model.memory import pack, recalls, recorded_name, set_memory, unpack
from mocapella.model.scene import Phase, TrackerState
from mocapella.model.session import SensorPose
from mocapella.model.topology import topology

KINDS = (Phase, TrackerState, SensorPose)
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary()
    | st.builds(TrackerState, phase=st.sampled_from(Phase), reason=st.text())
    | st.just(SensorPose(0.1, 2.0))
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: (
        st.lists(inner)
        | st.lists(inner).map(tuple)
        | st.lists(inner).map(lambda items: deque(items, maxlen=7))
        | st.dictionaries(st.tuples(st.text(), st.integers(0, 9)), inner)
        | st.frozensets(st.text())
        | st.sets(st.integers(0, 99))
        | st.dictionaries(st.text(), st.integers(1, 9)).map(Counter)
    ),
    max_leaves=12,
)


@given(VALUES)
def test_what_is_packed_comes_out_again(value: Any) -> None:
    back = unpack(pack(value, KINDS), KINDS)
    assert back == value
    assert type(back) is type(value)
    if isinstance(value, deque):
        assert back.maxlen == value.maxlen


@given(st.lists(st.floats(), max_size=30), st.sampled_from(["f4", "f8"]))
def test_arrays_come_out_to_the_bit_and_can_be_written_to(values: list[float], dtype: str) -> None:
    with np.errstate(over="ignore"):
        array = np.array(values).astype(dtype).reshape(1, -1)
    back = unpack(pack(array, ()), ())
    assert (back.dtype, back.shape, back.tobytes()) == (array.dtype, array.shape, array.tobytes())
    back[...] = 1


def test_a_topology_is_the_one_there_is() -> None:
    assert unpack(pack(topology("kinect_v1"), ()), ()) is topology("kinect_v1")


def test_what_is_not_named_is_not_packed() -> None:
    with pytest.raises(TypeError, match="SensorPose"):
        pack([SensorPose()], (Phase,))


@given(st.binary(max_size=80))
@example(b"\xd5\x00\x00\x00")  # an extension of msgpack
@example(b"\x80")  # a mapping that is not one of ours
def test_bytes_that_are_not_ours_make_nothing(data: bytes) -> None:
    try:
        value = unpack(data, KINDS)
    except WireError:
        return
    assert isinstance(value, int | float | str | bytes | bool | type(None) | list | tuple | set)


@pytest.mark.parametrize(
    "value",
    [["SensorPose", {"tilt": 9.0}], ["SensorPose", {"x": 1}], ["os.system", "x"], ["array", ["f8", [3], b"12"]], ["x"]],
)
def test_a_kind_or_content_that_is_not_known_is_refused(value: Any) -> None:
    with pytest.raises(MocapellaError, match=r"no memory of this tracker|tilt is 9"):
        unpack(msgspec.msgpack.encode(value), KINDS)
    with pytest.raises(WireError):
        unpack(pickle.dumps(Phase.TRACKING), KINDS)


class Renamed(msgspec.Struct, frozen=True):
    RECORDED_AS: ClassVar[str] = "Former"

    value: int


class Derived(Renamed, frozen=True):
    other: int = 0


def test_a_renamed_class_is_written_and_read_by_its_former_name() -> None:
    data = pack([Renamed(3), Derived(4)], (Renamed, Derived))
    assert msgspec.msgpack.decode(data) == ["list", [["Former", {"value": 3}], ["Derived", {"value": 4, "other": 0}]]]
    assert unpack(data, (Renamed, Derived)) == [Renamed(3), Derived(4)]
    assert (recorded_name(Renamed), recorded_name(Derived)) == ("Former", "Derived")
    with pytest.raises(WireError):
        unpack(msgspec.msgpack.encode(["Renamed", {"value": 3}]), (Renamed,))


@pytest.mark.parametrize("dtype", ["O", "(1,)f4,{", "|O8", "f4,f4", "<f8" * 99, "datetime64[s]", 5, None, ["f4"]])
def test_an_array_of_other_than_plain_numbers_is_refused(dtype: Any) -> None:
    """numpy evaluates some texts of types as Python, which raises a SyntaxError."""
    with pytest.raises(WireError):
        unpack(msgspec.msgpack.encode(["array", [dtype, [1], bytes(8)]]), ())


def test_a_deep_memory_is_refused() -> None:
    with pytest.raises(WireError):
        unpack(b"\x92\xa4list\x91" * 20_000, ())
    assert unpack(msgspec.msgpack.encode(["list", [["list", []]]]), ()) == [[]]


@pytest.mark.parametrize("name", ["of\ntwo lines", "\x1b[2J", "\u202e"])
def test_what_a_refused_memory_says_is_one_printable_line(name: str) -> None:
    with pytest.raises(WireError) as told:
        unpack(msgspec.msgpack.encode([name, 0]), ())
    assert str(told.value).isprintable()


@pytest.mark.parametrize("content", [np.eye(4), "of\ntwo lines"])
def test_what_a_tracker_says_of_a_refused_memory_is_one_printable_line(content: Any) -> None:
    class Tracker:
        def reset(self) -> None:
            pass

        @recalls
        def restore(self, data: bytes) -> None:
            raise ValueError(content)

    with pytest.raises(WireError) as told:
        Tracker().restore(b"")
    assert str(told.value).isprintable()


@pytest.mark.parametrize("error", [TypeError("too few"), KeyError("name"), WireError("3 bytes"), InputError("no")])
def test_a_tracker_that_cannot_recall_a_memory_is_reset(error: Exception) -> None:
    class Forgetful:
        resets = 0

        def reset(self) -> None:
            self.resets += 1

        @recalls
        def restore(self, data: bytes) -> None:
            self.reset, self.resets = None, 7  # type: ignore[method-assign,assignment]
            raise error

    tracker = Forgetful()
    with pytest.raises(WireError, match="3 bytes"):
        tracker.restore(b"abc")
    assert tracker.resets == 1


@pytest.mark.parametrize("memory", [{"settings": "none"}, {"reset": 5}, {"settings": None}, {"inner": 5}])
def test_a_memory_sets_no_settings_of_another_type_and_no_method(memory: dict[str, Any]) -> None:
    class Inner:
        def reset(self) -> None:
            pass

    class Part:
        def __init__(self) -> None:
            self.settings, self.count = SensorPose(0.1, 2.0), 0
            self.inner = Inner()

        def reset(self) -> None:
            self.count = 0

    part = Part()
    with pytest.raises(ValueError, match="cannot be recalled"):
        set_memory(part, {"count": 3, **memory})
    assert part.count == 0
    set_memory(part, {"count": 3, "settings": SensorPose(0.2, 1.0)})
    assert (part.count, part.settings) == (3, SensorPose(0.2, 1.0))
