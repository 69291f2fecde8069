// The services behind the coordinator as small in-process servers over Unix sockets: real streams, simple
// arithmetic, and faults on demand.
#pragma once

#include <grpcpp/grpcpp.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "common/mesh/subdivision.hpp"
#include "pleat/v1/common.pb.h"
#include "pleat/v1/scene.pb.h"
#include "pleat/v1/superres.pb.h"
#include "tests/support/temporary_folder.hpp"

namespace pleat::testing {

/// What a fake does wrong, by frame index. Thread-safe.
class Faults {
 public:
  enum class Kind {
    kNone,
    kBreak,       ///< the stream ends with UNAVAILABLE instead of an answer
    kHang,        ///< no answer until the client gives up
    kFrameError,  ///< a FrameError
    kWrongIndex,  ///< an answer for a frame that was not sent
    kWrongSize,   ///< an answer with too few vertices
  };

  /// `times` times, for whoever asks for this index.
  void at(std::uint64_t index, Kind kind, int times = 1);
  /// Refuses this many `open` messages with the status.
  void refuse(grpc::Status status, int times);
  /// Frames from this one on wait for release(), or until the client gives up: a job cannot end meanwhile.
  void hold(std::uint64_t index) { held_from_ = index; }
  void release() { held_from_ = std::numeric_limits<std::uint64_t>::max(); }
  /// Every answer takes this long.
  void delay(std::chrono::milliseconds time) { delay_ms_ = time.count(); }

  Kind next(std::uint64_t index);
  grpc::Status next_open();
  bool holds(std::uint64_t index) const { return index >= held_from_; }
  std::chrono::milliseconds delay() const { return std::chrono::milliseconds(delay_ms_.load()); }

 private:
  std::mutex mutex_;
  std::map<std::uint64_t, std::pair<Kind, int>> at_;
  grpc::Status refusal_;
  int refusals_ = 0;
  std::atomic<std::int64_t> delay_ms_{0};
  std::atomic<std::uint64_t> held_from_{std::numeric_limits<std::uint64_t>::max()};
};

/// What the super-resolution services say of their bundle. Thread-safe.
class FakeBundle {
 public:
  FakeBundle();
  v1::ModelDescription describe() const;
  /// For streams that are opened from now on.
  void replace(const std::function<void(v1::ModelDescription&)>& change);

 private:
  mutable std::mutex mutex_;
  v1::ModelDescription description_;
};

/// One fake service: it can be stopped and started again at its address, as after a kill.
class FakeService {
 public:
  virtual ~FakeService() = default;

  Faults faults;
  std::atomic<int> sessions{0};  ///< open streams
  std::atomic<int> frames{0};    ///< answered, by all streams
  std::atomic<int> opened{0};    ///< streams ever opened
  std::atomic<int> parts{0};     ///< of animations, taken by all streams

  const std::string& address() const { return address_; }
  void start();
  /// Cancels every call, as if the process were gone.
  void stop();

 protected:
  explicit FakeService(std::string address) : address_(std::move(address)) {}
  virtual std::vector<grpc::Service*> services() = 0;

 private:
  std::string address_;
  std::unique_ptr<grpc::Server> server_;
};

/// All of them, started. Numbered sockets allow for replicas.
class FakeStages {
 public:
  FakeStages();
  ~FakeStages();

  FakeService& simulation() { return *simulation_; }
  FakeService& conversion() { return *conversion_; }
  FakeService& superres() { return *superres_; }
  FakeService& refinement() { return *refinement_; }
  FakeService& fold() { return *fold_; }
  /// One more super-resolution service, started.
  FakeService& add_superres();
  /// One more fold service, started.
  FakeService& add_fold();
  /// Of all super-resolution services.
  FakeBundle& bundle() { return bundle_; }
  std::vector<FakeService*> all();
  const std::filesystem::path& folder() const { return folder_.path(); }

 private:
  test::TemporaryFolder folder_;
  FakeBundle bundle_;
  std::unique_ptr<FakeService> simulation_, conversion_, superres_, refinement_, fold_;
  std::vector<std::unique_ptr<FakeService>> more_;
};

/// A sheet of (columns + 1) x (rows + 1) vertices with material coordinates.
Topology sheet(int columns = 4, int rows = 3);
v1::Topology to_wire(const Topology& topology);
/// A scene that the fake simulation understands: the sheet and one sphere.
v1::Scene fake_scene(std::uint32_t frames, const std::string& name = "fake");

/// Frame k of the fake simulation, with velocities.
v1::Frame fake_coarse_frame(const Topology& coarse, std::uint64_t index, double frame_time_s = 0.04);
/// What the fake fold step makes of a coarse frame alone: upsampled, and more by a constant for every frame since the
/// cloth began anew. since: frames since then, 1 for the first.
Positions fake_folded(const Subdivision& subdivision, const Faces& coarse_faces, const v1::Frame& coarse,
                      std::uint64_t since, bool refined = true);
/// What the fake stages make of a coarse frame. earlier: the window before it, the oldest first.
Positions fake_enhanced(const Subdivision& subdivision, const Faces& coarse_faces, const v1::Frame& coarse,
                        bool refined = true, const std::vector<v1::Frame>& earlier = {});

}  // namespace pleat::testing
