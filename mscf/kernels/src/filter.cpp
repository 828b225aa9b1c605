// The filter's ADMM steps, channel by channel, so that what is between the transforms stays in the nearest cache.
//
// Rows of the support are counted from the middle of the map: i = -m/2 .. (m - 1)/2. The exponentials of rows i and -i,
// and those of bins k and M - k, are conjugate, so that all transforms over rows are products with cosines of sums and
// sines of differences.

#include <cstring>

#include "kernels.hpp"
#include "lanes.hpp"
#include "scratch.hpp"

namespace mscf {
namespace {

// Cosine and sine parts of the DFT of a map on the support (m, n), (M/2 + 1, 2 N') each. `scratch`: 2 (m + 1) * 2 N'.
MSCF_INLINE void to_parts(const float* map, const Support& s, float* scratch, float* cos_f, float* sin_f) {
  const int width = 2 * s.bins, row_bins = s.rows / 2 + 1, middle = s.height / 2, reach = middle + 1;
  float *half_f = scratch, *even_f = half_f + s.height * width, *odd_f = even_f + reach * width;
  multiply(map, s.width, s.cols_f, width, half_f, width, s.height, s.width, width);
  for (int i = 0; i <= middle; ++i) {
    const bool has_right = i > 0 && middle + i < s.height;
    const float *left = half_f + (middle - i) * width, *right = has_right ? half_f + (middle + i) * width : left;
    float *e = even_f + i * width, *o = odd_f + i * width;
    for (int j = 0; j < width; ++j) {
      e[j] = has_right ? right[j] + left[j] : left[j];
      o[j] = has_right ? right[j] - left[j] : -left[j];
    }
  }
  multiply(s.row_cos, reach, even_f, width, cos_f, width, row_bins, reach, width);
  multiply(s.row_sin, reach, odd_f, width, sin_f, width, row_bins, reach, width);
}

}  // namespace

MSCF_KERNEL void solve_g(const float* label_f, const float* energy, const float* fit_f, const float* fit_before_f,
                           const float* a_before_f, float inverse_growth, float weight, int size, float* a_f,
                           float* fit_g_f) {
  for (int i = 0; i < size; ++i) {
    const float down = 1 / (energy[i] + weight);
    for (int part = 0; part < 2; ++part) {
      const int k = 2 * i + part;
      const float before = fit_before_f[k] + energy[i] * a_before_f[k] - fit_f[k];
      const float fit_w = fit_f[k] - inverse_growth * before;
      const float a = (label_f[k] - fit_w) * down;
      a_f[k] = a;
      fit_g_f[k] = fit_w + energy[i] * a;
    }
  }
}

MSCF_KERNEL void restrict_h(const float* model_f, const float* a_f, const float* h, float shrink, int channels,
                              const Support& s, float* h_after, float* fit_f) {
  const int width = 2 * s.bins, size = s.rows * width, row_bins = s.rows / 2 + 1;
  const int middle = s.height / 2, reach = middle + 1;
  static thread_local Scratch<float> memory;
  float* even_f = memory.take(size_t(2) * row_bins * width + size_t(2) * reach * width + size_t(s.height) * width +
                              size_t(s.height) * s.padded_width + size_t(2) * (s.height + 1) * width +
                              size_t(2) * row_bins * reach + size_t(2) * width + size_t(2) * size);
  float *odd_f = even_f + row_bins * width, *cos_f = odd_f + row_bins * width, *sin_f = cos_f + reach * width;
  float *half_f = sin_f + reach * width, *inverse = half_f + s.height * width;
  float *scratch = inverse + s.height * s.padded_width, *back_cos = scratch + 2 * (s.height + 1) * width;
  float *back_sin = back_cos + row_bins * reach, *line = back_sin + row_bins * reach;
  float *a_re = line + 2 * width, *a_im = a_re + size;  // (re, re) and (-im, im): m a = m a_re + swapped(m) a_im
  for (int i = 0; i < size; i += 2) {
    a_re[i] = a_re[i + 1] = a_f[i];
    a_im[i] = -a_f[i + 1];
    a_im[i + 1] = a_f[i + 1];
  }
  for (int i = 0; i < reach; ++i)
    for (int k = 0; k < row_bins; ++k) {
      back_cos[i * row_bins + k] = s.row_cos[k * reach + i] / float(s.rows);
      back_sin[i * row_bins + k] = s.row_sin[k * reach + i] / float(s.rows);
    }
  float is_new[kLanes];  // of the last tile of a row, what the one before has not had
  for (int lane = 0; lane < kLanes; ++lane) is_new[lane] = lane >= (kLanes - width % kLanes) % kLanes ? 1 : 0;
  std::memset(fit_f, 0, size_t(size) * sizeof *fit_f);
  for (int channel = 0; channel < channels; ++channel) {
    const float* m_f = model_f + size_t(channel) * size;
    for (int r = 0; r < row_bins; ++r) {  // m a, its bins k and M - k
      const int here = r * width, there = (s.rows - r) % s.rows * width;
      const float share = here == there ? 0 : 1;  // of the mirrored bin
      for (int j = 0; j < width; j += kLanes) {
        const int k = tile_at(j, width);
        const Lanes m = load(m_f + here + k), n = load(m_f + there + k);
        const Lanes one = m * load(a_re + here + k) + swapped(m) * load(a_im + here + k);
        const Lanes other = share * (n * load(a_re + there + k) + swapped(n) * load(a_im + there + k));
        store(even_f + here + k, one + other);
        store(odd_f + here + k, one - other);
      }
    }
    multiply(back_cos, row_bins, even_f, width, cos_f, width, reach, row_bins, width);
    multiply(back_sin, row_bins, odd_f, width, sin_f, width, reach, row_bins, width);
    for (int i = 0; i <= middle; ++i) {  // rows i and -i of the support: cos + i sin and cos - i sin
      float* right = middle + i < s.height ? half_f + (middle + i) * width : line;
      unfold_row(cos_f + i * width, sin_f + i * width, width, half_f + (middle - i) * width, right);
    }
    multiply(half_f, width, s.cols_inv, s.padded_width, inverse, s.padded_width, s.height, width, s.padded_width);
    const float* old = h + size_t(channel) * s.height * s.width;
    float* after = h_after + size_t(channel) * s.height * s.width;
    for (int r = 0; r < s.height; ++r)
      for (int c = 0; c < s.width; ++c)
        after[r * s.width + c] = shrink * (old[r * s.width + c] + inverse[r * s.padded_width + c]);
    to_parts(after, s, scratch, even_f, odd_f);
    for (int r = 0; r < row_bins; ++r) {
      unfold_row(even_f + r * width, odd_f + r * width, width, line, line + width);
      const int here = r * width, there = (s.rows - r) % s.rows * width;
      for (int side = 0; side < (here == there ? 1 : 2); ++side) {
        const float *row = m_f + (side == 0 ? here : there), *of_h = line + side * width;
        float* fit = fit_f + (side == 0 ? here : there);
        for (int j = 0; j < width; j += kLanes) {  // conj(m) DFT(h)
          const int k = tile_at(j, width);
          const Lanes m = load(row + k), x = load(of_h + k);
          const Lanes product = real_parts(m) * x + conjugate(imaginary_parts(m)) * swapped(x);
          store(fit + k, load(fit + k) + (k == j ? product : load(is_new) * product));
        }
      }
    }
  }
}

MSCF_KERNEL void split_label(const float* r_f, const float* xi_f, const float* fit_f, const float* ideal_f,
                               const float* previous_f, float penalty, float cells, float ideal_weight,
                               float previous_weight, int size, float* r_after_f, float* xi_after_f) {
  const float weight = penalty * cells;
  const float s_share = 1 / (1 + weight), r_share = 1 / (ideal_weight + previous_weight + weight);
  for (int i = 0; i < 2 * size; ++i) {
    const float correlation = i % 2 == 0 ? fit_f[i] : -fit_f[i];
    const float s = (correlation + weight * r_f[i] + cells * xi_f[i]) * s_share;
    const float r =
        (ideal_weight * ideal_f[i] + previous_weight * previous_f[i] + weight * s - cells * xi_f[i]) * r_share;
    r_after_f[i] = r;
    xi_after_f[i] = xi_f[i] + penalty * (s - r);
  }
}

MSCF_KERNEL void filter_of(const float* model_f, const float* h, const float* h_before, const float* a_f,
                             const float* a_before_f, float inverse_growth, int channels, const Support& s,
                             float* g_f) {
  const int width = 2 * s.bins, size = s.rows * width, row_bins = s.rows / 2 + 1, cells = s.height * s.width;
  static thread_local Scratch<float> memory;
  float* cos_f = memory.take(size_t(2) * row_bins * width + size_t(2) * (s.height + 1) * width + size_t(size) +
                             size_t(cells));
  float *sin_f = cos_f + row_bins * width, *scratch = sin_f + row_bins * width;
  float *c_f = scratch + 2 * (s.height + 1) * width, *k = c_f + size;
  for (int i = 0; i < size; ++i) c_f[i] = a_f[i] - inverse_growth * a_before_f[i];
  for (int channel = 0; channel < channels; ++channel) {
    const float* m_f = model_f + size_t(channel) * size;
    float* g_channel = g_f + size_t(channel) * size;
    const float *now = h + size_t(channel) * cells, *before = h_before + size_t(channel) * cells;
    for (int i = 0; i < cells; ++i) k[i] = (1 + inverse_growth) * now[i] - inverse_growth * before[i];
    to_parts(k, s, scratch, cos_f, sin_f);
    for (int r = 0; r < row_bins; ++r)
      unfold_row(cos_f + r * width, sin_f + r * width, width, g_channel + r * width,
                 g_channel + (s.rows - r) % s.rows * width);
    for (int i = 0; i < size; i += 2) {
      g_channel[i] += m_f[i] * c_f[i] - m_f[i + 1] * c_f[i + 1];
      g_channel[i + 1] += m_f[i] * c_f[i + 1] + m_f[i + 1] * c_f[i];
    }
  }
}

}  // namespace mscf
