// The result of a job, result.h5 (docs/file-formats.md). Crash safety as in dataset.hpp.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/store/dataset.hpp"

namespace pleat {

struct ResultOptions {
  MeshPair topology;
  std::uint64_t frames = 0;  ///< planned, at least 1; a cancelled job may finish with fewer
  double frame_time_s = 0;
  std::string model;                            ///< the bundle's name, or how the frames were enhanced
  std::string scene;                            ///< JSON; empty for frames made elsewhere
  bool has_fine = false;                        ///< a simulated fine reference is stored too
  std::vector<ObstacleShape> obstacles;         ///< a shape without faces is a sphere
  std::vector<Eigen::Index> obstacle_vertices;  ///< per obstacle; 0 unless a mesh
  std::vector<std::string> stages;              ///< /stages/<name>/ms
  std::vector<std::string> counts;              ///< /counts/<name>, for example penetrations, self_intersections
  bool deflate = false;                         ///< compress (shuffle + deflate 1) in finish, never while recording
};

struct ResultFrame {
  double time_s = 0;
  Positions coarse;                      ///< (V_coarse x 3)
  Positions enhanced;                    ///< (V_fine x 3)
  Positions fine;                        ///< (V_fine x 3) if has_fine
  std::vector<ObstacleFrame> obstacles;  ///< in the order of ResultOptions::obstacles
  std::vector<float> stages_ms;          ///< in the order of ResultOptions::stages
  std::vector<std::uint32_t> counts;     ///< in the order of ResultOptions::counts
};

/// Records PATH through PATH.partial. Not thread-safe.
class ResultWriter {
 public:
  /// resume: continue PATH.partial if it was made with equal options; otherwise it is replaced.
  ResultWriter(const std::filesystem::path& path, const ResultOptions& options, bool resume = false);
  ~ResultWriter();
  ResultWriter(ResultWriter&&) noexcept;
  ResultWriter& operator=(ResultWriter&&) noexcept;

  std::uint64_t frames_complete() const;

  /// Appends and flushes one frame. Errors as SequenceWriter::append.
  void append(const ResultFrame& frame);

  /// Cuts the arrays to the complete frames, closes, and renames .partial to its final name.
  void finish();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Reads a result, finished or .partial. Errors as DatasetReader. Thread-safe.
class ResultReader {
 public:
  explicit ResultReader(const std::filesystem::path& path, FileOrigin origin = FileOrigin::kElsewhere);
  ~ResultReader();

  /// What the file was made with; `frames` is the number of complete frames.
  const ResultOptions& info() const;
  std::uint64_t frames_complete() const { return info().frames; }

  std::vector<Positions> coarse(std::uint64_t first, std::uint64_t last) const;
  std::vector<Positions> enhanced(std::uint64_t first, std::uint64_t last) const;
  std::vector<Positions> fine(std::uint64_t first, std::uint64_t last) const;  ///< kFailedPrecondition without has_fine
  std::vector<double> times(std::uint64_t first, std::uint64_t last) const;
  std::vector<std::vector<ObstacleFrame>> obstacles(std::uint64_t first, std::uint64_t last) const;
  std::vector<float> stage_ms(const std::string& stage, std::uint64_t first, std::uint64_t last) const;
  std::vector<std::uint32_t> counts(const std::string& name, std::uint64_t first, std::uint64_t last) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace pleat
