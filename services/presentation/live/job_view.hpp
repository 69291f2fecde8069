// One job or live session as the live page sees it: its meshes, and its newest frame.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "common/client/cpp/client.hpp"

namespace pleat::presentation {

/// Follows a job as long as somebody asks for its frames. Only the newest one is held: whoever is slower than the job
/// leaves frames out. Thread-safe.
class JobView {
 public:
  using Milliseconds = std::chrono::milliseconds;

  /// patience: without a question for this long the watching ends at the next frame.
  JobView(const client::Client& client, const std::string& id, std::uint64_t from_index, Milliseconds patience);

  /// Packed: {"coarse_vertices", "fine_vertices", "obstacles": [{"name"}]}, arrays "coarse_faces", "fine_faces" and, of
  /// obstacles that are not spheres, "obstacle_faces_<i>". Waits for `timeout` at most; nothing: they are not known
  /// yet. Throws what ended the watching.
  std::optional<std::string> meshes(Milliseconds timeout);

  struct News {
    std::optional<std::string> frame;  ///< packed, see pack_frame()
    bool over = false;                 ///< the job has ended, and there is no newer frame
  };
  /// The newest frame, if its index is above `after`; waits for it for `timeout` at most. Throws what ended the
  /// watching.
  News newer_than(std::int64_t after, Milliseconds timeout);

  /// Whether the watching has ended before the job.
  bool has_failed() const;
  /// Ends all waiting.
  void stop();

 private:
  using Clock = std::chrono::steady_clock;
  void opened(const client::JobMeshes& meshes);
  void show(const client::EnhancedFrame& frame);
  /// Waits until `known` says so, the watching is over, or the time is.
  template <typename Known>
  void wait(std::unique_lock<std::mutex>& lock, Milliseconds timeout, const Known& known);

  const Milliseconds patience_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  Clock::time_point asked_ = Clock::now();
  bool stopping_ = false;
  std::shared_ptr<const client::JobMeshes> meshes_;
  std::shared_ptr<const client::EnhancedFrame> newest_;
  client::JobWatcher watcher_;  ///< last: its thread calls us
};

/// {"index", "time_s", "stages": [{"name", "ms"}], "penetrations", "self_intersections", "error", "obstacles":
/// [{"center", "radius"} or {}]}, arrays "coarse", "fine" and "obstacle_<i>", positions of what is no sphere, in the
/// order of `meshes.obstacles`. An array that is missing is that of the frame before.
std::string pack_frame(const client::EnhancedFrame& frame, const client::JobMeshes& meshes);
std::string pack_meshes(const client::JobMeshes& meshes);

}  // namespace pleat::presentation
