"""Kernels that several threads share, and the interpreter while one of them computes."""

import sys
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from mscf import Box, Tracker, TrackResult
from mscf.arrays import Image, Real
from mscf.features.color_names import load_table
from mscf.kernels import Kernels
from mscf.kernels.choice import kernels_named
from mscf.spectrum import SupportTransform

CALLS = 2000  # until the other thread has had its turn; one is enough nearly always


def flight(seed: int) -> list[Image]:
    frame = np.random.default_rng(seed).integers(0, 256, (30, 40, 3), dtype=np.uint8).repeat(5, axis=0)
    frame = frame.repeat(5, axis=1)
    return [np.roll(frame, (step, 2 * step), axis=(0, 1)) for step in range(12)]


def followed(frames: list[Image], kernels: Kernels) -> list[TrackResult]:
    tracker = Tracker(kernels=kernels)
    tracker.init(frames[0], Box(70, 50, 42, 33))
    return [tracker.update(frame) for frame in frames[1:]]


def test_trackers_of_two_threads_share_kernels_and_find_what_they_find_alone(native: Kernels) -> None:
    flights = [flight(1), flight(2)]
    alone = [followed(frames, kernels_named(native.name)) for frames in flights]
    together: dict[int, list[TrackResult]] = {}
    begin = threading.Barrier(2)

    def run(index: int) -> None:
        begin.wait()
        together[index] = followed(flights[index], native)

    threads = [threading.Thread(target=run, args=(index,)) for index in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [together[0], together[1]] == alone


LONG: dict[str, Callable[[Kernels, np.random.Generator], Callable[[], object]]] = {}


def long(make: Callable[[Kernels, np.random.Generator], Callable[[], object]]) -> None:
    """Add a call that takes a while."""
    LONG[make.__name__] = make


def noise(rng: np.random.Generator, *shape: int) -> Real:
    return rng.standard_normal(shape, dtype=np.float32)


@long
def fhog(kernels: Kernels, rng: np.random.Generator) -> Callable[[], object]:
    patches = rng.integers(0, 256, (40, 128, 128, 3), dtype=np.uint8)
    return lambda: kernels.fhog(patches)


@long
def feature_stack(kernels: Kernels, rng: np.random.Generator) -> Callable[[], object]:
    patch, table = rng.integers(0, 256, (512, 512, 3), dtype=np.uint8), load_table(None)
    return lambda: kernels.feature_stack(patch, table)


@long
def sample_exact(kernels: Kernels, rng: np.random.Generator) -> Callable[[], object]:
    frame, sizes_hw = rng.integers(0, 256, (480, 640, 3), dtype=np.uint8), rng.uniform(300, 900, (33, 2))
    return lambda: kernels.sample_exact(frame, (200.0, 300.0), sizes_hw, (200, 200))


@long
def windowed_dft(kernels: Kernels, rng: np.random.Generator) -> Callable[[], object]:
    maps, window = noise(rng, 42, 128, 128), noise(rng, 128, 128)
    return lambda: kernels.windowed_dft(maps, window)


@long
def restrict_h(kernels: Kernels, rng: np.random.Generator) -> Callable[[], object]:
    support = SupportTransform.centred((128, 128), (60, 60))
    h = noise(rng, 42, 60, 60)
    model_f = support.forward(h)
    return lambda: kernels.restrict_h(model_f, model_f[0], h, 0.9, support)


@long
def filter_of(kernels: Kernels, rng: np.random.Generator) -> Callable[[], object]:
    support = SupportTransform.centred((128, 128), (60, 60))
    h = noise(rng, 42, 60, 60)
    model_f = support.forward(h)
    return lambda: kernels.filter_of(model_f, (h, h), (model_f[0], model_f[1]), 0.1, support)


@long
def scale_dft(kernels: Kernels, rng: np.random.Generator) -> Callable[[], object]:
    features = noise(rng, 99, 31 * 400)
    return lambda: kernels.scale_dft(features)


@pytest.fixture
def _no_switching() -> Iterator[None]:
    """No thread has to make room for another one: it runs until it waits, or gives the interpreter away."""
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e6)
    yield
    sys.setswitchinterval(interval_s)


@pytest.mark.usefixtures("_no_switching")
@pytest.mark.parametrize("name", LONG)
def test_another_thread_runs_while_a_kernel_computes(native: Kernels, rng: np.random.Generator, name: str) -> None:
    call = LONG[name](native, rng)
    begin, progress = threading.Lock(), []

    def run() -> None:
        with begin:
            progress.append(name)

    begin.acquire()
    thread = threading.Thread(target=run)
    thread.start()
    begin.release()
    for number in range(300_000):  # as long as it takes: nobody else gets the interpreter
        assert not progress, number
    for _ in range(CALLS):
        call()
        if progress:
            break
    assert progress
    thread.join()
