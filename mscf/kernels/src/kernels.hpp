// The kernels: pure functions of arrays whose sizes module.cpp has checked. Spectra are (re, im) pairs of floats.
//
// Each has a twin in Python of the same name, whose docstring says what it computes and by which equation of the paper.
// Names of sizes: C channels, M x N cells, N' = N / 2 + 1 bins of the half spectrum, m x n filter support, K scales.
#pragma once

#include <cstddef>
#include <cstdint>

namespace mscf {

constexpr int kCell = 4;  // px, of the feature channels

struct Pixels {  // of a picture or a patch, uint8, (rows, cols, channels); strides in bytes
  const uint8_t* data;
  ptrdiff_t row_stride, col_stride, channel_stride;  // a patch's are dense
  int rows, cols, channels;
};

// features
void fhog(const Pixels& patch, const uint8_t* orientation_bins, float* features);
void gray(const Pixels& patch, const float* luma_bgr, float* cells);
void color_names(const Pixels& patch, const float* table, float* cells);

// sampling
struct Rectangle {
  double top, left, height, width;  // of its edges, px; pixel centres are at whole numbers
};
void sample_exact(const Pixels& frame, const Rectangle& part, int out_rows, int out_cols, uint8_t* patch);

// spectrum
struct Grid {
  int rows, cols, bins;     // M, N, N'
  const float* row_cos;     // (M/2 + 1, M/2 + 1): cos(2 pi r n / M)
  const float* row_sin;     // ... and sin
  const float* col_cos;     // (N/2 + 1, N/2 + 1): cos(2 pi j k / N)
  const float* col_sin;
};
void windowed_dft(const float* maps, const float* window, int channels, const Grid& grid, float* maps_f);
void correlate(const float* a_f, const float* b_f, int channels, int size, float* sum_f);
void inverse_dft(const float* map_f, const Grid& grid, float* map);
void blend(const float* mean_f, const float* sample_f, float rate, const float* row_phase, const float* col_phase,
           int channels, int rows, int bins, float* after_f, float* energy);

// filter
struct Support {
  int rows, bins;           // M, N'
  int height, width;        // m, n
  const float* row_cos;     // (M/2 + 1, m/2 + 1): cos(2 pi k row / M) of row M/2 + i, i = 0 .. m/2
  const float* row_sin;
  const float* cols_f;      // (n, N') complex
  const float* cols_inv;    // (2 N', 16 * ceil(n / 16)) with zeros at the right
  int padded_width;
};
void solve_g(const float* label_f, const float* energy, const float* fit_f, const float* fit_before_f,
             const float* a_before_f, float inverse_growth, float weight, int size, float* a_f, float* fit_g_f);
void restrict_h(const float* model_f, const float* a_f, const float* h, float shrink, int channels,
                const Support& support, float* h_after, float* fit_f);
void split_label(const float* r_f, const float* xi_f, const float* fit_f, const float* ideal_f, const float* previous_f,
                 float penalty, float cells, float ideal_weight, float previous_weight, int size, float* r_after_f,
                 float* xi_after_f);
void filter_of(const float* model_f, const float* h, const float* h_before, const float* a_f, const float* a_before_f,
               float inverse_growth, int channels, const Support& support, float* g_f);

// response
double peak_to_sidelobe(const float* response, int rows, int cols, int hole);
double threat_in_window(const float* response, int rows, int cols, int radius, const float* weight);
void locate_peak(const float* response, const float* response_f, int rows, int cols, int bins, int steps,
                 double converged_rad, double* offset_rc);

// scale
void scale_dft(const float* features, int scales, int size, const float* cosines, const float* sines, float* x_f);
void scale_match(const float* num_f, const float* x_f, int bins, int size, float* total_f);
void scale_learn(const float* num_f, const float* den, const float* x_f, const float* label_f, float rate, int bins,
                 int size, float* num_after_f, float* den_after);

}  // namespace mscf
