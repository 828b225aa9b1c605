// What is read off a response map: where its peak is, how far it stands out, how dangerous its sub-peaks are.

#include <algorithm>
#include <cmath>

#include "kernels.hpp"
#include "lanes.hpp"
#include "scratch.hpp"

namespace mscf {
namespace {

struct Cell {
  int row, col;
};

// The highest cell, the first one column by column among equals, or the first that is not a number.
MSCF_INLINE Cell highest(const float* map, int rows, int cols, int first_row, int first_col) {
  Cell best = {first_row % rows, first_col % cols};
  float most = map[best.row * cols + best.col];
  for (int j = 0; j < cols; ++j)
    for (int i = 0; i < rows; ++i) {
      const int row = (first_row + i) % rows, col = (first_col + j) % cols;
      const float value = map[row * cols + col];
      if (!std::isnan(most) && (value > most || std::isnan(value))) {
        most = value;
        best = {row, col};
      }
    }
  return best;
}

MSCF_INLINE double signed_frequency(int index, int size) { return index <= size / 2 ? index : index - size; }

// Value, first and second derivative by an angle of exp(i k angle), as (re, im) each.
struct Wave {
  double value[2], slope[2], bend[2];
};

MSCF_INLINE Wave wave(double k, double angle, double weight) {
  const double c = weight * std::cos(k * angle), s = weight * std::sin(k * angle);
  return {{c, s}, {-k * s, k * c}, {-k * k * c, -k * k * s}};
}

struct Moments {
  double value, by_row, by_col, by_row_row, by_col_col, by_row_col;
};

// Of the trigonometric interpolation at an angle. `sums`: room for 3 * 2 * bins doubles.
MSCF_INLINE Moments moments_at(const float* response_f, int rows, int cols, int bins, double angle_r, double angle_c,
                               double* sums) {
  double *value = sums, *slope = sums + 2 * bins, *bend = slope + 2 * bins;
  std::fill(sums, sums + 6 * bins, 0.0);
  for (int r = 0; r < rows; ++r) {
    Wave w = wave(signed_frequency(r, rows), angle_r, 1.0);
    const float* line = response_f + r * bins * 2;
    if (2 * r == rows) {  // a bin stands for its conjugate in the same row, but for the corner bin, which has no other
      const double corner = 2 * (bins - 1) == cols ? line[2 * (bins - 1)] : 0;
      value[2 * bins - 1] += w.value[1] * corner;
      slope[2 * bins - 1] += w.slope[1] * corner;
      bend[2 * bins - 1] += w.bend[1] * corner;
      w.value[1] = w.slope[1] = w.bend[1] = 0;
    }
    for (int j = 0; j < bins; ++j) {
      const double re = line[2 * j], im = line[2 * j + 1];
      value[2 * j] += w.value[0] * re - w.value[1] * im;
      value[2 * j + 1] += w.value[0] * im + w.value[1] * re;
      slope[2 * j] += w.slope[0] * re - w.slope[1] * im;
      slope[2 * j + 1] += w.slope[0] * im + w.slope[1] * re;
      bend[2 * j] += w.bend[0] * re - w.bend[1] * im;
      bend[2 * j + 1] += w.bend[0] * im + w.bend[1] * re;
    }
  }
  Moments m = {};
  const double share = 1.0 / (double(rows) * cols);
  for (int j = 0; j < bins; ++j) {
    const Wave w = wave(j, angle_c, j == 0 || 2 * j == cols ? share : 2 * share);
    m.value += w.value[0] * value[2 * j] - w.value[1] * value[2 * j + 1];
    m.by_row += w.value[0] * slope[2 * j] - w.value[1] * slope[2 * j + 1];
    m.by_row_row += w.value[0] * bend[2 * j] - w.value[1] * bend[2 * j + 1];
    m.by_col += w.slope[0] * value[2 * j] - w.slope[1] * value[2 * j + 1];
    m.by_row_col += w.slope[0] * slope[2 * j] - w.slope[1] * slope[2 * j + 1];
    m.by_col_col += w.bend[0] * value[2 * j] - w.bend[1] * value[2 * j + 1];
  }
  return m;
}

}  // namespace

MSCF_KERNEL double peak_to_sidelobe(const float* response, int rows, int cols, int hole) {
  const Cell peak = highest(response, rows, cols, 0, 0);
  double sum = 0, squares = 0;
  int count = 0;
  for (int pass = 0; pass < 2; ++pass) {
    const double mean = pass == 0 ? 0 : sum / count;
    for (int r = 0; r < rows; ++r) {
      const int dr = std::abs(r - peak.row);
      const bool is_near = std::min(dr, rows - dr) <= hole;
      for (int c = 0; c < cols; ++c) {
        const int dc = std::abs(c - peak.col);
        if (is_near && std::min(dc, cols - dc) <= hole) continue;
        const double value = response[r * cols + c];
        if (pass == 0) {
          sum += value;
          ++count;
        } else {
          squares += (value - mean) * (value - mean);
        }
      }
    }
  }
  const double deviation = std::sqrt(squares / count);
  return deviation > 0 ? (response[peak.row * cols + peak.col] - sum / count) / deviation : 0.0;
}

MSCF_KERNEL double threat_in_window(const float* response, int rows, int cols, int radius, const float* weight) {
  const int top = (rows + 1) / 2, left = (cols + 1) / 2;  // of the map shifted so that offset 0 is in its middle
  const Cell peak = highest(response, rows, cols, top, left);
  const float most = response[peak.row * cols + peak.col];
  if (!(most > 0)) return 1;
  const int side = 2 * radius + 1;
  // the published bounds keep one more cell free at the far border
  const int row = std::clamp((peak.row - top + rows) % rows, radius, rows - radius - 2);
  const int col = std::clamp((peak.col - left + cols) % cols, radius, cols - radius - 2);
  static thread_local Scratch<float> scratch;
  float* window = scratch.take(size_t(side) * side);
  for (int i = 0; i < side; ++i)
    for (int j = 0; j < side; ++j) {
      const bool is_hole = std::abs(i - radius) <= 1 && std::abs(j - radius) <= 1;
      const int r = (row - radius + i + top) % rows, c = (col - radius + j + left) % cols;
      window[i * side + j] = is_hole ? 0 : response[r * cols + c];
    }
  float threat = 0;
  for (int i = 0; i < side; ++i)
    for (int j = 0; j < side; ++j) {
      const float value = window[i * side + j];
      bool is_maximum = true;
      for (int y = std::max(i - 1, 0); y <= std::min(i + 1, side - 1); ++y)
        for (int x = std::max(j - 1, 0); x <= std::min(j + 1, side - 1); ++x)
          is_maximum = is_maximum && value >= window[y * side + x];
      if (is_maximum) threat = std::max(threat, value * weight[i * side + j]);
    }
  return double(threat) / double(most);
}

MSCF_KERNEL void locate_peak(const float* response, const float* response_f, int rows, int cols, int bins, int steps,
                               double converged_rad, double* offset_rc) {
  const Cell peak = highest(response, rows, cols, 0, 0);
  const double to_row_rad = 2 * M_PI / rows, to_col_rad = 2 * M_PI / cols;
  offset_rc[0] = signed_frequency(peak.row, rows);
  offset_rc[1] = signed_frequency(peak.col, cols);
  double angle_r = offset_rc[0] * to_row_rad, angle_c = offset_rc[1] * to_col_rad;
  static thread_local Scratch<double> scratch;
  double* sums = scratch.take(size_t(6) * bins);
  for (int step = 0; step < steps; ++step) {
    const Moments m = moments_at(response_f, rows, cols, bins, angle_r, angle_c, sums);
    const double det = m.by_row_row * m.by_col_col - m.by_row_col * m.by_row_col;
    if (det == 0 || !std::isfinite(det)) break;
    const double step_r = (m.by_col_col * m.by_row - m.by_row_col * m.by_col) / det;
    const double step_c = (m.by_row_row * m.by_col - m.by_row_col * m.by_row) / det;
    angle_r -= step_r;
    angle_c -= step_c;
    if (std::max(std::abs(step_r), std::abs(step_c)) < converged_rad) break;  // a further step would be its square
  }
  const double value = moments_at(response_f, rows, cols, bins, angle_r, angle_c, sums).value;
  if (!(value >= response[peak.row * cols + peak.col])) return;  // also where it is no number
  offset_rc[0] = angle_r / to_row_rad;
  offset_rc[1] = angle_c / to_col_rad;
}

}  // namespace mscf
