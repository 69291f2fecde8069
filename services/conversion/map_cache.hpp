// Maps that sessions share.
#pragma once

#include <cstdint>
#include <functional>
#include <future>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "services/conversion/image_map.hpp"

namespace pleat::conversion {

/// What depends on the meshes and the image's size alone. Immutable.
struct SessionMaps {
  Topology fine;
  std::vector<std::uint32_t> feature_vertices;  ///< empty if the fine mesh is not a subdivision made here
  std::unique_ptr<ImageMap> map;

  /// Fine vertices and texels: what its memory is proportional to.
  std::size_t size() const;
};

/// Both directions of a session, its reconnections and other sessions of the same garment ask for the same maps: they
/// are built once. Thread-safe.
class MapCache {
 public:
  using Build = std::function<std::shared_ptr<const SessionMaps>()>;

  /// budget: sum of the sizes of the maps kept; the ones that were not asked for longest go first. Maps in use live on
  /// with their sessions.
  explicit MapCache(std::size_t budget) : budget_(budget) {}

  /// The maps of this key, built if they are not there. A second caller of the same key waits for the first. What
  /// `build` throws reaches all who wait, and is not kept. was_there: may be null.
  std::shared_ptr<const SessionMaps> get(const std::string& key, const Build& build, bool* was_there = nullptr);

 private:
  struct Entry {
    std::string key;
    std::shared_future<std::shared_ptr<const SessionMaps>> maps;
    std::size_t size;  // 0 while it is being built
  };

  std::size_t budget_;
  std::mutex mutex_;
  std::list<Entry> entries_;  // the last one asked for first
};

}  // namespace pleat::conversion
