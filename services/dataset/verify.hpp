// What is in a data set, and whether it keeps its promises.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace pleat::dataset {

/// What is in a data set: coarse and fine (vertices, faces, uv), frame_time_s, time_step_s, seed, git_revision,
/// normalization, unmerged (shards make it), splits (sequences, frames), sequences (name, split, frames,
/// frames_complete, finished), not_begun.
nlohmann::json describe(const std::filesystem::path& folder);
/// The same in lines for people.
std::vector<std::string> to_lines(const nlohmann::json& description);

struct VerifyOptions {
  std::uint64_t stride = 1;  ///< frames between two that are checked for intersections; the rest is checked everywhere
};

struct VerifyReport {
  std::vector<std::string> problems;  ///< empty: the data set is good
  bool unmerged = false;              ///< shards make it: what is finished was judged
  std::uint64_t pending = 0;          ///< unmerged: sequences that are not made yet
  std::uint64_t sequences = 0;
  std::uint64_t frames = 0;              ///< read
  std::uint64_t frames_judged = 0;       ///< checked for intersections
  std::uint64_t self_intersections = 0;  ///< pairs of faces, coarse and fine
  std::uint64_t penetrations = 0;        ///< faces, coarse and fine
  double feature_distance_mean_m = 0;    ///< between coarse vertices and the fine feature vertices
  double feature_distance_max_m = 0;
};

/// The members of the report under their names.
nlohmann::json to_json(const VerifyReport& report);

/// Checks every invariant: all planned sequences are finished, sizes and hashes agree, every value is finite, times are
/// equally spaced, feature vertices follow their coarse vertices (at most a fifth of the cloth's size away), frames are
/// free of self-intersections and penetrations, and the normalisation covers the training split. What can't be read is
/// a problem too, but of an unmerged set neither sequences to be made nor the normalisation; only a missing or
/// unreadable master file throws. `on_sequence` gets a line per sequence.
VerifyReport verify(const std::filesystem::path& folder, const VerifyOptions& options,
                    const std::function<void(const std::string&)>& on_sequence);

}  // namespace pleat::dataset
