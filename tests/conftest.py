"""Where the tests find the reference data and sequences that are not part of the project."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
from mover import write_sequence

from mscf.errors import ConfigError
from mscf.kernels import Kernels, KernelsName
from mscf.kernels.choice import kernels_named

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"

# a shell that starts the tests in the background has them ignore Ctrl-C, and so would the commands that they interrupt
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _state_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What the application keeps, it keeps elsewhere than in the home of who runs the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    cv2.setNumThreads(1)


@pytest.fixture(scope="session")
def reference_dir() -> Path:
    folder = Path(os.environ.get("MSCF_REFERENCE", SHARED / "reference"))
    if not folder.is_dir():
        pytest.skip(f"no reference data: neither $MSCF_REFERENCE nor {SHARED / 'reference'} is there")
    return folder


@pytest.fixture(scope="session")
def sequences_dir() -> Path:
    folder = Path(os.environ.get("MSCF_SEQUENCES", SHARED / "sequences"))
    if not folder.is_dir():
        pytest.skip(f"no sequences: neither $MSCF_SEQUENCES nor {SHARED / 'sequences'} is there")
    return folder


def kernels_or_skip(name: KernelsName) -> Kernels:
    try:
        return kernels_named(name)
    except ConfigError as error:
        pytest.skip(f"the compiled kernels are not tested: {error}")


@pytest.fixture(params=get_args(KernelsName))
def kernels(request: pytest.FixtureRequest) -> Kernels:
    """Each form of the numeric steps in turn."""
    return kernels_or_skip(request.param)


@pytest.fixture(scope="session")
def native() -> Kernels:
    """The compiled kernels, to be compared with those of NumPy."""
    return kernels_or_skip("native")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20210607)


@pytest.fixture
def sequence_dir(tmp_path: Path) -> Path:
    return write_sequence(tmp_path / "data" / "mover")
