"""Memory that large arrays are made in again and again, once those that were made in it are gone."""

import math
import weakref
from typing import Any

import numpy as np
import numpy.typing as npt

SMALLEST = 1 << 13  # bytes; below, NumPy's own allocator is as good
MOST_SPARE = 8  # of each size that are kept: what a frame needs at a time

_Array = npt.NDArray[Any]


class _Loan(weakref.ref[_Array]):
    """What tells when an array is gone, and which memory it was made in."""

    __slots__ = ("memory",)
    memory: bytearray


class Pool:
    """Arrays in memory that comes back by itself when nobody refers to the array, or to a view of it, any more.

    The memory that a tracker needs for each frame would be taken from the system and given back anew each time, page
    by page.
    """

    def __init__(self) -> None:
        self._spare: dict[int, list[bytearray]] = {}
        self._loans: dict[int, _Loan] = {}  # by identity: a reference hashes as its array

    def __reduce__(self) -> tuple[type["Pool"], tuple[()]]:
        """A copy begins with nothing: what was lent is not its."""
        return Pool, ()

    def empty(self, shape: tuple[int, ...], dtype: "np.dtype[Any]") -> _Array:
        """A contiguous array of no particular values."""
        size = math.prod(shape) * dtype.itemsize
        if size < SMALLEST:
            return np.empty(shape, dtype)
        spare = self._spare.setdefault(size, [])
        try:
            memory = spare.pop()
        except IndexError:
            memory = bytearray(size)
        array: _Array = np.ndarray(shape, dtype, memory)
        loan = _Loan(array, self._give_back)
        loan.memory = memory
        self._loans[id(loan)] = loan
        return array

    def _give_back(self, loan: weakref.ref[_Array]) -> None:
        memory = self._loans.pop(id(loan)).memory
        spare = self._spare[len(memory)]
        if len(spare) < MOST_SPARE:
            spare.append(memory)
