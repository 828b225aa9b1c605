// Memory that a kernel of one thread keeps from call to call.
#pragma once

#include <cstddef>
#include <memory>

namespace mscf {

template <class T>
class Scratch {
 public:
  // At least `size` elements, of no particular value; grows and never shrinks.
  T* take(size_t size) {
    if (size > size_) {
      data_.reset(new T[size]);
      size_ = size;
    }
    return data_.get();
  }

 private:
  std::unique_ptr<T[]> data_;
  size_t size_ = 0;
};

}  // namespace mscf
