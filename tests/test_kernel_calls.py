"""Calls of kernels by their entry points are those of numba's dispatcher, whatever the arguments are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import typeof

from mocapella.compiled import njit
from mocapella.kernel_calls import KernelCall


def types_of(*arguments: Any) -> tuple[Any, ...]:
    """The numba types of arguments."""
    return tuple(typeof(one) for one in arguments)  # type: ignore[no-untyped-call]


class One(NamedTuple):
    value: Any


class Two(NamedTuple):
    first: Any
    second: Any


class OtherTwo(NamedTuple):
    first: Any
    second: Any


class OwnArray(np.ndarray):
    pass


class Dispatcher:
    """A stand-in for a kernel: returns the types of the arguments, and an entry point returns those it was made for."""

    def __init__(self) -> None:
        self.overloads: dict[Any, Any] = {}
        self.entries = 0

    def __call__(self, *arguments: Any) -> Any:
        types = types_of(*arguments)

        def entry_point(*_: Any) -> Any:
            self.entries += 1
            return types

        self.overloads[types] = SimpleNamespace(entry_point=entry_point)
        return types


def _array(dtype: str, shape: tuple[int, ...], layout: str) -> np.ndarray:
    if layout == "strided":
        return np.zeros((*shape[:-1], 2 * shape[-1]), dtype=dtype)[..., ::2]
    made = np.zeros(shape, dtype=dtype, order="F" if layout == "F" else "C")
    made.flags.writeable = layout != "read only"
    return made


arrays = st.builds(
    _array,
    st.sampled_from(["<f8", "<f4", "<i8", "<u8", "?"]),
    st.sampled_from([(0,), (1,), (3,), (2, 3), (0, 3), (2, 2, 2)]),
    st.sampled_from(["C", "F", "strided", "read only"]),
)
scalars = st.sampled_from([None, True, 0, -1, 2**62, 2**63, 0.5, np.float64(0.5), np.int64(1), np.uint8(1)])
single = st.one_of(arrays, scalars, st.text(max_size=2))
values = st.recursive(
    single,
    lambda parts: st.one_of(
        st.builds(One, parts),
        st.builds(Two, parts, parts),
        st.builds(OtherTwo, parts, parts),
        st.tuples(parts),
        st.tuples(parts, parts),
    ),
    max_leaves=4,
)


@given(st.lists(values, min_size=1, max_size=4), st.data())
def test_arguments_of_any_types_give_the_kernels_own_result(pool: list[Any], data: st.DataObject) -> None:
    kernel = KernelCall(Dispatcher())
    for _ in range(8):  # from a pool, so that arguments come again as the same objects
        arguments = data.draw(st.lists(st.sampled_from(pool), min_size=1, max_size=2))
        assert kernel(*arguments) == types_of(*arguments)


@given(values.filter(lambda value: not isinstance(value, str)))
def test_the_same_arguments_again_give_the_same_result(value: Any) -> None:
    kernel = KernelCall(Dispatcher())
    assert kernel(value) == kernel(value) == types_of(value)


def test_a_new_array_of_the_same_type_goes_past_the_dispatcher() -> None:
    dispatcher = Dispatcher()
    kernel = KernelCall(dispatcher)
    for rows in (1, 2, 3):
        kernel(Two(np.zeros((rows, 3)), np.zeros(4)), 1.0 * rows)
    assert dispatcher.entries == 2


def test_a_subclass_of_arrays_goes_through_the_dispatcher() -> None:
    dispatcher = Dispatcher()
    kernel = KernelCall(dispatcher)
    for _ in range(3):
        kernel(One(np.zeros(3)), 1.0)
    assert dispatcher.entries == 2
    for kind in ("<f8", "<f4"):
        own = np.zeros(3, dtype=kind).view(OwnArray)
        assert kernel(One(own), 1.0) == types_of(One(own), 1.0)
    assert dispatcher.entries == 2


def test_calls_of_one_kernel_share_its_entry_points() -> None:
    dispatcher = Dispatcher()
    KernelCall(dispatcher)(One(np.zeros(3)), 1.0)
    dispatcher.overloads.clear()  # so that only the shared entry point is left
    kernel = KernelCall(dispatcher)
    kernel(One(np.ones(3)), 2.0)
    before = dispatcher.entries
    assert kernel(One(np.zeros(3)), 3.0) == types_of(One(np.zeros(3)), 3.0)
    assert dispatcher.entries == before + 1


def test_a_kernel_without_overloads_is_called_itself() -> None:
    kernel = KernelCall(lambda value: value + 1)
    assert [kernel(1), kernel(1), kernel(2)] == [2, 2, 3]


def test_a_compiled_kernel_gets_every_new_argument() -> None:
    @njit()
    def total(pair: Two, factor: float) -> Any:
        return factor * (pair.first[0] + pair.second)

    kernel = KernelCall(total)
    sums = [kernel(Two(np.full(2, value), 1.0), factor) for value in (1.0, 2.0, 3.0) for factor in (1.0, 10.0)]
    assert sums == [2.0, 20.0, 3.0, 30.0, 4.0, 40.0]
    assert kernel(Two(np.array([5.0, 6.0, 7.0])[::-1], 1.0), 1.0) == 8.0  # not contiguous: compiled anew
