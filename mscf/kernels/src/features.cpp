// Feature channels of a patch: FHOG (one pass over the pixels), gray, colour names.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <initializer_list>

#include "kernels.hpp"
#include "lanes.hpp"
#include "scratch.hpp"

namespace mscf {
namespace {

constexpr int kSigned = 18, kUnsigned = 9, kBlocks = 4;
constexpr int kReach = 510, kSpan = 2 * kReach + 1;
constexpr float kClip = 0.2f, kTexture = 0.2357f;
constexpr float kNormFloor = 1e-4f / 4 / 256;
constexpr float kBorderGain = 8.0f / 7.0f;
constexpr int kNames = 10;

// Differences of a row's values, (cols * channels) each: twice the gradient.
MSCF_INLINE void differences(const Pixels& patch, int y, int16_t* dy, int16_t* dx) {
  const int step = patch.channels, width = patch.cols * step;
  const uint8_t* row = patch.data + y * patch.row_stride;
  const bool is_top = y == 0, is_bottom = y == patch.rows - 1;
  const uint8_t* above = is_top ? row : row - patch.row_stride;
  const uint8_t* below = is_bottom ? row : row + patch.row_stride;
  const int16_t gain = is_top || is_bottom ? 2 : 1;  // at an edge they are one pixel apart, so twice as much
  for (int i = 0; i < width; ++i) dy[i] = int16_t(gain * (below[i] - above[i]));
  for (int i = 0; i < width - 2 * step; ++i) dx[i + step] = int16_t(row[i + 2 * step] - row[i]);
  for (int i = 0; i < step; ++i) {
    dx[i] = int16_t(2 * (row[i + step] - row[i]));
    dx[width - step + i] = int16_t(2 * (row[width - step + i] - row[width - 2 * step + i]));
  }
}

// Square of the strongest difference among a pixel's channels, the last one first among equals, and its code.
MSCF_INLINE void strongest(const int16_t* dy, const int16_t* dx, int cols, int channels, int32_t* squared,
                           int32_t* code) {
  if (channels == 1) {
    for (int x = 0; x < cols; ++x) {
      squared[x] = dx[x] * dx[x] + dy[x] * dy[x];
      code[x] = dy[x] * kSpan + dx[x] + kReach * kSpan + kReach;
    }
    return;
  }
  for (int x = 0; x < cols; ++x) {
    const int16_t *v = dy + 3 * x, *h = dx + 3 * x;
    const int32_t blue = h[0] * h[0] + v[0] * v[0];
    const int32_t green = h[1] * h[1] + v[1] * v[1];
    const int32_t red = h[2] * h[2] + v[2] * v[2];
    int32_t most = red, best_v = v[2], best_h = h[2];
    best_v = green > most ? v[1] : best_v;
    best_h = green > most ? h[1] : best_h;
    most = green > most ? green : most;
    best_v = blue > most ? v[0] : best_v;
    best_h = blue > most ? h[0] : best_h;
    most = blue > most ? blue : most;
    squared[x] = most;
    code[x] = best_v * kSpan + best_h + kReach * kSpan + kReach;
  }
}

// Gradient magnitudes by orientation, shared bilinearly among the 2 x 2 nearest cells. `votes` is 2 x (18, M + 2, N + 2)
// zeros, the second for every other pixel: neighbours mostly vote for the same, and would wait for one another. A border
// of one cell takes what falls outside.
MSCF_INLINE void vote(const Pixels& patch, const uint8_t* orientation_bins, int rows, int cols, float* votes,
                      int16_t* diff, int32_t* per_pixel, float* magnitude) {
  const int stride = cols + 2, plane = (rows + 2) * stride, votes_size = kSigned * plane;
  int16_t *dy = diff, *dx = diff + patch.cols * patch.channels;
  int32_t *squared = per_pixel, *code = per_pixel + patch.cols;
  // mean over a cell's pixels; 1/2 as the differences are over two pixels
  constexpr float kShare = 1.0f / (2 * kCell * kCell);
  for (int y = 0; y < rows * kCell; ++y) {
    differences(patch, y, dy, dx);
    strongest(dy, dx, patch.cols, patch.channels, squared, code);
    for (int x = 0; x < patch.cols; ++x) magnitude[x] = std::sqrt(float(squared[x]));
    const float below = (float((y + kCell / 2) % kCell) + 0.5f) / kCell;
    float* upper = votes + ((y + kCell / 2) / kCell) * stride;
    const int last = cols * kCell;
    for (int first = -kCell / 2; first < last; first += kCell, ++upper)  // pixels between the middles of two cells
      for (int step = 0; step < kCell; ++step) {
        const int x = first + step;
        if (x < 0 || x >= last) continue;
        const float right = (float(step) + 0.5f) / kCell;
        const int bin = std::min<int>(orientation_bins[code[x]], kSigned - 1);  // whatever the table holds
        float* cell = upper + step % 2 * votes_size + bin * plane;
        const float strong = magnitude[x] * kShare, low = strong * below, high = strong - low;
        const float high_right = high * right, low_right = low * right;
        cell[0] += high - high_right;
        cell[1] += high_right;
        cell[stride] += low - low_right;
        cell[stride + 1] += low_right;
      }
  }
  for (int i = 0; i < votes_size; ++i) votes[i] += votes[votes_size + i];
}

MSCF_INLINE void raise_border(int rows, int cols, float* votes) {
  const int stride = cols + 2, plane = (rows + 2) * stride;
  for (int bin = 0; bin < kSigned; ++bin) {
    float* inside = votes + bin * plane + stride + 1;
    for (int edge : {0, rows - 1})
      for (int x = 0; x < cols; ++x) inside[edge * stride + x] *= kBorderGain;
    for (int edge : {0, cols - 1})
      for (int y = 0; y < rows; ++y) inside[y * stride + edge] *= kBorderGain;
  }
}

// Inverse norms of blocks of 2 x 2 cells, (M + 1, N + 1): block (i, j) covers cells i-1..i, j-1..j; one that would reach
// over the border repeats the nearest one inside.
MSCF_INLINE void block_gains(const float* energy, int rows, int cols, float* gain) {
  const int lower = rows > 1 ? rows - 1 : 1, right = cols > 1 ? cols - 1 : 1;
  const int row_step = rows > 1 ? cols : 0, col_step = cols > 1 ? 1 : 0;
  for (int i = 0; i <= rows; ++i) {
    const int r = i < 1 ? 0 : i - 1 < lower ? i - 1 : lower - 1;
    const float *up = energy + r * cols, *down = up + row_step;
    float* out = gain + i * (cols + 1);
    for (int j = 0; j < right; ++j) {
      const float sum = (up[j] + down[j]) + (up[j + col_step] + down[j + col_step]);
      out[j + 1] = 1 / std::sqrt(sum + kNormFloor);
    }
    out[0] = out[1];
    if (cols > 1) out[cols] = out[cols - 1];
  }
}

// The first `count` of 16.
MSCF_INLINE void put(float* to, const Lanes& values, int count) {
  if (count == kLanes)
    store(to, values);
  else
    std::memcpy(to, &values, size_t(count) * sizeof *to);
}

// Up to 16 cells of a row, all channels. Of the votes and gains 16 are read.
MSCF_INLINE void normalise_tile(const float* votes, int plane, const float* gain, int gain_stride, float* features,
                                int cells, int count) {
  // in the order of the channels: the block that ends below and to the right of a cell comes first
  const Lanes gains[kBlocks] = {load(gain + gain_stride + 1), load(gain + 1), load(gain + gain_stride), load(gain)};
  const Lanes clip = all(kClip);
  Lanes texture[kBlocks] = {all(0), all(0), all(0), all(0)};
  for (int bin = 0; bin < kUnsigned; ++bin) {
    const Lanes one = load(votes + bin * plane), other = load(votes + (bin + kUnsigned) * plane), both = one + other;
    Lanes one_sum = all(0), other_sum = all(0), both_sum = all(0);
    for (int block = 0; block < kBlocks; ++block) {
      const Lanes one_clipped = lesser(one * gains[block], clip), other_clipped = lesser(other * gains[block], clip);
      one_sum = one_sum + one_clipped;
      other_sum = other_sum + other_clipped;
      both_sum = both_sum + lesser(both * gains[block], clip);
      texture[block] = texture[block] + one_clipped + other_clipped;
    }
    put(features + bin * cells, 0.5f * one_sum, count);
    put(features + (bin + kUnsigned) * cells, 0.5f * other_sum, count);
    put(features + (bin + kSigned) * cells, 0.5f * both_sum, count);
  }
  for (int block = 0; block < kBlocks; ++block)
    put(features + (kSigned + kUnsigned + block) * cells, kTexture * texture[block], count);
}

// Votes (18, M + 2, N + 2) to channels (31, M, N); behind votes and gains 16 more can be read.
MSCF_INLINE void normalise(const float* votes, int rows, int cols, float* energy, float* gain, float* features) {
  const int stride = cols + 2, plane = (rows + 2) * stride, cells = rows * cols;
  std::memset(energy, 0, size_t(cells) * sizeof *energy);
  for (int bin = 0; bin < kUnsigned; ++bin) {
    const float *one = votes + bin * plane + stride + 1, *other = one + kUnsigned * plane;
    for (int y = 0; y < rows; ++y)
      for (int x = 0; x < cols; ++x) {
        const float both = one[y * stride + x] + other[y * stride + x];
        energy[y * cols + x] += both * both;
      }
  }
  block_gains(energy, rows, cols, gain);
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < cols; x += kLanes) {
      const int first = cols < kLanes ? 0 : x + kLanes <= cols ? x : cols - kLanes;
      normalise_tile(votes + (y + 1) * stride + first + 1, plane, gain + y * (cols + 1) + first, cols + 1,
                     features + y * cols + first, cells, cols < kLanes ? cols : kLanes);
    }
}

}  // namespace

MSCF_KERNEL void fhog(const Pixels& patch, const uint8_t* orientation_bins, float* features) {
  const int rows = patch.rows / kCell, cols = patch.cols / kCell;  // a rest below a cell is left out
  const size_t votes_size = size_t(kSigned) * (rows + 2) * (cols + 2);
  static thread_local Scratch<float> floats;
  static thread_local Scratch<int32_t> ints;
  static thread_local Scratch<int16_t> shorts;
  float* votes = floats.take(2 * votes_size + size_t(rows + 1) * (cols + 1) + size_t(rows) * cols + patch.cols + kLanes);
  float* gain = votes + 2 * votes_size;
  float* energy = gain + (rows + 1) * (cols + 1);
  float* magnitude = energy + rows * cols;
  std::memset(votes, 0, 2 * votes_size * sizeof *votes);
  vote(patch, orientation_bins, rows, cols, votes, shorts.take(2 * size_t(patch.cols) * patch.channels),
       ints.take(2 * size_t(patch.cols)), magnitude);
  raise_border(rows, cols, votes);
  normalise(votes, rows, cols, energy, gain, features);
}

MSCF_KERNEL void gray(const Pixels& patch, const float* luma_bgr, float* cells) {
  const int rows = patch.rows / kCell, cols = patch.cols / kCell, channels = patch.channels;
  const int width = patch.cols * channels;
  const float share = 1.0f / (kCell * kCell);
  static thread_local Scratch<uint16_t> scratch;
  uint16_t* columns = scratch.take(size_t(width));  // sums over the rows of a cell
  for (int r = 0; r < rows; ++r) {
    const uint8_t *one = patch.data + r * kCell * patch.row_stride, *two = one + patch.row_stride,
                  *three = two + patch.row_stride, *four = three + patch.row_stride;
    for (int i = 0; i < width; ++i) columns[i] = uint16_t(one[i] + two[i] + three[i] + four[i]);
    for (int c = 0; c < cols; ++c) {
      const uint16_t* px = columns + c * kCell * channels;
      float luma = 0;
      for (int k = 0; k < channels; ++k) {
        const int sum = px[k] + px[channels + k] + px[2 * channels + k] + px[3 * channels + k];
        luma += (channels == 1 ? 1 : luma_bgr[k]) * float(sum);
      }
      cells[r * cols + c] = luma * share / 255 - 0.5f;
    }
  }
}

MSCF_KERNEL void color_names(const Pixels& patch, const float* table, float* cells) {
  const int rows = patch.rows / kCell, cols = patch.cols / kCell;
  constexpr float kShare = 1.0f / (kCell * kCell);
  typedef float Eight __attribute__((vector_size(8 * sizeof(float))));
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < cols; ++c) {
      Eight sum = {};
      float rest[kNames - 8] = {};
      for (int y = 0; y < kCell; ++y) {
        const uint8_t* px = patch.data + (r * kCell + y) * patch.row_stride + c * kCell * 3;
        for (int x = 0; x < kCell; ++x, px += 3) {
          const float* names = table + ((px[2] >> 3) | (px[1] >> 3) << 5 | (px[0] >> 3) << 10) * kNames;
          Eight first;
          std::memcpy(&first, names, sizeof first);
          sum += first;
          rest[0] += names[8];
          rest[1] += names[9];
        }
      }
      float* cell = cells + r * cols + c;
      for (int k = 0; k < 8; ++k) cell[k * rows * cols] = sum[k] * kShare;
      for (int k = 8; k < kNames; ++k) cell[k * rows * cols] = rest[k - 8] * kShare;
    }
}

}  // namespace mscf
