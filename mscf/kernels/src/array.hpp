// Arrays as they come from Python: what is not of the expected dtype, shape and layout is refused by name.
#pragma once

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <unistd.h>

#include <cstdint>
#include <cstring>
#include <initializer_list>

namespace mscf {

struct Refused {};  // a Python exception has been set

constexpr Py_ssize_t kAny = -1;
constexpr Py_ssize_t kMost = Py_ssize_t(1) << 27;  // elements of an array: sizes are counted with 32 bits

template <class T>
struct Kind;
template <>
struct Kind<float> {
  static constexpr const char *format = "f", *name = "float32";
};
template <>
struct Kind<double> {
  static constexpr const char *format = "d", *name = "float64";
};
template <>
struct Kind<uint8_t> {
  static constexpr const char *format = "B", *name = "uint8";
};
struct Complex {
  float re, im;
};
template <>
struct Kind<Complex> {
  static constexpr const char *format = "Zf", *name = "complex64";
};

enum class Access {
  kRead,     // contiguous
  kWritten,  // contiguous, to be written to
  kStrided,  // read, however it lies in memory
};

// A buffer that is held for as long as this lives.
template <class T>
class Array {
 public:
  // `shape`: the length of each axis, or kAny.
  Array(PyObject* from, const char* name, std::initializer_list<Py_ssize_t> shape, Access access = Access::kRead) {
    const int layout = access == Access::kStrided ? PyBUF_STRIDES : PyBUF_C_CONTIGUOUS;
    const int written = access == Access::kWritten ? PyBUF_WRITABLE : 0;
    if (PyObject_GetBuffer(from, &view_, layout | PyBUF_FORMAT | written) != 0) {
      PyErr_Clear();
      PyErr_Format(PyExc_ValueError, "%s must be %s array of %s", name,
                   access == Access::kRead      ? "a contiguous"
                   : access == Access::kWritten ? "a writable contiguous"
                                                : "an",
                   Kind<T>::name);
      throw Refused{};
    }
    if (!is_right(shape)) {
      refuse(name, shape);
      PyBuffer_Release(&view_);
      throw Refused{};
    }
  }
  ~Array() { PyBuffer_Release(&view_); }
  Array(const Array&) = delete;
  Array& operator=(const Array&) = delete;

  T* data() const { return static_cast<T*>(view_.buf); }
  int size(int axis) const { return int(view_.shape[axis]); }
  Py_ssize_t stride(int axis) const { return view_.strides[axis]; }
  int axes() const { return view_.ndim; }

 private:
  bool is_right(std::initializer_list<Py_ssize_t> shape) const {
    if (std::strcmp(view_.format, Kind<T>::format) != 0 || view_.ndim != int(shape.size())) return false;
    int axis = 0;
    Py_ssize_t room = kMost;
    for (const Py_ssize_t length : shape) {
      const Py_ssize_t found = view_.shape[axis++];
      if (found < 1 || found > room || (length != kAny && found != length)) return false;
      room /= found;
    }
    return true;
  }

  void refuse(const char* name, std::initializer_list<Py_ssize_t> shape) const {
    char wanted[96] = "", found[96] = "";
    for (const Py_ssize_t length : shape) append(wanted, length);
    for (int axis = 0; axis < view_.ndim && axis < 6; ++axis) append(found, view_.shape[axis]);
    PyErr_Format(PyExc_ValueError, "%s must be %s of shape (%s), 1 to %zd elements, got format '%s' and shape (%s)", name,
                 Kind<T>::name, wanted, kMost, view_.format, found);
  }

  static void append(char (&text)[96], Py_ssize_t length) {
    char* end = text + std::strlen(text);
    const size_t room = size_t(text + sizeof text - end);
    const char* comma = end == text ? "" : ", ";
    if (length == kAny)
      PyOS_snprintf(end, room, "%sany", comma);
    else
      PyOS_snprintf(end, room, "%s%lld", comma, static_cast<long long>(length));
  }

  Py_buffer view_;
};

// Numbers that fit together: `text` says how.
inline void require(bool is_so, const char* text) {
  if (is_so) return;
  PyErr_SetString(PyExc_ValueError, text);
  throw Refused{};
}

class WithoutGil {
 public:
  WithoutGil() : state_(PyEval_SaveThread()) {}
  // Python ends a daemon thread here, when it ends itself, by unwinding, which a destructor must not let through.
  ~WithoutGil() {
    try {
      PyEval_RestoreThread(state_);
    } catch (...) {
      for (;;) pause();
    }
  }
  WithoutGil(const WithoutGil&) = delete;
  WithoutGil& operator=(const WithoutGil&) = delete;

 private:
  PyThreadState* state_;
};

}  // namespace mscf
