# Signatures of the compiled module, whose source (src/module.cpp) has the shapes; ValueError for any other.
# Results are written into the arrays that come last.

from typing import Any, TypeAlias

import numpy.typing as npt

_Array: TypeAlias = npt.NDArray[Any]

def fhog(patches: _Array, orientation_bins: _Array, features: _Array, /) -> None: ...
def feature_stack(
    patch: _Array, orientation_bins: _Array, luma: _Array, table: _Array | None, features: _Array, /
) -> None: ...
def sample_exact(frame: _Array, row: float, col: float, sizes: _Array, patches: _Array, /) -> None: ...
def windowed_dft(
    maps: _Array, window: _Array, row_cos: _Array, row_sin: _Array, col_cos: _Array, col_sin: _Array, maps_f: _Array, /
) -> None: ...
def inverse_dft(
    map_f: _Array, row_cos: _Array, row_sin: _Array, col_cos: _Array, col_sin: _Array, response: _Array, /
) -> None: ...
def correlate(a_f: _Array, b_f: _Array, sum_f: _Array, /) -> None: ...
def blend(
    mean_f: _Array,
    sample_f: _Array,
    rate: float,
    row_phase: _Array,
    col_phase: _Array,
    after_f: _Array,
    energy: _Array,
    /,
) -> None: ...
def solve_g(
    label_f: _Array,
    energy: _Array,
    fit_f: _Array,
    fit_before_f: _Array,
    a_before_f: _Array,
    inverse_growth: float,
    weight: float,
    a_f: _Array,
    fit_g_f: _Array,
    /,
) -> None: ...
def restrict_h(
    model_f: _Array,
    a_f: _Array,
    h: _Array,
    shrink: float,
    row_cos: _Array,
    row_sin: _Array,
    cols_f: _Array,
    cols_inv: _Array,
    h_after: _Array,
    fit_f: _Array,
    /,
) -> None: ...
def split_label(
    r_f: _Array,
    xi_f: _Array,
    fit_f: _Array,
    ideal_f: _Array,
    previous_f: _Array,
    penalty: float,
    cells: float,
    ideal_weight: float,
    previous_weight: float,
    r_after_f: _Array,
    xi_after_f: _Array,
    /,
) -> None: ...
def filter_of(
    model_f: _Array,
    h: _Array,
    h_before: _Array,
    a_f: _Array,
    a_before_f: _Array,
    inverse_growth: float,
    row_cos: _Array,
    row_sin: _Array,
    cols_f: _Array,
    cols_inv: _Array,
    g_f: _Array,
    /,
) -> None: ...
def peak_to_sidelobe(response: _Array, hole: int, ratio: _Array, /) -> None: ...
def threat_in_window(response: _Array, weight: _Array, threat: _Array, /) -> None: ...
def locate_peak(
    response: _Array, response_f: _Array, steps: int, converged_rad: float, offset_rc: _Array, /
) -> None: ...
def scale_dft(features: _Array, cosines: _Array, sines: _Array, x_f: _Array, /) -> None: ...
def scale_match(num_f: _Array, x_f: _Array, total_f: _Array, /) -> None: ...
def scale_learn(
    num_f: _Array, den: _Array, x_f: _Array, label_f: _Array, rate: float, num_after_f: _Array, den_after: _Array, /
) -> None: ...
