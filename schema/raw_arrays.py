"""Uncompressed Zarr v3 arrays, mapped into memory: a sample is a copy, without any decoding."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from breplake.errors import LakeFormatError
from breplake.schema.buffers import Buffers

__all__ = ["RawArray"]


class RawArray:
    """Rows of an array whose files hold whole rows as they are in memory.

    Files are mapped when they are first needed. A process may be forked and the array pickled:
    a mapping is inherited by a fork, and made anew where it is unpickled.

    Parameters
    ----------
    path : pathlib.Path
        The array's folder.

    Raises
    ------
    LakeFormatError
        If it is no Zarr v3 array, or its files are not raw.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            document = json.loads((path / "zarr.json").read_bytes())
            self.shape: tuple[int, ...] = tuple(document["shape"])
            self.dtype = np.dtype(document["data_type"])
            chunk = tuple(document["chunk_grid"]["configuration"]["chunk_shape"])
            codecs = document["codecs"]
            raw = [c["name"] for c in codecs] == ["bytes"] and chunk[1:] == self.shape[1:]
            little = codecs[0].get("configuration", {}).get("endian", "little") == "little"
            named = document["chunk_key_encoding"] == {
                "name": "default",
                "configuration": {"separator": "/"},
            }
            known = document["zarr_format"] == 3 and raw and little and named
        except (OSError, KeyError, IndexError, TypeError, ValueError) as error:
            raise LakeFormatError(f"{path} is not a raw array: {error!r}") from error
        if not known:
            raise LakeFormatError(f"{path} is a Zarr array, but its files are not raw rows")
        self._rows = chunk[0]
        self._maps: dict[int, npt.NDArray[Any]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_maps": {}}

    @staticmethod
    def attributes(path: Path) -> dict[str, Any]:
        """Return the attributes of the Zarr group or array in `path`."""
        found: dict[str, Any] = json.loads((path / "zarr.json").read_bytes())["attributes"]
        return found

    def take(
        self,
        rows: npt.NDArray[np.int64],
        starts: npt.NDArray[np.int64] | None = None,
        length: int | None = None,
        buffers: Buffers | None = None,
    ) -> npt.NDArray[Any]:
        """Copy rows, or a run of each row's own first axis that may wrap round its end.

        Parameters
        ----------
        rows : numpy.ndarray
            ``(b,)`` int64, which rows.
        starts : numpy.ndarray, optional
            ``(b,)`` int64, where the run of each begins; at 0 if not given.
        length : int, optional
            Length of the runs; the whole row if not given.
        buffers : Buffers, optional
            Gives the memory of the result.

        Returns
        -------
        numpy.ndarray
            ``(b, length, ...)``, in memory that nobody else holds.

        Raises
        ------
        IndexError
            If a row is not in the array.
        LakeFormatError
            If a file is missing or short.
        """
        # seen as unsigned, negative ones are large: one look at the rows instead of two
        if len(rows) and rows.view(np.uint64).max() >= self.shape[0]:
            raise IndexError(f"rows must be 0 to {self.shape[0] - 1}")
        size = self.shape[1]
        wanted = size if length is None else length
        shape = (len(rows), wanted, *self.shape[2:])
        out = buffers.empty(shape, self.dtype) if buffers else np.empty(shape, self.dtype)
        if starts is None:
            number, places = self._in_one_file(rows)
            if number is not None:
                # one call for all; clipping, which has nothing to do, writes without a buffer
                self._file(number)[:, :wanted].take(places, axis=0, out=out, mode="clip")
                return out
            for place, row in zip(out, rows.tolist(), strict=True):
                place[...] = self._row(row)[:wanted]
            return out
        for place, row, start in zip(out, rows.tolist(), starts.tolist(), strict=True):
            values = self._row(row)
            first = min(wanted, size - start)
            place[:first] = values[start : start + first]
            place[first:] = values[: wanted - first]
        return out

    def _in_one_file(self, rows: npt.NDArray[np.int64]) -> tuple[int | None, npt.NDArray[np.int64]]:
        """Return the file that holds all `rows`, if one does, and their places in files."""
        if self._rows >= self.shape[0]:
            return 0, rows
        numbers, places = np.divmod(rows, self._rows)
        return int(numbers[0]) if len(rows) and (numbers == numbers[0]).all() else None, places

    def _row(self, row: int) -> npt.NDArray[Any]:
        number, place = divmod(row, self._rows)
        values: npt.NDArray[Any] = self._file(number)[place]
        return values

    def _file(self, number: int) -> npt.NDArray[Any]:
        mapped = self._maps.get(number)
        if mapped is None:
            mapped = self._maps[number] = self._map(number)
        return mapped

    def _map(self, number: int) -> npt.NDArray[Any]:
        path = self.path.joinpath("c", str(number), *["0"] * (len(self.shape) - 1))
        try:
            mapped = np.memmap(path, self.dtype, "r", shape=(self._rows, *self.shape[1:]))
        except (OSError, ValueError) as error:
            raise LakeFormatError(f"{path} is damaged ({error}): write the pack anew") from error
        return np.asarray(mapped)  # a plain array is indexed in half the time
