"""Kernels that read the rows of a study log's text. Importing imports numba."""

# ruff: noqa: PLR0912, PLR0917, SIM110 - kernels take arrays by position and write loops out
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

INTEGER, FLOAT, TEXT = range(3)
"""Kinds of columns."""
_SPACE, _TAB, _NEWLINE, _COMMA, _PLUS, _MINUS, _POINT, _ZERO = (ord(c) for c in " \t\n,+-.0")
_SMALL_E, _LARGE_E = ord("e"), ord("E")
_EXACT = 2**53
_POWERS = 10.0 ** np.arange(23)
"""Powers of ten that are exact in double precision."""
_REMEMBERED = 8
"""Number of latest texts that a text is compared with."""
_MOST_DIGITS = 18


@njit(cache=True, nogil=True, error_model="numpy")
def _same(data: UInt8, a: int, a_end: int, b: int, b_end: int) -> bool:
    if a_end - a != b_end - b:
        return False
    for k in range(a_end - a):
        if data[a + k] != data[b + k]:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _is_end(byte: int) -> bool:
    return byte in (_COMMA, _NEWLINE)


@njit(cache=True, nogil=True, error_model="numpy")
def _number(data: UInt8, at: int, whole: bool) -> tuple[np.int64, int, int, bool]:
    """Read a number without sign: return its digits, the power of ten, the place behind it, and whether it is plain.

    A plain number has at most 18 digits that matter. The data end with a newline.
    """
    value = np.int64(0)
    exponent = 0
    count = 0
    begin = at
    digit = np.int64(data[at]) - _ZERO
    while 0 <= digit <= 9:
        value = value * 10 + digit
        count += 1 if digit > 0 or count > 0 else 0
        at += 1
        digit = np.int64(data[at]) - _ZERO
    written = at - begin
    if data[at] == _POINT and not whole:
        at += 1
        begin = at
        digit = np.int64(data[at]) - _ZERO
        while 0 <= digit <= 9:
            value = value * 10 + digit
            count += 1 if digit > 0 or count > 0 else 0
            at += 1
            digit = np.int64(data[at]) - _ZERO
        exponent = begin - at
        written -= exponent
    if (data[at] == _SMALL_E or data[at] == _LARGE_E) and written > 0 and not whole:
        at += 1
        down = data[at] == _MINUS
        if down or data[at] == _PLUS:
            at += 1
        begin = at
        power = np.int64(0)
        while at - begin < 4 and 0 <= np.int64(data[at]) - _ZERO <= 9:
            power = power * 10 + np.int64(data[at]) - _ZERO
            at += 1
        exponent += -int(power) if down else int(power)
        written = at - begin
    # More digits than these may have overflowed.
    return value, exponent, at, written > 0 and count <= _MOST_DIGITS


@njit(cache=True, nogil=True, error_model="numpy")
def read_rows(
    data: UInt8, kinds: Int64, places: Int64, integers: Int64, floats: Float64, codes: Int64, texts: Int64, odd: Int64
) -> tuple[int, int, int]:
    """Read all rows of a text; return the numbers of rows, of texts, and of odd cells.

    Args:
        data: the rows, each with a newline at its end; cells are separated by commas.
        kinds, places: (columns,) INTEGER, FLOAT or TEXT, and the column of the output; one column is TEXT.
        integers, floats: (rows, columns of the kind), written. A float is rounded once, as by Python.
        codes: (rows,), index in ``texts``, written.
        texts: (rows, 2) begin and end of different texts, written; equal ones that are far apart come again.
        odd: (cells, 4) row, column, begin and end of numbers that this kernel leaves to Python, written.

    Returns:
        The numbers; the first is −1 if a row has another number of cells, or there are too many odd cells.
    """
    row = text_count = odd_count = at = 0
    size = len(data)
    columns = len(kinds)
    while at < size:
        for column in range(columns):
            while data[at] == _SPACE or data[at] == _TAB:
                at += 1
            begin = at
            place = places[column]
            kind = kinds[column]
            plain = kind == TEXT
            if not plain:
                negative = data[at] == _MINUS
                if negative or data[at] == _PLUS:
                    at += 1
                value, exponent, at, plain = _number(data, at, kind == INTEGER)
                if kind == INTEGER:
                    integers[row, place] = -value if negative else value
                else:
                    number = np.float64(value)
                    plain &= value == 0 or (value <= _EXACT and -22 <= exponent <= 22)
                    if plain and value != 0:
                        number = number / _POWERS[-exponent] if exponent < 0 else number * _POWERS[exponent]
                    floats[row, place] = -number if negative else number
            while data[at] == _SPACE or data[at] == _TAB:
                at += 1
            plain &= kind == TEXT or _is_end(data[at])
            while not _is_end(data[at]):
                at += 1
            if (data[at] == _COMMA) != (column < columns - 1):
                return -1, 0, 0
            end = at
            at += 1
            if plain and kind != TEXT:
                continue
            while end > begin and (data[end - 1] == _SPACE or data[end - 1] == _TAB):
                end -= 1
            if kind != TEXT:
                if odd_count == len(odd):
                    return -1, 0, 0
                odd[odd_count, 0], odd[odd_count, 1], odd[odd_count, 2], odd[odd_count, 3] = row, column, begin, end
                odd_count += 1
                continue
            code = text_count
            for k in range(text_count - 1, max(-1, text_count - 1 - _REMEMBERED), -1):
                if _same(data, texts[k, 0], texts[k, 1], begin, end):
                    code = k
                    break
            if code == text_count:
                texts[code, 0], texts[code, 1] = begin, end
                text_count += 1
            codes[row] = code
        row += 1
    return row, text_count, odd_count


@njit(cache=True, nogil=True, error_model="numpy")
def place_joints(cells: Float64, absent: float, farthest: float, nearest: float, positions: Float32) -> bool:
    """Write positions (rows, joints, 3) of cells (rows, 3 × joints); return whether all joints are valid.

    A joint is NaN if it is ``absent`` in all three cells, or all are nearer to 0 than ``nearest``. It is invalid if it
    is absent in some cells, or has a cell of the absolute value ``farthest`` or more.
    """
    for row in range(len(cells)):
        for joint in range(positions.shape[1]):
            x, y, z = cells[row, 3 * joint], cells[row, 3 * joint + 1], cells[row, 3 * joint + 2]
            count = int(x == absent) + int(y == absent) + int(z == absent)
            largest = max(abs(x), abs(y), abs(z))
            if (count == 0 and largest >= farthest) or 0 < count < 3:
                return False
            if count == 3 or largest < nearest:
                x = y = z = np.nan
            positions[row, joint, 0], positions[row, joint, 1], positions[row, joint, 2] = x, y, z
    return True
