// A live session for programs that speak neither gRPC nor C++: JSON lines for what is said, PC2 files for the frames
// (docs/cli.md has the lines). deploy/blender is such a program.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "common/client/cpp/client.hpp"
#include "common/frame/frame.hpp"
#include "common/mesh/subdivision.hpp"

namespace pleat::cli {

/// Writes samples of a PC2 file in any order that begins with sample 0. The header counts what is written.
class Pc2Samples {
 public:
  /// `first` 0 begins the file anew; else it must be one of `vertices` with at least `first` samples, of which those
  /// behind are given up. Throws kAlreadyExists (another file is there), kInvalidArgument, kResourceExhausted.
  Pc2Samples(const std::filesystem::path& path, std::size_t vertices, std::uint64_t first);
  /// The next sample, 3 floats a vertex.
  void add(const std::vector<float>& positions);
  /// Everything that was added can be read.
  void flush();

 private:
  std::FILE* file() const { return file_.get(); }
  void check(bool good) const;

  std::filesystem::path path_;
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_;
  std::size_t vertices_;
  std::uint64_t samples_;
};

struct BridgeOptions {
  std::string model;
  v1::Detail detail = v1::DETAIL_FOLD;
};

/// One session after the other on one coordinator. Not thread-safe.
class Bridge {
 public:
  using Say = std::function<void(const nlohmann::json&)>;
  /// Asked between frames; true ends the work at hand.
  using Stop = std::function<bool()>;

  Bridge(const client::Client& client, BridgeOptions options) : client_(client), options_(std::move(options)) {}

  /// Answers one request, "open" or "enhance", through `say`. Throws kInvalidArgument (the request), kCancelled
  /// (`stop`), and as sessions and files do; the bridge goes on, and begins anew with the next frame.
  void answer(const nlohmann::json& request, const Say& say, const Stop& stop);

 private:
  struct Obstacle {
    Topology open;  ///< as its file has it: what moved positions are of
    ObstacleShape shape;
    Positions rest;
  };

  void open(const nlohmann::json& request, const Say& say);
  void enhance(const nlohmann::json& request, const Say& say, const Stop& stop);
  void begin_session();

  const client::Client& client_;
  BridgeOptions options_;
  Topology rest_;
  std::string rest_name_;
  std::map<std::string, Obstacle> obstacles_;
  client::EnhanceOptions session_options_;
  std::optional<Subdivision> subdivision_;
  std::optional<client::EnhanceSession> session_;
  std::uint64_t next_index_ = 0;
};

}  // namespace pleat::cli
