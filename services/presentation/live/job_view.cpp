#include "services/presentation/live/job_view.hpp"

#include <algorithm>

#include "common/client/adapter/adapter.hpp"
#include "services/presentation/live/packed.hpp"
#include "services/presentation/report/capsule_surface.hpp"

namespace pleat::presentation {
namespace {

constexpr std::chrono::milliseconds kLookInterval{200};

template <typename Matrix>
auto values_of(const Matrix& rows) {
  return std::span(rows.data(), static_cast<std::size_t>(rows.size()));
}

}  // namespace

std::string pack_meshes(const client::JobMeshes& meshes) {
  Packed packed;
  packed.about = {{"coarse_vertices", meshes.coarse.vertex_count()},
                  {"fine_vertices", meshes.fine.vertex_count()},
                  {"obstacles", nlohmann::json::array()}};
  packed.add("coarse_faces", std::span<const std::uint32_t>(meshes.coarse.faces));
  packed.add("fine_faces", std::span<const std::uint32_t>(meshes.fine.faces));
  for (std::size_t i = 0; i < meshes.obstacles.size(); ++i) {
    const client::ObstacleShape& shape = meshes.obstacles[i];
    packed.about["obstacles"].push_back({{"name", shape.name}});
    const std::string name = "obstacle_faces_" + std::to_string(i);
    if (shape.capsules > 0) {
      const Faces faces = capsule_surface_faces(shape.capsules);
      packed.add(name, std::span<const std::uint32_t>(values_of(faces)));
    } else if (!shape.faces.empty()) {
      packed.add(name, std::span<const std::uint32_t>(shape.faces));
    }
  }
  return packed.bytes();
}

std::string pack_frame(const client::EnhancedFrame& frame, const client::JobMeshes& meshes) {
  Packed packed;
  packed.about = {{"index", frame.index},
                  {"time_s", frame.time_s},
                  {"penetrations", frame.report.penetrations_after},
                  {"self_intersections", frame.report.self_intersections_after},
                  {"stages", nlohmann::json::array()},
                  {"obstacles", nlohmann::json::array()},
                  {"error", frame.error ? frame.error->what() : ""}};
  for (const client::StageTime& stage : frame.stage_times) {
    packed.about["stages"].push_back({{"name", stage.stage}, {"ms", stage.ms}});
  }
  const auto add = [&packed](const std::string& name, const std::vector<float>& values) {
    if (!values.empty()) packed.add(name, std::span<const float>(values));
  };
  add("coarse", frame.coarse);
  add("fine", frame.positions);
  for (std::size_t i = 0; i < meshes.obstacles.size(); ++i) {
    nlohmann::json& about = packed.about["obstacles"].emplace_back(nlohmann::json::object());
    const auto found =
        std::find_if(frame.obstacles.begin(), frame.obstacles.end(),
                     [&](const client::ObstacleFrame& obstacle) { return obstacle.name == meshes.obstacles[i].name; });
    if (found == frame.obstacles.end()) continue;
    const std::string name = "obstacle_" + std::to_string(i);
    if (!found->capsule_radii.empty()) {
      const Positions surface = capsule_surface(client::to_obstacles({*found}).front());
      packed.add(name, std::span<const float>(values_of(surface)));
    } else if (found->radius > 0) {
      about = {{"center", found->center}, {"radius", found->radius}};
    } else {
      add(name, found->positions);
    }
  }
  return packed.bytes();
}

JobView::JobView(const client::Client& client, const std::string& id, std::uint64_t from_index, Milliseconds patience)
    : patience_(patience),
      watcher_(client.watch_job(id,
                                {.opened = [this](const client::JobMeshes& meshes) { opened(meshes); },
                                 .frame = [this](const client::EnhancedFrame& frame) { show(frame); }},
                                {.from_index = from_index})) {}

void JobView::opened(const client::JobMeshes& meshes) {
  auto copy = std::make_shared<const client::JobMeshes>(meshes);
  const std::lock_guard lock(mutex_);
  meshes_ = std::move(copy);
  changed_.notify_all();
}

void JobView::show(const client::EnhancedFrame& frame) {
  auto copy = std::make_shared<const client::EnhancedFrame>(frame);
  const std::lock_guard lock(mutex_);
  newest_ = std::move(copy);
  changed_.notify_all();
  if (Clock::now() - asked_ > patience_) throw Error(ErrorCode::kCancelled, "nobody looks at the job");
}

template <typename Known>
void JobView::wait(std::unique_lock<std::mutex>& lock, Milliseconds timeout, const Known& known) {
  const auto deadline = Clock::now() + timeout;
  while (!known() && !stopping_ && Clock::now() < deadline) {
    asked_ = Clock::now();
    if (changed_.wait_for(lock, std::min<Clock::duration>(kLookInterval, deadline - Clock::now()),
                          [&] { return known() || stopping_; })) {
      return;
    }
    lock.unlock();
    // Its own lock; throws what ended the watching. What came before its end is known by then.
    const bool over = watcher_.wait(Milliseconds(0)).over;
    lock.lock();
    if (over) return;
  }
}

std::optional<std::string> JobView::meshes(Milliseconds timeout) {
  std::unique_lock lock(mutex_);
  wait(lock, timeout, [this] { return meshes_ != nullptr; });
  const auto meshes = meshes_;
  lock.unlock();
  return meshes ? std::optional(pack_meshes(*meshes)) : std::nullopt;
}

JobView::News JobView::newer_than(std::int64_t after, Milliseconds timeout) {
  const auto is_new = [&] { return newest_ && static_cast<std::int64_t>(newest_->index) > after; };
  std::unique_lock lock(mutex_);
  asked_ = Clock::now();
  wait(lock, timeout, is_new);
  const bool found = is_new();
  const auto frame = newest_;
  const auto meshes = meshes_;
  lock.unlock();
  if (found) return {pack_frame(*frame, *meshes), false};
  return {std::nullopt, watcher_.wait(Milliseconds(0)).over};
}

bool JobView::has_failed() const {
  try {
    watcher_.wait(Milliseconds(0));
    return false;
  } catch (const Error&) {
    return true;
  }
}

void JobView::stop() {
  const std::lock_guard lock(mutex_);
  stopping_ = true;
  changed_.notify_all();
}

}  // namespace pleat::presentation
