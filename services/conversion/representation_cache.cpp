#include "services/conversion/representation_cache.hpp"

#include <algorithm>

namespace pleat::conversion {

std::shared_ptr<const Representation> RepresentationCache::get(const std::string& key, const Build& build,
                                                               bool* was_there) {
  std::promise<std::shared_ptr<const Representation>> promise;
  {
    std::unique_lock lock(mutex_);
    const auto found = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& e) { return e.key == key; });
    if (was_there != nullptr) *was_there = found != entries_.end();
    if (found != entries_.end()) {
      entries_.splice(entries_.begin(), entries_, found);
      const auto maps = found->maps;
      lock.unlock();
      return maps.get();
    }
    entries_.push_front({key, promise.get_future().share(), 0});
  }
  const auto entry_of_key = [&] {
    return std::find_if(entries_.begin(), entries_.end(), [&](const Entry& e) { return e.key == key; });
  };
  std::shared_ptr<const Representation> maps;
  try {
    maps = build();
  } catch (...) {
    promise.set_exception(std::current_exception());
    const std::lock_guard lock(mutex_);
    entries_.erase(entry_of_key());
    throw;
  }
  promise.set_value(maps);
  const std::lock_guard lock(mutex_);
  entry_of_key()->size = maps->size();
  std::size_t total = 0;
  for (auto entry = entries_.begin(); entry != entries_.end();) {
    total += entry->size;
    // Entries that are being built stay: their makers look for them.
    entry = entry->size > 0 && total > budget_ ? entries_.erase(entry) : std::next(entry);
  }
  return maps;
}

}  // namespace pleat::conversion
