// Memory that threads take turns with.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

namespace pleat {

/// Values that are kept between calls, so that a call takes no memory once it has run. Thread-safe.
template <typename T>
class Pool {
 public:
  /// A value for one call; it goes back at the end.
  class Lent {
   public:
    explicit Lent(Pool& pool) : pool_(pool), value_(pool.take()) {}
    ~Lent() { pool_.give_back(std::move(value_)); }
    Lent(const Lent&) = delete;
    Lent& operator=(const Lent&) = delete;
    T& operator*() const { return *value_; }
    T* operator->() const { return value_.get(); }

   private:
    Pool& pool_;
    std::unique_ptr<T> value_;
  };

 private:
  std::unique_ptr<T> take() {
    const std::lock_guard lock(mutex_);
    if (free_.empty()) return std::make_unique<T>();
    std::unique_ptr<T> value = std::move(free_.back());
    free_.pop_back();
    return value;
  }
  void give_back(std::unique_ptr<T> value) {
    const std::lock_guard lock(mutex_);
    free_.push_back(std::move(value));
  }

  std::mutex mutex_;
  std::vector<std::unique_ptr<T>> free_;
};

}  // namespace pleat
