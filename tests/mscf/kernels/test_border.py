"""What the compiled module refuses: every array and number of every function, by one table of calls that it takes."""

import itertools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

_native: Any = pytest.importorskip("mscf.kernels._native", reason="the compiled kernels are not here: not tested")


@dataclass(frozen=True, slots=True)
class Argument:
    """An array, by the name that its refusal has to tell."""

    name: str
    shape: tuple[int, ...]
    dtype: str = "float32"
    is_written: bool = False
    free_axes: tuple[int, ...] = ()  # whose length no other argument depends on

    def array(self) -> npt.NDArray[Any]:
        return np.full(self.shape, 99 if self.is_written else 1, self.dtype)


def read(name: str, *shape: int, free_axes: tuple[int, ...] = ()) -> Argument:
    return Argument(name, shape, free_axes=free_axes)


def read_f(name: str, *shape: int) -> Argument:
    return Argument(name, shape, "complex64")


def pixels(name: str, *shape: int, free_axes: tuple[int, ...] = ()) -> Argument:
    return Argument(name, shape, "uint8", free_axes=free_axes)


def written(name: str, *shape: int, dtype: str = "float32", free_axes: tuple[int, ...] = ()) -> Argument:
    return Argument(name, shape, dtype, is_written=True, free_axes=free_axes)


def written_f(name: str, *shape: int) -> Argument:
    return written(name, *shape, dtype="complex64")


# C = 3 channels, 16 x 20 cells, support 5 x 4, K = 5 scales, F = 31 features
ORIENTATIONS = pixels("orientation_bins", 1021 * 1021)
WAVES = read("row_cos", 9, 9), read("row_sin", 9, 9), read("col_cos", 11, 11), read("col_sin", 11, 11)
PART = read("row_cos", 9, 3), read("row_sin", 9, 3), read_f("cols_f", 4, 11), read("cols_inv", 22, 16)
SIZES = Argument("sizes_hw", (2, 2), "float64")
CALLS: dict[str, tuple[Argument | float, ...]] = {
    "fhog": (pixels("patches", 2, 8, 12, 3), ORIENTATIONS, written("features", 2, 31, 2, 3)),
    "feature_stack": (
        pixels("patch", 8, 12, 3),
        ORIENTATIONS,
        read("luma", 3),
        read("table", 32768, 10),
        written("features", 42, 2, 3),
    ),
    "sample_exact": (
        pixels("frame", 20, 30, 3, free_axes=(0, 1)),
        10.5,
        12.5,
        SIZES,
        written("patches", 2, 6, 7, 3, dtype="uint8", free_axes=(1, 2)),
    ),
    "windowed_dft": (read("maps", 3, 16, 20), read("window", 16, 20), *WAVES, written_f("maps_f", 3, 16, 11)),
    "inverse_dft": (read_f("map_f", 16, 11), *WAVES, written("response", 16, 20)),
    "correlate": (read_f("a_f", 3, 16, 11), read_f("b_f", 3, 16, 11), written_f("sum_f", 16, 11)),
    "blend": (
        read_f("mean_f", 3, 16, 11),
        read_f("sample_f", 3, 16, 11),
        0.02,
        read_f("row_phase", 16),
        read_f("col_phase", 11),
        written_f("after_f", 3, 16, 11),
        written("energy", 16, 11),
    ),
    "solve_g": (
        read_f("label_f", 16, 11),
        read("energy", 16, 11),
        *(read_f(name, 16, 11) for name in ("fit_f", "fit_before_f", "a_before_f")),
        0.1,
        25.0,
        written_f("a_f", 16, 11),
        written_f("fit_g_f", 16, 11),
    ),
    "restrict_h": (
        read_f("model_f", 3, 16, 11),
        read_f("a_f", 16, 11),
        read("h", 3, 5, 4),
        0.9,
        *PART,
        written("h_after", 3, 5, 4),
        written_f("fit_f", 16, 11),
    ),
    "split_label": (
        *(read_f(name, 16, 11) for name in ("r_f", "xi_f", "fit_f", "ideal_f", "previous_f")),
        27.0,
        320.0,
        0.1,
        0.2,
        written_f("r_after_f", 16, 11),
        written_f("xi_after_f", 16, 11),
    ),
    "filter_of": (
        read_f("model_f", 3, 16, 11),
        read("h", 3, 5, 4),
        read("h_before", 3, 5, 4),
        read_f("a_f", 16, 11),
        read_f("a_before_f", 16, 11),
        0.1,
        *PART,
        written_f("g_f", 3, 16, 11),
    ),
    "peak_to_sidelobe": (read("response", 16, 20, free_axes=(0, 1)), 5, written("ratio", 1, dtype="float64")),
    "threat_in_window": (
        read("response", 16, 20, free_axes=(0, 1)),
        read("weight", 13, 13),
        written("threat", 1, dtype="float64"),
    ),
    "locate_peak": (
        read("response", 16, 20),
        read_f("response_f", 16, 11),
        5,
        1e-5,
        written("offset_rc", 2, dtype="float64"),
    ),
    "scale_dft": (read("features", 5, 31), read("cosines", 3, 3), read("sines", 3, 3), written_f("x_f", 3, 31)),
    "scale_match": (read_f("num_f", 3, 31), read_f("x_f", 3, 31), written_f("total_f", 3)),
    "scale_learn": (
        read_f("num_f", 3, 31),
        read("den", 3),
        read_f("x_f", 3, 31),
        read_f("label_f", 3),
        0.024,
        written_f("num_after_f", 3, 31),
        written("den_after", 3),
    ),
}
ARRAYS = [
    pytest.param(name, place, argument, id=f"{name}-{argument.name}")
    for name, arguments in CALLS.items()
    for place, argument in enumerate(arguments)
    if isinstance(argument, Argument)
]
NUMBERS = [
    (name, place)
    for name, arguments in CALLS.items()
    for place, argument in enumerate(arguments)
    if not isinstance(argument, Argument)
]
DTYPES = ["float16", "float32", "float64", ">f4", "complex64", "complex128", "uint8", "int8", "bool", "int32", "uint32"]


def arguments_of(name: str) -> list[Any]:
    """What the function takes, made anew."""
    return [each.array() if isinstance(each, Argument) else each for each in CALLS[name]]


def assert_refused(name: str, place: int, value: Any, named: str | None, error: type[Exception] = ValueError) -> None:
    """The call with another value in one place fails with a text that has a name (None: any), and writes nothing."""
    arguments = arguments_of(name)
    arguments[place] = value
    before = [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]
    with pytest.raises(error, match=named):
        getattr(_native, name)(*arguments)
    for one, other in zip(arguments, before, strict=True):
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)


def word(name: str) -> str:
    return rf"\b{re.escape(name)}\b"


def test_every_function_of_the_module_is_in_the_table() -> None:
    assert set(CALLS) == {name for name in dir(_native) if not name.startswith("_")}


@pytest.mark.parametrize("name", CALLS)
def test_what_fits_together_is_computed(name: str) -> None:
    arguments = arguments_of(name)
    assert getattr(_native, name)(*arguments) is None
    for argument, array in zip(CALLS[name], arguments, strict=True):
        if isinstance(argument, Argument):
            assert argument.is_written is bool((array != argument.array()).any()), argument.name


@pytest.mark.parametrize("name", CALLS)
def test_inputs_may_be_read_only(name: str) -> None:
    arguments = arguments_of(name)
    for argument, array in zip(CALLS[name], arguments, strict=True):
        if isinstance(argument, Argument) and not argument.is_written:
            array.flags.writeable = False
    getattr(_native, name)(*arguments)


@pytest.mark.parametrize(("name", "place", "argument"), ARRAYS)
def test_an_array_of_another_dtype_is_refused(name: str, place: int, argument: Argument) -> None:
    others = [dtype for dtype in DTYPES if np.dtype(dtype) != np.dtype(argument.dtype)]
    assert len(others) == len(DTYPES) - 1
    for dtype in (*others, "object", "S4", "f4,f4"):
        assert_refused(name, place, np.zeros(argument.shape, dtype), word(argument.name))


@pytest.mark.parametrize(("name", "place", "argument"), ARRAYS)
def test_an_array_of_more_or_fewer_axes_is_refused(name: str, place: int, argument: Argument) -> None:
    array = argument.array()
    for other in (array[None], array[..., None], array[0], array.ravel()[0]):
        assert_refused(name, place, other, word(argument.name))
    if array.ndim > 1:
        assert_refused(name, place, array.ravel(), word(argument.name))


@pytest.mark.parametrize(("name", "place", "argument"), ARRAYS)
def test_an_array_whose_length_does_not_fit_the_others_is_refused(name: str, place: int, argument: Argument) -> None:
    # of two that do not fit together, either may be named
    any_name = "|".join(word(each.name) for each in CALLS[name] if isinstance(each, Argument)) + "|number of scales"
    for axis, length in enumerate(argument.shape):
        for other in {0, length - 1, length + 4} - {length}:
            if axis in argument.free_axes and other > 0:
                continue
            if argument.name == "patches" and name == "fhog" and 0 < other < length and axis in {1, 2}:
                continue  # what is left of a cell is left out
            shape = (*argument.shape[:axis], other, *argument.shape[axis + 1 :])
            assert_refused(name, place, np.ones(shape, argument.dtype), any_name)


@pytest.mark.parametrize(("name", "place", "argument"), [each for each in ARRAYS if each.values[2].name != "frame"])  # type: ignore[union-attr]
def test_an_array_that_is_not_contiguous_is_refused(name: str, place: int, argument: Argument) -> None:
    array = argument.array()
    apart = [np.repeat(array, 2, axis=-1)[..., ::2]]
    if array.ndim > 1:
        apart += [np.asfortranarray(array), array[..., ::-1]]
    for other in apart:
        assert other.shape == array.shape
        if not other.flags.c_contiguous:  # one element alone always is
            assert_refused(name, place, other, word(argument.name))


@pytest.mark.parametrize(("name", "place", "argument"), ARRAYS)
def test_what_is_no_array_is_refused(name: str, place: int, argument: Argument) -> None:
    for other in (None, 1.0, 7, "text", b"", [], [[1.0]], object(), memoryview(b"1234"), np.float32(1)):
        if argument.name == "table" and other is None:
            continue  # no colour names are asked for
        assert_refused(name, place, other, word(argument.name))


@pytest.mark.parametrize(("name", "place", "argument"), [each for each in ARRAYS if each.values[2].is_written])  # type: ignore[union-attr]
def test_a_result_that_cannot_be_written_is_refused(name: str, place: int, argument: Argument) -> None:
    array = argument.array()
    array.flags.writeable = False
    assert_refused(name, place, array, word(argument.name))


@pytest.mark.parametrize("name", CALLS)
def test_another_number_of_arguments_is_refused(name: str) -> None:
    arguments = arguments_of(name)
    for wrong in ([], arguments[:-1], [*arguments, arguments[-1]]):
        with pytest.raises(TypeError, match=f"{len(arguments)} arguments are wanted, got {len(wrong)}"):
            getattr(_native, name)(*wrong)
    with pytest.raises(TypeError, match="takes no keyword arguments"):
        getattr(_native, name)(*arguments[:-1], last=arguments[-1])


@pytest.mark.parametrize(("name", "place"), NUMBERS)
def test_what_is_no_number_is_refused(name: str, place: int) -> None:
    for other in (None, "1", 1j, [], {}, np.ones(3), object()):
        assert_refused(name, place, other, " must be a (whole )?number", TypeError)


@pytest.mark.parametrize(
    ("name", "place", "value", "text"),
    [
        *(("sample_exact", place, value, "centre") for place in (1, 2) for value in (np.nan, np.inf, -np.inf, 2e9)),
        *(("peak_to_sidelobe", 1, value, "hole must be a whole number from 0 to 7") for value in (-1, 8, 2**31)),
        *(("locate_peak", 2, value, "steps must be a whole number from 0 to 1000") for value in (-1, 1001)),
    ],
)
def test_a_number_out_of_range_is_refused(name: str, place: int, value: float, text: str) -> None:
    assert_refused(name, place, value, text)


def test_a_size_that_is_none_is_refused() -> None:
    for place, value in itertools.product(range(4), (np.nan, np.inf, 0.0, -1.0, 2e9)):
        sizes = np.full((2, 2), 9.0)
        sizes.flat[place] = value
        assert_refused("sample_exact", 3, sizes, "size")


@pytest.mark.parametrize("channels", [2, 4])
def test_a_frame_of_another_number_of_channels_than_its_patches_is_refused(channels: int) -> None:
    assert_refused("sample_exact", 4, np.zeros((2, 6, 7, channels), np.uint8), "patches")
    assert_refused("sample_exact", 4, np.zeros((2, 6, 7, 1), np.uint8), "frame")


def test_a_grid_of_odd_size_is_refused() -> None:
    for size_mn in ((15, 20), (16, 19)):
        rows, bins = size_mn[0] // 2 + 1, size_mn[1] // 2 + 1
        waves = [np.ones((rows, rows), np.float32)] * 2 + [np.ones((bins, bins), np.float32)] * 2
        map_f, response = np.ones((size_mn[0], bins), np.complex64), np.ones(size_mn, np.float32)
        with pytest.raises(ValueError, match="even numbers of rows and columns"):
            _native.inverse_dft(map_f, *waves, response)
        with pytest.raises(ValueError, match="even numbers of rows and columns"):
            _native.windowed_dft(response[None], response, *waves, map_f[None])


def test_an_even_number_of_scales_is_refused() -> None:
    assert_refused("scale_dft", 0, np.ones((4, 31), np.float32), "odd")
