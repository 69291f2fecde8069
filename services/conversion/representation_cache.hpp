// Representations that sessions share.
#pragma once

#include <cstdint>
#include <functional>
#include <future>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "services/conversion/representation.hpp"

namespace pleat::conversion {

/// Both directions of a session, its reconnections and other sessions of the same garment ask for the same maps:
/// they are built once. Thread-safe.
class RepresentationCache {
 public:
  using Build = std::function<std::shared_ptr<const Representation>()>;

  /// budget: sum of the sizes of those kept; the ones that were not asked for longest go first. Those in use live on
  /// with their sessions.
  explicit RepresentationCache(std::size_t budget) : budget_(budget) {}

  /// The representation of this key, built if they are not there. A second caller of the same key waits for the first.
  /// What `build` throws reaches all who wait, and is not kept. was_there: may be null.
  std::shared_ptr<const Representation> get(const std::string& key, const Build& build, bool* was_there = nullptr);

 private:
  struct Entry {
    std::string key;
    std::shared_future<std::shared_ptr<const Representation>> maps;
    std::size_t size;  // 0 while it is being built
  };

  std::size_t budget_;
  std::mutex mutex_;
  std::list<Entry> entries_;  // the last one asked for first
};

}  // namespace pleat::conversion
