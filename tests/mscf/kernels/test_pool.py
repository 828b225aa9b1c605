"""Memory comes back when nobody can see it any more, and no sooner."""

import gc
import pickle
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from mscf import Box, Tracker
from mscf.kernels import Kernels
from mscf.kernels.pool import MOST_SPARE, SMALLEST, Pool

Array = npt.NDArray[Any]
REAL, SPECTRUM = np.dtype(np.float32), np.dtype(np.complex64)
SHAPE = (8, SMALLEST // 8)  # of float32: four times the smallest


def address(array: Array) -> int:
    return int(array.__array_interface__["data"][0])


def filled(pool: Pool, value: float = 1.0) -> Array:
    array = pool.empty(SHAPE, REAL)
    array[...] = value
    return array


@pytest.mark.parametrize("shape", [(SMALLEST // 4,), (5, 100, 100), (2, 1, SMALLEST)])
@pytest.mark.parametrize("dtype", ["float32", "complex64", "uint8", "float64"])
def test_an_array_is_writable_contiguous_and_of_its_shape(shape: tuple[int, ...], dtype: str) -> None:
    array = Pool().empty(shape, np.dtype(dtype))
    array[...] = 7
    assert (array.shape, array.dtype) == (shape, np.dtype(dtype))
    assert array.flags.c_contiguous
    assert array.flags.aligned
    assert (array == 7).all()


def test_the_memory_of_an_array_that_is_gone_is_used_again() -> None:
    pool = Pool()
    array = filled(pool)
    first = address(array)
    del array
    again = pool.empty(SHAPE[::-1], REAL)  # any shape of as many bytes
    assert address(again) == first


# what may refer to an array, and with which its memory must not be used for another
HOLDERS: dict[str, Callable[[Any], Any]] = {
    "itself": lambda array: array,
    "a slice": lambda array: array[1:3],
    "a slice of a slice": lambda array: array[1:][:, ::2][::-1],
    "a shape": lambda array: array.reshape(-1),
    "its transpose": lambda array: array.T,
    "another dtype": lambda array: array.view(np.complex64),
    "a part of it in another dtype and shape": lambda array: array[2].view(np.uint8).reshape(2, -1),
    "a broadcast": lambda array: np.broadcast_to(array[0], (3, SHAPE[1])),
    "a window": lambda array: np.lib.stride_tricks.sliding_window_view(array, 5, axis=1),
    "an array of it": np.asarray,
    "a memoryview": memoryview,
    "a slice of a memoryview": lambda array: memoryview(array)[1:],
    "an array of a memoryview": lambda array: np.asarray(memoryview(array)[2:]),
    "an array of its buffer": lambda array: np.frombuffer(array, np.uint8),
    "an iterator": lambda array: array.flat,
    "a tuple": lambda array: (1, (array,)),
    "a function": lambda array: lambda: array,
}


@pytest.mark.parametrize("holder", HOLDERS)
def test_what_anything_still_sees_is_not_used_again(holder: str) -> None:
    pool = Pool()
    array = filled(pool)
    first = address(array)
    held = HOLDERS[holder](array)
    before = held.copy() if isinstance(held, np.ndarray) else None
    del array
    others = [filled(pool, 2.0) for _ in range(3)]
    assert first not in {address(other) for other in others}
    if before is not None:
        np.testing.assert_array_equal(held, before)
    del held
    gc.collect()
    assert address(filled(pool)) == first


def test_an_array_in_a_ring_of_references_comes_back_with_the_ring() -> None:
    pool = Pool()
    ring: list[Any] = [filled(pool)]
    first = address(ring[0])
    ring.append(ring)
    del ring
    gc.collect()
    assert address(filled(pool)) == first


def test_arrays_that_are_alive_never_overlap(rng: np.random.Generator) -> None:
    pool, alive = Pool(), []
    shapes = [SHAPE, (3, SMALLEST), (SMALLEST // 4,), (10, 10)]
    for step in range(600):
        array = pool.empty(shapes[int(rng.integers(len(shapes)))], REAL)
        array[...] = step
        alive.append((step, array[: 1 + len(array) // 2] if rng.random() < 0.5 else array))
        del array
        while alive and rng.random() < 0.5:
            del alive[int(rng.integers(len(alive)))]
        for number, held in alive:
            assert (held == number).all()


def test_no_more_is_kept_than_a_frame_needs() -> None:
    pool = Pool()
    arrays = [filled(pool) for _ in range(MOST_SPARE + 5)]
    places = {address(array) for array in arrays}
    arrays.clear()
    assert [len(spare) for spare in pool._spare.values()] == [MOST_SPARE]
    kept = [filled(pool) for _ in range(MOST_SPARE)]
    assert {address(array) for array in kept} <= places
    assert not any(pool._spare.values())


def test_small_arrays_are_numpys_own() -> None:
    pool = Pool()
    small = pool.empty((SMALLEST // 4 - 1,), REAL)
    assert small.flags.owndata
    del small
    assert not pool._spare


def test_an_array_outlives_its_pool() -> None:
    pool = Pool()
    array = filled(pool, 3.0)
    del pool
    gc.collect()
    assert (array == 3.0).all()
    del array  # and nobody minds


def arrays_of(snapshot: Any) -> dict[str, Array]:
    state = snapshot.state
    return {
        "model_f": state.model_f,
        "filter_f": state.filter_f,
        "label_f": state.label_f,
        "num_f": state.scale_filter.num_f,
        "den": state.scale_filter.den,
    }


def test_what_a_snapshot_holds_is_never_written_to(native: Kernels, rng: np.random.Generator) -> None:
    frame = rng.integers(0, 256, (120, 160, 3), dtype=np.uint8)
    tracker = Tracker(kernels=native)
    tracker.init(frame, Box(60, 40, 30, 24))
    snapshots = []
    for step in range(8):
        tracker.update(np.roll(frame, step, axis=1))
        snapshots.append(tracker.snapshot())
    copies = [{name: array.copy() for name, array in arrays_of(snapshot).items()} for snapshot in snapshots]
    for step in range(8):
        tracker.update(np.roll(frame, 8 - step, axis=1))
        tracker.look(frame, (75, 52))
    for snapshot, copy in zip(snapshots, copies, strict=True):
        for name, array in arrays_of(snapshot).items():
            np.testing.assert_array_equal(array, copy[name])


def test_what_kernels_return_is_never_written_to_again(kernels: Kernels, rng: np.random.Generator) -> None:
    maps = rng.standard_normal((5, 3, 50, 50), dtype=np.float32)
    window = np.ones((50, 50), np.float32)
    results = [kernels.windowed_dft(each, window) for each in maps]
    for each, result in zip(maps, results, strict=True):
        np.testing.assert_array_equal(result, kernels.windowed_dft(each, window))


def test_a_tracker_that_was_copied_goes_on_by_itself(native: Kernels) -> None:
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 256, (120, 160, 3), dtype=np.uint8) for _ in range(3)]
    tracker = Tracker(kernels=native)
    tracker.init(frames[0], Box(60, 40, 40, 30))
    for other in (deepcopy(tracker), pickle.loads(pickle.dumps(tracker))):  # noqa: S301 - our own
        assert other.update(frames[1]) == deepcopy(tracker).update(frames[1])
