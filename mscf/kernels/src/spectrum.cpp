// Discrete Fourier transforms by matrix products of folded maps, and what is done with spectra.
//
// A transform of a real row needs the cosines of its even part and the sines of its odd part alone, and rows k and M - k
// of a map's spectrum are sum and difference of the same two products: half of the multiplications of the plain product.

#include <cmath>
#include <cstring>

#include "kernels.hpp"
#include "lanes.hpp"
#include "scratch.hpp"

namespace mscf {
namespace {

// Even and odd part of each row of a windowed map (rows, cols), (rows, cols / 2 + 1) each.
MSCF_INLINE void fold_rows(const float* map, const float* window, int rows, int cols, float* even, float* odd) {
  const int half = cols / 2, bins = half + 1;
  for (int r = 0; r < rows; ++r) {
    const float *x = map + r * cols, *w = window + r * cols;
    float *e = even + r * bins, *o = odd + r * bins;
    e[0] = x[0] * w[0];
    o[0] = 0;
    for (int j = 1; j < half; ++j) {
      const float one = x[j] * w[j], other = x[cols - j] * w[cols - j];
      e[j] = one + other;
      o[j] = one - other;
    }
    e[half] = x[half] * w[half];
    o[half] = 0;
  }
}

// Sum and difference of rows n and rows - n, (rows / 2 + 1, width) each.
MSCF_INLINE void fold_columns(const float* map, int rows, int width, float* even, float* odd) {
  for (int r = 0; r <= rows / 2; ++r) {
    const float *one = map + r * width, *other = map + (rows - r) % rows * width;
    const float share = r == 0 || 2 * r == rows ? 0 : 1;  // of the mirrored row, which is none there
    for (int j = 0; j < width; j += kLanes) {
      const int k = tile_at(j, width);
      const Lanes a = load(one + k), b = load(other + k);
      store(even + r * width + k, a + share * b);
      store(odd + r * width + k, share * (a - b));
    }
  }
}

// Rows n and half - n of folded maps, whose cosines are the same for even bins and opposite for odd ones (sines the
// other way round): their sums and differences, (half / 2 + 1, width) each.
MSCF_INLINE void fold_again(const float* rows, int half, int width, float* sums, float* differences) {
  for (int r = 0; r <= half / 2; ++r) {
    const float *one = rows + r * width, *other = rows + (half - r) * width;
    const float share = 2 * r == half ? 0 : 1;
    for (int j = 0; j < width; j += kLanes) {
      const int k = tile_at(j, width);
      const Lanes a = load(one + k), b = share * load(other + k);
      store(sums + r * width + k, a + b);
      store(differences + r * width + k, a - b);
    }
  }
}

// Products with the cosines and sines of bins 0 .. M/2 of folded columns, (M/2 + 1, width) each. `scratch`: room for
// 4 (M/4 + 1) rows.
MSCF_INLINE void transform_columns(const float* even_f, const float* odd_f, const Grid& grid, int width, float* scratch,
                                   float* cos_f, float* sin_f) {
  const int half = grid.rows / 2, row_bins = half + 1, depth = half / 2 + 1;
  float *even_sum = scratch, *even_rest = even_sum + depth * width;
  float *odd_sum = even_rest + depth * width, *odd_rest = odd_sum + depth * width;
  fold_again(even_f, half, width, even_sum, even_rest);
  fold_again(odd_f, half, width, odd_sum, odd_rest);
  for (int odd = 0; odd < 2; ++odd) {  // bins 0, 2, ... and 1, 3, ...
    const int bins = (row_bins + 1 - odd) / 2, first = odd * row_bins;
    multiply(grid.row_cos + first, 2 * row_bins, odd ? even_rest : even_sum, width, cos_f + odd * width, 2 * width, bins,
             depth, width);
    multiply(grid.row_sin + first, 2 * row_bins, odd ? odd_sum : odd_rest, width, sin_f + odd * width, 2 * width, bins,
             depth, width);
  }
}

}  // namespace

MSCF_KERNEL void windowed_dft(const float* maps, const float* window, int channels, const Grid& grid,
                                float* maps_f) {
  const int rows = grid.rows, cols = grid.cols, bins = grid.bins, width = 2 * bins, row_bins = rows / 2 + 1;
  static thread_local Scratch<float> scratch;
  float* even = scratch.take(size_t(4) * rows * bins + size_t(rows) * width + size_t(4) * row_bins * width +
                             size_t(4) * (rows / 4 + 1) * width);
  float *odd = even + rows * bins, *re = odd + rows * bins, *im = re + rows * bins;
  float *half_f = im + rows * bins, *even_f = half_f + rows * width, *odd_f = even_f + row_bins * width;
  float *cos_f = odd_f + row_bins * width, *sin_f = cos_f + row_bins * width, *folded = sin_f + row_bins * width;
  for (int channel = 0; channel < channels; ++channel) {
    fold_rows(maps + channel * rows * cols, window, rows, cols, even, odd);
    multiply(even, bins, grid.col_cos, bins, re, bins, rows, bins, bins);
    multiply(odd, bins, grid.col_sin, bins, im, bins, rows, bins, bins);
    for (int i = 0; i < rows * bins; ++i) {
      half_f[2 * i] = re[i];
      half_f[2 * i + 1] = -im[i];
    }
    fold_columns(half_f, rows, width, even_f, odd_f);
    transform_columns(even_f, odd_f, grid, width, folded, cos_f, sin_f);
    float* out = maps_f + channel * rows * width;
    for (int r = 0; r < row_bins; ++r)
      unfold_row(cos_f + r * width, sin_f + r * width, width, out + r * width, out + (rows - r) % rows * width);
  }
}

MSCF_KERNEL void correlate(const float* a_f, const float* b_f, int channels, int size, float* sum_f) {
  std::memset(sum_f, 0, size_t(size) * 2 * sizeof *sum_f);
  for (int channel = 0; channel < channels; ++channel) {
    const float *a = a_f + size_t(channel) * size * 2, *b = b_f + size_t(channel) * size * 2;
    for (int i = 0; i < size; ++i) {
      sum_f[2 * i] += a[2 * i] * b[2 * i] + a[2 * i + 1] * b[2 * i + 1];
      sum_f[2 * i + 1] += a[2 * i] * b[2 * i + 1] - a[2 * i + 1] * b[2 * i];
    }
  }
}

MSCF_KERNEL void inverse_dft(const float* map_f, const Grid& grid, float* map) {
  const int rows = grid.rows, cols = grid.cols, bins = grid.bins, width = 2 * bins, row_bins = rows / 2 + 1;
  static thread_local Scratch<float> scratch;
  float* even_f = scratch.take(size_t(4) * row_bins * width + size_t(4) * rows * bins +
                               size_t(4) * (rows / 4 + 1) * width);
  float *odd_f = even_f + row_bins * width, *cos_f = odd_f + row_bins * width, *sin_f = cos_f + row_bins * width;
  float *re = sin_f + row_bins * width, *im = re + rows * bins, *even = im + rows * bins, *odd = even + rows * bins;
  fold_columns(map_f, rows, width, even_f, odd_f);
  transform_columns(even_f, odd_f, grid, width, odd + rows * bins, cos_f, sin_f);
  const float share = 1.0f / (float(rows) * float(cols));
  for (int r = 0; r < row_bins; ++r) {  // cos +- i sin; each bin but the first and last stands for two
    const float *c = cos_f + r * width, *s = sin_f + r * width;
    float *one_re = re + r * bins, *one_im = im + r * bins;
    float *other_re = re + ((rows - r) % rows) * bins, *other_im = im + ((rows - r) % rows) * bins;
    for (int j = 0; j < bins; ++j) {
      const float weight = j == 0 || j == bins - 1 ? share : 2 * share;
      const float c_re = c[2 * j], c_im = c[2 * j + 1], s_re = s[2 * j], s_im = s[2 * j + 1];
      other_re[j] = weight * (c_re + s_im);
      other_im[j] = weight * (c_im - s_re);
      one_re[j] = weight * (c_re - s_im);
      one_im[j] = weight * (c_im + s_re);
    }
  }
  multiply(re, bins, grid.col_cos, bins, even, bins, rows, bins, bins);
  multiply(im, bins, grid.col_sin, bins, odd, bins, rows, bins, bins);
  for (int r = 0; r < rows; ++r) {
    const float *e = even + r * bins, *o = odd + r * bins;
    float* x = map + r * cols;
    x[0] = e[0];
    for (int j = 1; j < bins; ++j) {
      x[cols - j] = e[j] + o[j];
      x[j] = e[j] - o[j];
    }
  }
}

// mean + rate (sample shifted - mean), and its energy over the channels.
MSCF_KERNEL void blend(const float* mean_f, const float* sample_f, float rate, const float* row_phase,
                         const float* col_phase, int channels, int rows, int bins, float* after_f, float* energy) {
  const int size = rows * bins;
  static thread_local Scratch<float> scratch;
  float* phase = scratch.take(size_t(size) * 2);
  for (int r = 0; r < rows; ++r)
    for (int j = 0; j < bins; ++j) {
      const float a = row_phase[2 * r], b = row_phase[2 * r + 1], c = col_phase[2 * j], d = col_phase[2 * j + 1];
      phase[2 * (r * bins + j)] = rate * (a * c - b * d);
      phase[2 * (r * bins + j) + 1] = rate * (a * d + b * c);
    }
  std::memset(energy, 0, size_t(size) * sizeof *energy);
  const float keep = 1 - rate;
  for (int channel = 0; channel < channels; ++channel) {
    const size_t first = size_t(channel) * size * 2;
    const float *mean = mean_f + first, *sample = sample_f + first;
    float* after = after_f + first;
    for (int i = 0; i < size; ++i) {
      const float p = phase[2 * i], q = phase[2 * i + 1], s = sample[2 * i], t = sample[2 * i + 1];
      const float re = keep * mean[2 * i] + (p * s - q * t);
      const float im = keep * mean[2 * i + 1] + (p * t + q * s);
      after[2 * i] = re;
      after[2 * i + 1] = im;
      energy[i] += re * re + im * im;
    }
  }
}

}  // namespace mscf
