// The scale filter's transforms over the K scales (K odd), for all features at once.

#include "kernels.hpp"
#include "lanes.hpp"
#include "scratch.hpp"

namespace mscf {

MSCF_KERNEL void scale_dft(const float* features, int scales, int size, const float* cosines,
                             const float* sines, float* x_f) {
  const int bins = scales / 2 + 1;
  static thread_local Scratch<float> scratch;
  float* even = scratch.take(size_t(4) * bins * size);
  float *odd = even + bins * size, *re = odd + bins * size, *im = re + bins * size;
  for (int k = 0; k < bins; ++k) {
    const float *one = features + k * size, *other = features + (k == 0 ? 0 : scales - k) * size;
    for (int i = 0; i < size; ++i) {
      even[k * size + i] = k == 0 ? one[i] : one[i] + other[i];
      odd[k * size + i] = k == 0 ? 0 : one[i] - other[i];
    }
  }
  multiply(cosines, bins, even, size, re, size, bins, bins, size);
  multiply(sines, bins, odd, size, im, size, bins, bins, size);
  for (int i = 0; i < bins * size; ++i) {
    x_f[2 * i] = re[i];
    x_f[2 * i + 1] = -im[i];
  }
}

MSCF_KERNEL void scale_match(const float* num_f, const float* x_f, int bins, int size, float* total_f) {
  constexpr int kPairs = kLanes / 2;
  for (int k = 0; k < bins; ++k) {
    const float *n = num_f + size_t(k) * size * 2, *x = x_f + size_t(k) * size * 2;
    float re[kPairs] = {}, im[kPairs] = {};
    int i = 0;
    for (; i + kPairs <= size; i += kPairs)
      for (int j = 0; j < kPairs; ++j) {
        const float a = n[2 * (i + j)], b = n[2 * (i + j) + 1], c = x[2 * (i + j)], d = x[2 * (i + j) + 1];
        re[j] += a * c - b * d;
        im[j] += a * d + b * c;
      }
    for (; i < size; ++i) {
      re[0] += n[2 * i] * x[2 * i] - n[2 * i + 1] * x[2 * i + 1];
      im[0] += n[2 * i] * x[2 * i + 1] + n[2 * i + 1] * x[2 * i];
    }
    float sum_re = 0, sum_im = 0;
    for (int j = 0; j < kPairs; ++j) {
      sum_re += re[j];
      sum_im += im[j];
    }
    total_f[2 * k] = sum_re;
    total_f[2 * k + 1] = sum_im;
  }
}

MSCF_KERNEL void scale_learn(const float* num_f, const float* den, const float* x_f, const float* label_f, float rate,
                               int bins, int size, float* num_after_f, float* den_after) {
  const float keep = 1 - rate;
  for (int k = 0; k < bins; ++k) {
    const size_t first = size_t(k) * size * 2;
    const float *n = num_f + first, *x = x_f + first;
    float* after = num_after_f + first;
    const float p = rate * label_f[2 * k], q = rate * label_f[2 * k + 1];
    float sum[kLanes] = {};
    int i = 0;
    for (; i + kLanes <= 2 * size; i += kLanes)
      for (int j = 0; j < kLanes; ++j) sum[j] += x[i + j] * x[i + j];
    for (; i < 2 * size; ++i) sum[0] += x[i] * x[i];
    for (i = 0; i < 2 * size; i += 2) {  // label times conj(x)
      after[i] = keep * n[i] + (p * x[i] + q * x[i + 1]);
      after[i + 1] = keep * n[i + 1] + (q * x[i] - p * x[i + 1]);
    }
    float energy = 0;
    for (int j = 0; j < kLanes; ++j) energy += sum[j];
    den_after[k] = keep * den[k] + rate * energy;
  }
}

}  // namespace mscf
