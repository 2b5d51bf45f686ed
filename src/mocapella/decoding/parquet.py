"""Read Parquet files within limits; see `mocapella.decoding`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from mocapella.decoding import FAULTS, FREE_UNPACKED, MOST_RATIO
from mocapella.errors import InputError

_LEAST_CELL: Final = 4
"""Least size of an unpacked number [bytes]."""


class ParquetTable:
    """A Parquet file that is read in blocks of rows.

    Args:
        polars: the library, imported.
        path: the file.
        fix: advice that errors name.

    Attributes:
        columns: the names of the file's columns.
        rows: number of rows.

    Raises:
        InputError: the file cannot be read, or unpacks to more than `FREE_UNPACKED` and `MOST_RATIO` times its size.
    """

    def __init__(self, polars: Any, path: Path, *, fix: str) -> None:
        self._polars, self._path, self._fix = polars, path, fix
        with self._faults():
            self._table = polars.scan_parquet(path, glob=False)
            self.columns: tuple[str, ...] = tuple(self._table.collect_schema().names())
            self.rows = int(self._table.select(polars.len()).collect().item())
            size = path.stat().st_size
        if self.rows * len(self.columns) * _LEAST_CELL > max(FREE_UNPACKED, MOST_RATIO * size):
            raise InputError(f"unpacks to more than {MOST_RATIO} times its size", file=path, fix=fix)

    def blocks(self, columns: Sequence[str], rows: int) -> Iterator[Any]:
        """Yield tables of polars with the columns, of so many rows each.

        Raises:
            InputError: the content is damaged; earlier blocks have been yielded.
        """
        for first in range(0, self.rows, rows):
            with self._faults():
                yield self._table.select(columns).slice(first, rows).collect()

    @contextmanager
    def _faults(self) -> Iterator[None]:
        errors = self._polars.exceptions
        try:
            yield
        except OSError as error:
            # polars gives its own texts, of several lines, as the error's only argument
            problem = f"cannot be read: {error.strerror}" if error.strerror else "is damaged, or is no Parquet file"
            raise InputError(problem, file=self._path, fix=self._fix) from None
        except (errors.PolarsError, errors.PanicException, *FAULTS):
            raise InputError("is damaged, or is no Parquet file", file=self._path, fix=self._fix) from None
