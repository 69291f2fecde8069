#include "services/cli/launcher/liveness.hpp"

#include <algorithm>

#include "common/rpc/channel.hpp"

namespace pleat::cli {
namespace {

constexpr std::chrono::seconds kInterval{1};
constexpr std::chrono::milliseconds kAnswerTime{2000};

}  // namespace

Liveness::Liveness(Duration patience) : patience_(patience), thread_([this] { run(); }) {}

Liveness::~Liveness() {
  {
    const std::lock_guard lock(mutex_);
    over_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void Liveness::watch(const std::string& key, const std::string& service, const std::string& address, Duration start) {
  auto channel = rpc::create_channel(address);
  const std::lock_guard lock(mutex_);
  watched_[key] = {service, std::move(channel), Clock::now() + start};
}

void Liveness::forget(const std::string& key) {
  const std::lock_guard lock(mutex_);
  watched_.erase(key);
}

bool Liveness::hangs(const std::string& key) const {
  const std::lock_guard lock(mutex_);
  const auto found = watched_.find(key);
  return found != watched_.end() && Clock::now() >= found->second.deadline;
}

void Liveness::run() {
  std::unique_lock lock(mutex_);
  while (!changed_.wait_for(lock, std::min<Duration>(kInterval, patience_ / 4), [this] { return over_; })) {
    const auto round = watched_;
    for (const auto& [key, asked] : round) {
      if (over_) return;
      lock.unlock();
      const bool answered = rpc::is_healthy(asked.channel, asked.service, std::min(kAnswerTime, patience_));
      lock.lock();
      const auto found = watched_.find(key);
      // It may have been replaced meanwhile.
      if (answered && found != watched_.end() && found->second.channel == asked.channel) {
        found->second.deadline = Clock::now() + patience_;
      }
    }
  }
}

}  // namespace pleat::cli
