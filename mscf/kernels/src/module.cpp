// The Python module: takes arrays and numbers, checks that they fit together, calls a kernel without the GIL.
//
// Results are written into arrays that the caller brings, last in each list of arguments.

#include <new>
#include <optional>

#include "array.hpp"
#include "kernels.hpp"
#include "lanes.hpp"

namespace mscf {
namespace {

using Args = PyObject* const*;

double number(PyObject* from, const char* name) {
  const double value = PyFloat_AsDouble(from);
  if (value != -1.0 || !PyErr_Occurred()) return value;
  PyErr_Clear();
  PyErr_Format(PyExc_TypeError, "%s must be a number, got %R", name, from);
  throw Refused{};
}

int whole(PyObject* from, long low, long high, const char* name) {
  const long value = PyLong_AsLong(from);
  const bool is_whole = value != -1 || !PyErr_Occurred();
  if (is_whole && low <= value && value <= high) return int(value);
  PyObject* error = !is_whole && PyErr_ExceptionMatches(PyExc_TypeError) ? PyExc_TypeError : PyExc_ValueError;
  PyErr_Clear();
  PyErr_Format(error, "%s must be a whole number from %ld to %ld, got %R", name, low, high, from);
  throw Refused{};
}

const float* floats(const Array<Complex>& spectrum) { return &spectrum.data()->re; }
float* written(const Array<Complex>& spectrum) { return &spectrum.data()->re; }

constexpr Py_ssize_t kOrientations = 1021 * 1021;

// fhog(patches (B, H, W, c) uint8, orientation_bins, features (B, 31, H // 4, W // 4))
void call_fhog(Args a) {
  const Array<uint8_t> patches(a[0], "patches", {kAny, kAny, kAny, kAny});
  const Array<uint8_t> bins(a[1], "orientation_bins", {kOrientations});
  const int rows = patches.size(1), cols = patches.size(2), channels = patches.size(3);
  require(channels == 1 || channels == 3, "patches must have 1 or 3 channels");
  require(rows >= kCell && cols >= kCell, "patches must have at least 4 rows and columns");
  const Array<float> features(a[2], "features", {patches.size(0), 31, rows / kCell, cols / kCell}, Access::kWritten);
  const WithoutGil without_gil;
  const size_t patch_size = size_t(rows) * cols * channels, step = size_t(31) * (rows / kCell) * (cols / kCell);
  for (int i = 0; i < patches.size(0); ++i) {
    const Pixels patch = {patches.data() + i * patch_size, ptrdiff_t(cols) * channels, channels, 1, rows, cols, channels};
    fhog(patch, bins.data(), features.data() + i * step);
  }
}

// feature_stack(patch (H, W, c) uint8, orientation_bins, luma (3,), table (32768, 10) or None, features (C, M, N))
void call_feature_stack(Args a) {
  const Array<uint8_t> patch(a[0], "patch", {kAny, kAny, kAny});
  const Array<uint8_t> bins(a[1], "orientation_bins", {kOrientations});
  const Array<float> luma(a[2], "luma", {3});
  const bool has_names = a[3] != Py_None;
  const int rows = patch.size(0), cols = patch.size(1), channels = patch.size(2);
  require(channels == 1 || channels == 3, "a patch must have 1 or 3 channels");
  require(channels == 3 || !has_names, "colour names need a patch of 3 channels");
  require(rows % kCell == 0 && cols % kCell == 0, "a patch must have multiples of 4 rows and columns");
  const Py_ssize_t m = rows / kCell, n = cols / kCell;
  const Array<float> features(a[4], "features", {has_names ? 42 : 32, m, n}, Access::kWritten);
  std::optional<Array<float>> table;
  if (has_names) table.emplace(a[3], "table", std::initializer_list<Py_ssize_t>{32768, 10});
  const Pixels pixels = {patch.data(), ptrdiff_t(cols) * channels, channels, 1, rows, cols, channels};
  const size_t map = size_t(m) * size_t(n);
  const WithoutGil without_gil;
  if (table) color_names(pixels, table->data(), features.data() + 32 * map);
  gray(pixels, luma.data(), features.data());
  fhog(pixels, bins.data(), features.data() + map);
}

// sample_exact(frame (H, W, c), row, col, sizes (K, 2) float64, patches (K, h, w, c))
void call_sample_exact(Args a) {
  const Array<uint8_t> patches(a[4], "patches", {kAny, kAny, kAny, kAny}, Access::kWritten);
  const int count = patches.size(0), rows = patches.size(1), cols = patches.size(2), channels = patches.size(3);
  require(channels == 1 || channels == 3, "patches must have 1 or 3 channels");
  const Array<uint8_t> frame(a[0], "frame", {kAny, kAny, channels}, Access::kStrided);
  const Array<double> sizes(a[3], "sizes_hw", {count, 2});
  const double row = number(a[1], "row"), col = number(a[2], "col");
  constexpr double kFar = 1e9;  // px; also refuses what is no number
  bool is_sane = row > -kFar && row < kFar && col > -kFar && col < kFar;
  for (int i = 0; i < 2 * count; ++i) is_sane = is_sane && sizes.data()[i] > 0 && sizes.data()[i] < kFar;
  require(is_sane, "the centre of a patch must be within 1e9 px, its size above 0 and below 1e9 px");
  const Pixels pixels = {frame.data(),    frame.stride(0), frame.stride(1), frame.stride(2),
                         frame.size(0), frame.size(1),   channels};
  const WithoutGil without_gil;
  for (int i = 0; i < count; ++i) {
    const double height = sizes.data()[2 * i], width = sizes.data()[2 * i + 1];
    sample_exact(pixels, {row - height / 2, col - width / 2, height, width}, rows, cols,
                 patches.data() + size_t(i) * rows * cols * channels);
  }
}

// Cosines and sines of a grid: row_cos, row_sin, col_cos, col_sin
class Waves {
 public:
  Waves(Args a, int rows, int cols)
      : rows_(rows),
        cols_(cols),
        row_cos_(a[0], "row_cos", {rows / 2 + 1, rows / 2 + 1}),
        row_sin_(a[1], "row_sin", {rows / 2 + 1, rows / 2 + 1}),
        col_cos_(a[2], "col_cos", {cols / 2 + 1, cols / 2 + 1}),
        col_sin_(a[3], "col_sin", {cols / 2 + 1, cols / 2 + 1}) {
    require(rows % 2 == 0 && cols % 2 == 0 && cols >= 14,
            "a grid must have even numbers of rows and columns, and at least 14 columns");
  }
  Grid grid() const {
    return {rows_, cols_, cols_ / 2 + 1, row_cos_.data(), row_sin_.data(), col_cos_.data(), col_sin_.data()};
  }

 private:
  int rows_, cols_;
  Array<float> row_cos_, row_sin_, col_cos_, col_sin_;
};

// windowed_dft(maps (C, M, N), window (M, N), row_cos, row_sin, col_cos, col_sin, maps_f (C, M, N'))
void call_windowed_dft(Args a) {
  const Array<float> maps(a[0], "maps", {kAny, kAny, kAny});
  const int channels = maps.size(0), rows = maps.size(1), cols = maps.size(2);
  const Array<float> window(a[1], "window", {rows, cols});
  const Waves waves(a + 2, rows, cols);
  const Array<Complex> maps_f(a[6], "maps_f", {channels, rows, cols / 2 + 1}, Access::kWritten);
  const WithoutGil without_gil;
  windowed_dft(maps.data(), window.data(), channels, waves.grid(), written(maps_f));
}

// inverse_dft(map_f (M, N'), row_cos, row_sin, col_cos, col_sin, response (M, N))
void call_inverse_dft(Args a) {
  const Array<float> response(a[5], "response", {kAny, kAny}, Access::kWritten);
  const int rows = response.size(0), cols = response.size(1);
  const Array<Complex> map_f(a[0], "map_f", {rows, cols / 2 + 1});
  const Waves waves(a + 1, rows, cols);
  const WithoutGil without_gil;
  inverse_dft(floats(map_f), waves.grid(), response.data());
}

// correlate(a_f (C, M, N'), b_f (C, M, N'), sum_f (M, N'))
void call_correlate(Args a) {
  const Array<Complex> one(a[0], "a_f", {kAny, kAny, kAny});
  const Array<Complex> other(a[1], "b_f", {one.size(0), one.size(1), one.size(2)});
  const Array<Complex> sum_f(a[2], "sum_f", {one.size(1), one.size(2)}, Access::kWritten);
  const WithoutGil without_gil;
  correlate(floats(one), floats(other), one.size(0), one.size(1) * one.size(2), written(sum_f));
}

// blend(mean_f, sample_f (C, M, N'), rate, row_phase (M,), col_phase (N',), after_f (C, M, N'), energy (M, N'))
void call_blend(Args a) {
  const Array<Complex> mean_f(a[0], "mean_f", {kAny, kAny, kAny});
  const int channels = mean_f.size(0), rows = mean_f.size(1), bins = mean_f.size(2);
  const Array<Complex> sample_f(a[1], "sample_f", {channels, rows, bins});
  const double rate = number(a[2], "rate");
  const Array<Complex> row_phase(a[3], "row_phase", {rows}), col_phase(a[4], "col_phase", {bins});
  const Array<Complex> after_f(a[5], "after_f", {channels, rows, bins}, Access::kWritten);
  const Array<float> energy(a[6], "energy", {rows, bins}, Access::kWritten);
  const WithoutGil without_gil;
  blend(floats(mean_f), floats(sample_f), float(rate), floats(row_phase), floats(col_phase), channels, rows, bins,
        written(after_f), energy.data());
}

// Of a filter's support: row_cos, row_sin (M/2 + 1, m/2 + 1), cols_f (n, N'), cols_inv (2 N', padded n)
class SupportTables {
 public:
  SupportTables(Args a, int rows, int bins, int height, int width)
      : row_cos_(a[0], "row_cos", {rows / 2 + 1, height / 2 + 1}),
        row_sin_(a[1], "row_sin", {rows / 2 + 1, height / 2 + 1}),
        cols_f_(a[2], "cols_f", {width, bins}),
        cols_inv_(a[3], "cols_inv", {2 * bins, (width + kLanes - 1) / kLanes * kLanes}),
        support_{rows,           bins,           height,           width, row_cos_.data(), row_sin_.data(),
                 floats(cols_f_), cols_inv_.data(), cols_inv_.size(1)} {
    require(rows % 2 == 0 && bins >= 8 && height <= rows && width <= 2 * bins - 2,
            "a support must lie in a grid of an even number of rows, and of at least 8 bins");
  }
  const Support& support() const { return support_; }

 private:
  Array<float> row_cos_, row_sin_;
  Array<Complex> cols_f_;
  Array<float> cols_inv_;
  Support support_;
};

// solve_g(label_f, energy, fit_f, fit_before_f, a_before_f (M, N'), inverse_growth, weight, a_f, fit_g_f (M, N'))
void call_solve_g(Args a) {
  const Array<Complex> label_f(a[0], "label_f", {kAny, kAny});
  const int rows = label_f.size(0), bins = label_f.size(1);
  const Array<float> energy(a[1], "energy", {rows, bins});
  const Array<Complex> fit_f(a[2], "fit_f", {rows, bins}), before_f(a[3], "fit_before_f", {rows, bins}),
      a_before_f(a[4], "a_before_f", {rows, bins});
  const double inverse_growth = number(a[5], "inverse_growth"), weight = number(a[6], "weight");
  const Array<Complex> a_f(a[7], "a_f", {rows, bins}, Access::kWritten), fit_g_f(a[8], "fit_g_f", {rows, bins}, Access::kWritten);
  const WithoutGil without_gil;
  solve_g(floats(label_f), energy.data(), floats(fit_f), floats(before_f), floats(a_before_f), float(inverse_growth),
          float(weight), rows * bins, written(a_f), written(fit_g_f));
}

// restrict_h(model_f (C, M, N'), a_f (M, N'), h (C, m, n), shrink, row_cos, row_sin, cols_f, cols_inv, h_after, fit_f)
void call_restrict_h(Args a) {
  const Array<Complex> model_f(a[0], "model_f", {kAny, kAny, kAny});
  const int channels = model_f.size(0), rows = model_f.size(1), bins = model_f.size(2);
  const Array<Complex> a_f(a[1], "a_f", {rows, bins});
  const Array<float> h(a[2], "h", {channels, kAny, kAny});
  const double shrink = number(a[3], "shrink");
  const SupportTables part(a + 4, rows, bins, h.size(1), h.size(2));
  const Array<float> h_after(a[8], "h_after", {channels, h.size(1), h.size(2)}, Access::kWritten);
  const Array<Complex> fit_f(a[9], "fit_f", {rows, bins}, Access::kWritten);
  const WithoutGil without_gil;
  restrict_h(floats(model_f), floats(a_f), h.data(), float(shrink), channels, part.support(), h_after.data(),
             written(fit_f));
}

// split_label(r_f, xi_f, fit_f, ideal_f, previous_f (M, N'), penalty, cells, ideal_weight, previous_weight,
// r_after_f, xi_after_f (M, N'))
void call_split_label(Args a) {
  const Array<Complex> r_f(a[0], "r_f", {kAny, kAny});
  const int rows = r_f.size(0), bins = r_f.size(1);
  const Array<Complex> xi_f(a[1], "xi_f", {rows, bins}), fit_f(a[2], "fit_f", {rows, bins}),
      ideal_f(a[3], "ideal_f", {rows, bins}), previous_f(a[4], "previous_f", {rows, bins});
  const double penalty = number(a[5], "penalty"), cells = number(a[6], "cells");
  const double ideal = number(a[7], "ideal_weight"), previous = number(a[8], "previous_weight");
  const Array<Complex> r_after_f(a[9], "r_after_f", {rows, bins}, Access::kWritten);
  const Array<Complex> xi_after_f(a[10], "xi_after_f", {rows, bins}, Access::kWritten);
  const WithoutGil without_gil;
  split_label(floats(r_f), floats(xi_f), floats(fit_f), floats(ideal_f), floats(previous_f), float(penalty),
              float(cells), float(ideal), float(previous), rows * bins, written(r_after_f), written(xi_after_f));
}

// filter_of(model_f (C, M, N'), h, h_before (C, m, n), a_f, a_before_f (M, N'), inverse_growth, row_cos, row_sin, cols_f,
// cols_inv, g_f (C, M, N'))
void call_filter_of(Args a) {
  const Array<Complex> model_f(a[0], "model_f", {kAny, kAny, kAny});
  const int channels = model_f.size(0), rows = model_f.size(1), bins = model_f.size(2);
  const Array<float> h(a[1], "h", {channels, kAny, kAny});
  const Array<float> h_before(a[2], "h_before", {channels, h.size(1), h.size(2)});
  const Array<Complex> a_f(a[3], "a_f", {rows, bins}), a_before_f(a[4], "a_before_f", {rows, bins});
  const double inverse_growth = number(a[5], "inverse_growth");
  const SupportTables part(a + 6, rows, bins, h.size(1), h.size(2));
  const Array<Complex> g_f(a[10], "g_f", {channels, rows, bins}, Access::kWritten);
  const WithoutGil without_gil;
  filter_of(floats(model_f), h.data(), h_before.data(), floats(a_f), floats(a_before_f), float(inverse_growth), channels,
            part.support(), written(g_f));
}

// peak_to_sidelobe(response (M, N), hole, ratio (1,) float64)
void call_peak_to_sidelobe(Args a) {
  const Array<float> response(a[0], "response", {kAny, kAny});
  const int rows = response.size(0), cols = response.size(1);
  const int hole = whole(a[1], 0, (rows < cols ? rows : cols) / 2 - 1, "hole");
  const Array<double> ratio(a[2], "ratio", {1}, Access::kWritten);
  const WithoutGil without_gil;
  *ratio.data() = peak_to_sidelobe(response.data(), rows, cols, hole);
}

// threat_in_window(response (M, N), weight (2 r + 1, 2 r + 1), threat (1,) float64)
void call_threat_in_window(Args a) {
  const Array<float> response(a[0], "response", {kAny, kAny});
  const Array<float> weight(a[1], "weight", {kAny, kAny});
  const Array<double> threat(a[2], "threat", {1}, Access::kWritten);
  const int side = weight.size(0), rows = response.size(0), cols = response.size(1);
  require(side % 2 == 1 && side == weight.size(1) && side < rows && side < cols,
          "the weight must be a square of odd side, smaller than the response");
  const WithoutGil without_gil;
  *threat.data() = threat_in_window(response.data(), rows, cols, side / 2, weight.data());
}

// locate_peak(response (M, N), response_f (M, N'), steps, converged_rad, offset_rc (2,) float64)
void call_locate_peak(Args a) {
  const Array<float> response(a[0], "response", {kAny, kAny});
  const int rows = response.size(0), cols = response.size(1);
  const Array<Complex> response_f(a[1], "response_f", {rows, cols / 2 + 1});
  const int steps = whole(a[2], 0, 1000, "steps");
  const double converged_rad = number(a[3], "converged_rad");
  const Array<double> offset_rc(a[4], "offset_rc", {2}, Access::kWritten);
  const WithoutGil without_gil;
  locate_peak(response.data(), floats(response_f), rows, cols, cols / 2 + 1, steps, converged_rad, offset_rc.data());
}

// scale_dft(features (K, F), cosines, sines (K//2 + 1, K//2 + 1), x_f (K//2 + 1, F))
void call_scale_dft(Args a) {
  const Array<float> features(a[0], "features", {kAny, kAny});
  const int scales = features.size(0), size = features.size(1), bins = scales / 2 + 1;
  require(scales % 2 == 1, "features must be of an odd number of scales");
  const Array<float> cosines(a[1], "cosines", {bins, bins}), sines(a[2], "sines", {bins, bins});
  const Array<Complex> x_f(a[3], "x_f", {bins, size}, Access::kWritten);
  const WithoutGil without_gil;
  scale_dft(features.data(), scales, size, cosines.data(), sines.data(), written(x_f));
}

// scale_match(num_f, x_f (K', F), total_f (K',))
void call_scale_match(Args a) {
  const Array<Complex> num_f(a[0], "num_f", {kAny, kAny});
  const int bins = num_f.size(0), size = num_f.size(1);
  const Array<Complex> x_f(a[1], "x_f", {bins, size}), total_f(a[2], "total_f", {bins}, Access::kWritten);
  const WithoutGil without_gil;
  scale_match(floats(num_f), floats(x_f), bins, size, written(total_f));
}

// scale_learn(num_f (K', F), den (K',), x_f (K', F), label_f (K',), rate, num_after_f (K', F), den_after (K',))
void call_scale_learn(Args a) {
  const Array<Complex> num_f(a[0], "num_f", {kAny, kAny});
  const int bins = num_f.size(0), size = num_f.size(1);
  const Array<float> den(a[1], "den", {bins});
  const Array<Complex> x_f(a[2], "x_f", {bins, size}), label_f(a[3], "label_f", {bins});
  const double rate = number(a[4], "rate");
  const Array<Complex> num_after_f(a[5], "num_after_f", {bins, size}, Access::kWritten);
  const Array<float> den_after(a[6], "den_after", {bins}, Access::kWritten);
  const WithoutGil without_gil;
  scale_learn(floats(num_f), den.data(), floats(x_f), floats(label_f), float(rate), bins, size, written(num_after_f),
              den_after.data());
}

template <void (*CALL)(Args), int COUNT>
PyObject* entry(PyObject*, Args args, Py_ssize_t count) {
  if (count != COUNT) return PyErr_Format(PyExc_TypeError, "%d arguments are wanted, got %zd", COUNT, count);
  try {
    CALL(args);
  } catch (const Refused&) {
    return nullptr;
  } catch (const std::bad_alloc&) {
    return PyErr_NoMemory();
  }
  Py_RETURN_NONE;
}

template <void (*CALL)(Args), int COUNT>
PyMethodDef method(const char* name) {
  return {name, reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(&entry<CALL, COUNT>)), METH_FASTCALL, nullptr};
}

PyMethodDef methods[] = {
    method<call_fhog, 3>("fhog"),
    method<call_feature_stack, 5>("feature_stack"),
    method<call_sample_exact, 5>("sample_exact"),
    method<call_windowed_dft, 7>("windowed_dft"),
    method<call_inverse_dft, 6>("inverse_dft"),
    method<call_correlate, 3>("correlate"),
    method<call_blend, 7>("blend"),
    method<call_solve_g, 9>("solve_g"),
    method<call_restrict_h, 10>("restrict_h"),
    method<call_split_label, 11>("split_label"),
    method<call_filter_of, 11>("filter_of"),
    method<call_peak_to_sidelobe, 3>("peak_to_sidelobe"),
    method<call_threat_in_window, 3>("threat_in_window"),
    method<call_locate_peak, 5>("locate_peak"),
    method<call_scale_dft, 4>("scale_dft"),
    method<call_scale_match, 3>("scale_match"),
    method<call_scale_learn, 7>("scale_learn"),
    {nullptr, nullptr, 0, nullptr},
};

PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_native", nullptr, 0, methods, nullptr, nullptr, nullptr, nullptr};

}  // namespace
}  // namespace mscf

PyMODINIT_FUNC PyInit__native() {
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) {
    PyErr_SetString(PyExc_ImportError, "the compiled kernels need a processor with AVX2 and FMA");
    return nullptr;
  }
#endif
  return PyModuleDef_Init(&mscf::definition);
}
