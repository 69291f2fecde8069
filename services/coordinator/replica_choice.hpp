// Where a session goes that stays in one replica.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "services/coordinator/replica_directory.hpp"

namespace pleat::coordinator {

/// First the replica with the fewest sessions of this coordinator, then, while they fail, the others in that order: a
/// replica that is down has the fewest of all, and must not be tried for ever. Not thread-safe.
class ReplicaChoice {
 public:
  /// turn: which one comes first among equals.
  explicit ReplicaChoice(std::shared_ptr<ReplicaDirectory> directory, std::size_t turn)
      : directory_(std::move(directory)), turn_(turn) {}

  /// The next one to try, of `known`, which must not be empty.
  const std::string& next(const std::vector<std::string>& known) {
    std::erase_if(order_, [&](const auto& each) { return std::count(known.begin(), known.end(), each) == 0; });
    if (order_.empty()) order_ = in_order(known);
    current_ = std::move(order_.front());
    order_.erase(order_.begin());
    return current_;
  }

  /// The current one did its work for a while: when it fails, the others are looked at anew.
  void served() { order_.clear(); }

 private:
  std::vector<std::string> in_order(const std::vector<std::string>& known) const {
    std::vector<std::pair<int, std::string>> by_sessions;
    for (std::size_t k = 0; k < known.size(); ++k) {
      const std::string& address = known[(turn_ + k) % known.size()];
      by_sessions.emplace_back(directory_ ? directory_->load_of(address)->sessions.load() : 0, address);
    }
    std::stable_sort(by_sessions.begin(), by_sessions.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    std::vector<std::string> order;
    for (auto& [sessions, address] : by_sessions) order.push_back(std::move(address));
    // Who has just failed comes last.
    const auto failed = std::find(order.begin(), order.end(), current_);
    if (failed != order.end()) std::rotate(failed, failed + 1, order.end());
    return order;
  }

  const std::shared_ptr<ReplicaDirectory> directory_;
  const std::size_t turn_;
  std::vector<std::string> order_;
  std::string current_;
};

}  // namespace pleat::coordinator
