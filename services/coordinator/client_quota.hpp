// How much of something all clients may have at the same time, and how much each of them.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::coordinator {

/// Not thread-safe.
class ClientQuota {
 public:
  /// what: for messages, "live sessions". each: 0 is as many as all may have together.
  ClientQuota(std::string what, std::size_t all, std::size_t each)
      : what_(std::move(what)), all_(all), each_(each == 0 ? all : each) {}

  /// Throws kResourceExhausted, naming the limit, if there is no room for one more of this client's.
  void enter(const std::string& client) {
    if (total_ >= all_) throw_full("there are " + std::to_string(total_) + " " + what_ + " already");
    const auto found = of_client_.find(client);
    if (found != of_client_.end() && found->second >= each_) {
      throw_full(client + " has " + std::to_string(found->second) + " " + what_ + " already");
    }
    ++of_client_[client];
    ++total_;
  }
  void leave(const std::string& client) {
    --total_;
    if (--of_client_[client] == 0) of_client_.erase(client);
  }

 private:
  [[noreturn]] static void throw_full(const std::string& message) {
    throw Error(ErrorCode::kResourceExhausted, message);
  }

  std::string what_;
  std::size_t all_, each_, total_ = 0;
  std::map<std::string, std::size_t> of_client_;
};

}  // namespace pleat::coordinator
