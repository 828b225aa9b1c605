// Sixteen floats at a time, in vectors that the machine has registers for, and matrix products of them.
#pragma once

#include <cstddef>
#include <cstring>

// On x86-64 the kernels are compiled for AVX2 with FMA, and `module.cpp` refuses a processor without; AVX-512 was no
// faster. AArch64 always has NEON.
#if defined(__x86_64__)
#define MSCF_KERNEL __attribute__((target("avx2,fma")))
#else
#define MSCF_KERNEL
#endif
// into a kernel, whose instructions it is to have
#define MSCF_INLINE static inline __attribute__((always_inline))

namespace mscf {

constexpr int kLanes = 16;
constexpr int kTileRows = 6;  // with 16 lanes: what the registers of AVX2 and NEON hold
// GCC keeps a vector that is longer than a register in memory
#if defined(__x86_64__)
constexpr int kPart = 8;
#define MSCF_SHUFFLE(x, a, b, c, d) MSCF_SHUFFLE_8(x, a, b, c, d, 4 + a, 4 + b, 4 + c, 4 + d)
#else
constexpr int kPart = 4;
#define MSCF_SHUFFLE(x, a, b, c, d) MSCF_SHUFFLE_4(x, a, b, c, d)
#endif
constexpr int kParts = kLanes / kPart;
typedef float Part __attribute__((vector_size(kPart * sizeof(float))));
#if defined(__clang__)
#define MSCF_SHUFFLE_8(x, ...) __builtin_shufflevector(x, x, __VA_ARGS__)
#define MSCF_SHUFFLE_4(x, ...) __builtin_shufflevector(x, x, __VA_ARGS__)
#else
typedef int PartIndex __attribute__((vector_size(kPart * sizeof(int))));
#define MSCF_SHUFFLE_8(x, ...) __builtin_shuffle(x, PartIndex{__VA_ARGS__})
#define MSCF_SHUFFLE_4(x, ...) __builtin_shuffle(x, PartIndex{__VA_ARGS__})
#endif

struct Lanes {
  Part part[kParts];
};

MSCF_INLINE Lanes load(const float* from) {
  Lanes x;
  for (int i = 0; i < kParts; ++i) std::memcpy(&x.part[i], from + i * kPart, sizeof x.part[i]);
  return x;
}
MSCF_INLINE void store(float* to, const Lanes& x) {
  for (int i = 0; i < kParts; ++i) std::memcpy(to + i * kPart, &x.part[i], sizeof x.part[i]);
}
MSCF_INLINE Lanes all(float value) {
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = Part{} + value;
  return x;
}
MSCF_INLINE Lanes operator+(const Lanes& a, const Lanes& b) {
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = a.part[i] + b.part[i];
  return x;
}
MSCF_INLINE Lanes operator-(const Lanes& a, const Lanes& b) {
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = a.part[i] - b.part[i];
  return x;
}
MSCF_INLINE Lanes operator*(const Lanes& a, const Lanes& b) {
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = a.part[i] * b.part[i];
  return x;
}
MSCF_INLINE Lanes operator*(float a, const Lanes& b) {
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = a * b.part[i];
  return x;
}
MSCF_INLINE Lanes lesser(const Lanes& a, const Lanes& b) {
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = a.part[i] < b.part[i] ? a.part[i] : b.part[i];
  return x;
}

// Complex numbers are pairs (re, im) in neighbouring lanes.
MSCF_INLINE Lanes swapped(const Lanes& a) {  // (im, re)
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = MSCF_SHUFFLE(a.part[i], 1, 0, 3, 2);
  return x;
}
MSCF_INLINE Lanes real_parts(const Lanes& a) {  // (re, re)
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = MSCF_SHUFFLE(a.part[i], 0, 0, 2, 2);
  return x;
}
MSCF_INLINE Lanes imaginary_parts(const Lanes& a) {  // (im, im)
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = MSCF_SHUFFLE(a.part[i], 1, 1, 3, 3);
  return x;
}
MSCF_INLINE Lanes conjugate(const Lanes& a) {  // (re, -im)
  Part sign;
  for (int i = 0; i < kPart; ++i) sign[i] = i % 2 == 0 ? 1 : -1;
  Lanes x;
  for (int i = 0; i < kParts; ++i) x.part[i] = a.part[i] * sign;
  return x;
}

// Where the tile of a row begins that would begin at j: the last one reaches back over the one before.
MSCF_INLINE int tile_at(int j, int width) { return j + kLanes <= width ? j : width - kLanes; }

// Bins r and -r of a DFT over rows, c - i s and c + i s, of its cosine and sine part at r, `width` floats each.
MSCF_INLINE void unfold_row(const float* cosine, const float* sine, int width, float* one, float* other) {
  for (int j = 0; j < width; j += kLanes) {
    const int k = tile_at(j, width);
    const Lanes c = load(cosine + k), s = conjugate(swapped(load(sine + k)));
    store(other + k, c - s);
    store(one + k, c + s);
  }
}

// c (ROWS, 16) = a (ROWS, depth) b (depth, 16)
template <int ROWS>
MSCF_INLINE void multiply_tile(const float* a, ptrdiff_t a_stride, const float* b, ptrdiff_t b_stride, float* c,
                               ptrdiff_t c_stride, int depth) {
  Part sum[ROWS][kParts];
  for (int r = 0; r < ROWS; ++r)
    for (int i = 0; i < kParts; ++i) sum[r][i] = Part{};
  for (int k = 0; k < depth; ++k) {
    const Lanes row = load(b + k * b_stride);
    for (int r = 0; r < ROWS; ++r)
      for (int i = 0; i < kParts; ++i) sum[r][i] += a[r * a_stride + k] * row.part[i];
  }
  for (int r = 0; r < ROWS; ++r)
    for (int i = 0; i < kParts; ++i) std::memcpy(c + r * c_stride + i * kPart, &sum[r][i], sizeof sum[r][i]);
}

// c (rows, cols) = a (rows, depth) b (depth, cols), all row by row. The last tile reaches back over the one before.
MSCF_INLINE void multiply(const float* a, ptrdiff_t a_stride, const float* b, ptrdiff_t b_stride, float* c,
                          ptrdiff_t c_stride, int rows, int depth, int cols) {
  if (cols < kLanes) {
    for (int r = 0; r < rows; ++r)
      for (int j = 0; j < cols; ++j) {
        float sum = 0;
        for (int k = 0; k < depth; ++k) sum += a[r * a_stride + k] * b[k * b_stride + j];
        c[r * c_stride + j] = sum;
      }
    return;
  }
  const int tiles = (rows + kTileRows - 1) / kTileRows;
  for (int j = 0; j < cols; j += kLanes) {
    const int col = tile_at(j, cols);
    for (int tile = 0, r = 0; tile < tiles; ++tile) {
      const int height = (rows - r) / (tiles - tile);  // about the same for all: a low one wastes time
      const float* from = a + r * a_stride;
      float* to = c + r * c_stride + col;
      switch (height) {
        case 6: multiply_tile<6>(from, a_stride, b + col, b_stride, to, c_stride, depth); break;
        case 5: multiply_tile<5>(from, a_stride, b + col, b_stride, to, c_stride, depth); break;
        case 4: multiply_tile<4>(from, a_stride, b + col, b_stride, to, c_stride, depth); break;
        case 3: multiply_tile<3>(from, a_stride, b + col, b_stride, to, c_stride, depth); break;
        case 2: multiply_tile<2>(from, a_stride, b + col, b_stride, to, c_stride, depth); break;
        default: multiply_tile<1>(from, a_stride, b + col, b_stride, to, c_stride, depth);
      }
      r += height;
    }
  }
}

}  // namespace mscf
