// Patches of a frame, resized: OpenCV's fixed-point bilinear interpolation, column by column once a source row.

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels.hpp"
#include "lanes.hpp"
#include "scratch.hpp"

namespace mscf {
namespace {

constexpr int kSteps = 32;  // of a pixel: where a sample can lie
constexpr double kFine = 1024;

// Where a sample of the grid is, in steps, rounded as OpenCV does: in one go for a row, in two for a column.
MSCF_INLINE int64_t row_at(double first, double step, int i) {
  return (std::llrint((step * i + (first + step / 2)) * kFine) + int64_t(kFine) / kSteps / 2) >> 5;
}
MSCF_INLINE int64_t column_at(double first, double step, int i) {
  const int64_t origin = std::llrint((first + step / 2) * kFine) + int64_t(kFine) / kSteps / 2;
  return (origin + std::llrint(step * i * kFine)) >> 5;
}

MSCF_INLINE int within(int64_t pixel, int count) { return int(std::clamp<int64_t>(pixel, 0, count - 1)); }

typedef uint8_t FourBytes __attribute__((vector_size(4)));
typedef uint16_t Four __attribute__((vector_size(8)));

struct Column {
  ptrdiff_t before, after;   // offsets of the two pixels' first values
  uint16_t share;            // of the latter, in steps
  Four shares_before, shares_after;
};

// One row of the frame at the columns of the grid, times 32: (grid columns * CHANNELS).
template <int CHANNELS>
MSCF_INLINE void along_row(const uint8_t* row, ptrdiff_t channel_stride, const Column* columns, int count,
                           uint16_t* values) {
  for (int i = 0; i < count; ++i) {
    const Column& at = columns[i];
    for (int k = 0; k < CHANNELS; ++k) {
      const int before = row[at.before + k * channel_stride], after = row[at.after + k * channel_stride];
      values[i * CHANNELS + k] = uint16_t(before * (kSteps - at.share) + after * at.share);
    }
  }
}

// The same for three channels side by side, four values at a time: reads a byte behind each pixel, and writes a value behind the last.
MSCF_INLINE void along_row_of_three(const uint8_t* row, const Column* columns, int count, uint16_t* values) {
  for (int i = 0; i < count; ++i) {
    const Column& at = columns[i];
    FourBytes before, after;
    std::memcpy(&before, row + at.before, sizeof before);
    std::memcpy(&after, row + at.after, sizeof after);
    const Four mixed = __builtin_convertvector(before, Four) * at.shares_before +
                       __builtin_convertvector(after, Four) * at.shares_after;
    std::memcpy(values + 3 * i, &mixed, sizeof mixed);
  }
}

// The two rows of the frame that were looked at last, each at the columns of the grid.
struct Rows {
  uint16_t* values[2];
  int index[2];
};

MSCF_INLINE const uint16_t* row_of(Rows& rows, int index, int other, const Pixels& frame, const Column* columns,
                                   int count) {
  for (int i = 0; i < 2; ++i)
    if (rows.index[i] == index) return rows.values[i];
  const int slot = rows.index[0] == other ? 1 : 0;
  rows.index[slot] = index;
  const uint8_t* row = frame.data + index * frame.row_stride;
  const bool is_dense = frame.channel_stride == 1 && frame.col_stride == 3 && frame.row_stride > 0;
  if (frame.channels == 3 && is_dense && index + 1 < frame.rows)  // nothing may be read behind the last row
    along_row_of_three(row, columns, count, rows.values[slot]);
  else if (frame.channels == 3)
    along_row<3>(row, frame.channel_stride, columns, count, rows.values[slot]);
  else
    along_row<1>(row, frame.channel_stride, columns, count, rows.values[slot]);
  return rows.values[slot];
}

MSCF_INLINE void blend_rows(const uint16_t* upper, const uint16_t* lower, int share, int size, uint8_t* out) {
  const uint32_t low = uint32_t(share), high = uint32_t(kSteps - share);
  for (int i = 0; i < size; ++i) out[i] = uint8_t((upper[i] * high + lower[i] * low + 512) >> 10);
}

// Means of 2 x 2 of two rows of the grid.
MSCF_INLINE void halve(const uint8_t* upper, const uint8_t* lower, int count, int channels, uint8_t* out) {
  for (int i = 0; i < count; ++i)
    for (int k = 0; k < channels; ++k) {
      const int one = 2 * i * channels + k, other = one + channels;
      out[i * channels + k] = uint8_t((upper[one] + upper[other] + lower[one] + lower[other] + 2) >> 2);
    }
}

}  // namespace

MSCF_KERNEL void sample_exact(const Pixels& frame, const Rectangle& part, int out_rows, int out_cols,
                                uint8_t* patch) {
  const bool is_fine = part.height > 2.0 * out_rows || part.width > 2.0 * out_cols;
  const int grid_rows = is_fine ? 2 * out_rows : out_rows, grid_cols = is_fine ? 2 * out_cols : out_cols;
  const int channels = frame.channels, size = grid_cols * channels;
  static thread_local Scratch<Column> column_scratch;
  static thread_local Scratch<uint16_t> row_scratch;
  static thread_local Scratch<uint8_t> grid_scratch;
  Column* columns = column_scratch.take(size_t(grid_cols));
  for (int i = 0; i < grid_cols; ++i) {
    const int64_t at = column_at(part.left, part.width / grid_cols, i);
    columns[i].before = within(at >> 5, frame.cols) * frame.col_stride;
    columns[i].after = within((at >> 5) + 1, frame.cols) * frame.col_stride;
    columns[i].share = uint16_t(at & (kSteps - 1));
    columns[i].shares_before = Four{} + uint16_t(kSteps - columns[i].share);
    columns[i].shares_after = Four{} + columns[i].share;
  }
  uint16_t* values = row_scratch.take(2 * size_t(size) + 2);
  uint8_t* grid = grid_scratch.take(2 * size_t(size));
  Rows rows = {{values, values + size + 1}, {-1, -1}};
  for (int r = 0; r < grid_rows; ++r) {
    const int64_t at = row_at(part.top, part.height / grid_rows, r);
    const int before = within(at >> 5, frame.rows), after = within((at >> 5) + 1, frame.rows);
    const uint16_t* upper = row_of(rows, before, after, frame, columns, grid_cols);
    const uint16_t* lower = row_of(rows, after, before, frame, columns, grid_cols);
    uint8_t* out = is_fine ? grid + (r % 2) * size : patch + ptrdiff_t(r) * size;
    blend_rows(upper, lower, int(at & (kSteps - 1)), size, out);
    if (is_fine && r % 2 == 1)
      halve(grid, grid + size, out_cols, channels, patch + ptrdiff_t(r / 2) * out_cols * channels);
  }
}

}  // namespace mscf
