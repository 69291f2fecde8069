#include "services/dataset/verify.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

#include "common/base/error.hpp"
#include "common/mesh/mesh.hpp"
#include "common/store/dataset.hpp"
#include "services/dataset/normalization.hpp"
#include "services/dataset/sequence.hpp"
#include "services/dataset/shard_folder.hpp"
#include "services/refinement/judge.hpp"

namespace pleat::dataset {
namespace {

constexpr std::size_t kMaxProblems = 50;

nlohmann::json mesh_json(const Topology& topology) {
  return {{"vertices", topology.vertex_count()}, {"faces", topology.face_count()}, {"hash", topology_hash(topology)}};
}

class Verifier {
 public:
  Verifier(const std::filesystem::path& folder, const VerifyOptions& options)
      : reader_(folder), options_(options), unmerged_(has_shards(folder)) {
    report_.unmerged = unmerged_;
  }

  VerifyReport run(const std::function<void(const std::string&)>& on_sequence) {
    check_master();
    std::map<std::string, SequenceInfo> present;
    try {
      for (SequenceInfo& info : reader_.sequences()) present[info.name] = std::move(info);
    } catch (const Error& error) {
      problem(error.what());
      return report_;
    }
    for (const std::string& name : reader_.master().sequences) {
      const auto found = present.find(name);
      if (found == present.end()) {
        if (!unmerged_) problem(name + ": not made yet");
        continue;
      }
      const std::size_t before = report_.problems.size();
      try {
        check_sequence(found->second);
      } catch (const Error& error) {
        problem(error.what());
      }
      ++report_.sequences;
      on_sequence(name + " (" + found->second.split + "): " + std::to_string(found->second.frames_complete) +
                  " frames, " + std::to_string(report_.problems.size() - before) + " problems");
    }
    if (distances_ > 0) report_.feature_distance_mean_m = distance_sum_ / static_cast<double>(distances_);
    if (unmerged_) {
      count_pending();
    } else {
      check_normalization();
    }
    return report_;
  }

 private:
  void problem(const std::string& text) {
    if (report_.problems.size() < kMaxProblems) report_.problems.push_back(text);
  }

  void count_pending() {
    for (const ShardSequence& sequence : read_shard_plan(reader_.folder()).sequences) {
      if (!is_settled(reader_.folder(), sequence)) ++report_.pending;
    }
  }

  void check_master() {
    const DatasetMaster& master = reader_.master();
    if (!(master.frame_time_s > 0) || !(master.time_step_s > 0)) problem("dataset.h5: times are not positive");
    if (master.sequences.empty()) problem("dataset.h5: no sequences");
    check_features("dataset.h5", reader_.topology());
  }

  void check_features(const std::string& where, const MeshPair& meshes) {
    for (std::size_t i = 0; i < meshes.feature_vertices.size(); ++i) {
      const auto fine = static_cast<Eigen::Index>(meshes.feature_vertices[i]);
      if (meshes.fine.rest_positions.row(fine) == meshes.coarse.rest_positions.row(static_cast<Eigen::Index>(i)))
        continue;
      problem(where + ": feature vertex " + std::to_string(i) + " is not its coarse vertex at rest");
      return;
    }
  }

  void check_sequence(const SequenceInfo& info) {
    if (!info.finished || info.frames_complete != info.frames) {
      problem(info.name + ": " + std::to_string(info.frames_complete) + " of " + std::to_string(info.frames) +
              " frames");
    }
    if (info.split != "train" && info.split != "test") problem(info.name + ": split is '" + info.split + "'");
    const std::shared_ptr<const MeshPair> own = reader_.meshes(info.name);
    const MeshPair& meshes = *own;
    if (info.topology_hash != topology_hash(meshes.fine)) {
      problem(info.name + ": made for mesh " + info.topology_hash);
      return;
    }
    if (info.own_meshes) check_features(info.name, meshes);
    const Eigen::RowVector3f size = meshes.coarse.rest_positions.colwise().maxCoeff().array() -
                                    meshes.coarse.rest_positions.colwise().minCoeff().array();
    const double limit = 0.2 * static_cast<double>(size.norm());
    for (std::uint64_t k = 0; k < info.frames_complete; ++k) {
      const std::string where = info.name + ", frame " + std::to_string(k);
      const Positions coarse = reader_.coarse(info.name, k, k + 1).front();
      const Positions fine = reader_.fine(info.name, k, k + 1).front();
      const double time = reader_.times(info.name, k, k + 1).front();
      ++report_.frames;
      if (std::abs(time - static_cast<double>(k) * reader_.master().frame_time_s) > 1e-6) {
        problem(where + ": time " + std::to_string(time));
      }
      if (!coarse.allFinite() || !fine.allFinite()) {
        problem(where + ": a position is not finite");
        continue;
      }
      double largest = 0;
      for (std::size_t i = 0; i < meshes.feature_vertices.size(); ++i) {
        const double distance =
            (fine.row(static_cast<Eigen::Index>(meshes.feature_vertices[i])) - coarse.row(static_cast<Eigen::Index>(i)))
                .norm();
        largest = std::max(largest, distance);
        distance_sum_ += distance;
        ++distances_;
      }
      report_.feature_distance_max_m = std::max(report_.feature_distance_max_m, largest);
      if (reader_.master().tracked && largest > limit)
        problem(where + ": a feature vertex is " + std::to_string(largest) + " m off");
      if (k % options_.stride == 0) judge(info, meshes, k, where, coarse, fine);
    }
  }

  void judge(const SequenceInfo& info, const MeshPair& meshes, std::uint64_t k, const std::string& where,
             const Positions& coarse, const Positions& fine) {
    ++report_.frames_judged;
    const std::vector<ObstacleFrame> obstacles = reader_.obstacles(info.name, k, k + 1).front();
    const auto count = [&](const char* which, const Positions& positions, const Faces& faces) {
      const std::size_t crossings = refinement::count_self_intersections(positions, faces);
      const std::size_t inside = refinement::count_penetrations(positions, faces, info.obstacles, obstacles);
      report_.self_intersections += crossings;
      report_.penetrations += inside;
      if (crossings > 0)
        problem(where + ": " + which + " mesh has " + std::to_string(crossings) + " self-intersections");
      if (inside > 0) problem(where + ": " + which + " mesh has " + std::to_string(inside) + " penetrations");
    };
    count("coarse", coarse, meshes.coarse.faces);
    count("fine", fine, meshes.fine.faces);
  }

  void check_normalization() {
    const auto& normalization = reader_.master().normalization;
    if (!normalization) {
      problem("dataset.h5: no normalisation");
      return;
    }
    if (report_.frames == 0) return;
    try {
      const ChannelRanges range = measure_range(reader_, 0);
      for (std::size_t c = 0; c < range.channels(); ++c) {
        if (range.offset[c] < normalization->offset[c] ||
            range.offset[c] + range.scale[c] > normalization->offset[c] + normalization->scale[c]) {
          problem("dataset.h5: the normalisation does not cover channel " + std::to_string(c) +
                  " of the training split");
        }
      }
    } catch (const Error& error) {
      problem(error.what());
    }
  }

  DatasetReader reader_;
  VerifyOptions options_;
  bool unmerged_;
  VerifyReport report_;
  double distance_sum_ = 0;
  std::uint64_t distances_ = 0;
};

}  // namespace

nlohmann::json describe(const std::filesystem::path& folder) {
  const DatasetReader reader(folder);
  const DatasetMaster& master = reader.master();
  nlohmann::json description = {{"coarse", mesh_json(master.topology.coarse)},
                                {"fine", mesh_json(master.topology.fine)},
                                {"frame_time_s", master.frame_time_s},
                                {"time_step_s", master.time_step_s},
                                {"seed", master.seed},
                                {"git_revision", master.git_revision},
                                {"normalization", master.normalization.has_value()},
                                {"unmerged", has_shards(folder)},
                                {"splits", nlohmann::json::object()},
                                {"sequences", nlohmann::json::array()}};
  std::map<std::string, std::pair<std::uint64_t, std::uint64_t>> splits;
  const std::vector<SequenceInfo> sequences = reader.sequences();
  for (const SequenceInfo& info : sequences) {
    ++splits[info.split].first;
    splits[info.split].second += info.frames_complete;
    description["sequences"].push_back({{"name", info.name},
                                        {"split", info.split},
                                        {"frames", info.frames},
                                        {"frames_complete", info.frames_complete},
                                        {"finished", info.finished}});
    if (!info.own_meshes) continue;
    const std::shared_ptr<const MeshPair> meshes = reader.meshes(info.name);
    description["sequences"].back()["coarse"] = mesh_json(meshes->coarse);
    description["sequences"].back()["fine"] = mesh_json(meshes->fine);
  }
  for (const auto& [split, counts] : splits)
    description["splits"][split] = {{"sequences", counts.first}, {"frames", counts.second}};
  description["not_begun"] = master.sequences.size() - sequences.size();
  description["dropped"] = nlohmann::json::object();
  for (const auto& [name, reason] : dropped_sequences(folder)) description["dropped"][name] = reason;
  return description;
}

std::vector<std::string> to_lines(const nlohmann::json& description) {
  const auto number = [](const nlohmann::json& value) { return std::to_string(value.get<std::uint64_t>()); };
  std::vector<std::string> lines;
  for (const char* name : {"coarse", "fine"}) {
    const nlohmann::json& mesh = description.at(name);
    lines.push_back(std::string(name) + " mesh: " + number(mesh.at("vertices")) + " vertices, " +
                    number(mesh.at("faces")) + " faces, hash " + mesh.at("hash").get<std::string>());
  }
  lines.push_back("frame time " + std::to_string(description.at("frame_time_s").get<double>()) + " s, time step " +
                  std::to_string(description.at("time_step_s").get<double>()) + " s");
  lines.push_back("seed " + number(description.at("seed")) + ", git revision " +
                  description.at("git_revision").get<std::string>());
  lines.push_back(std::string("normalisation ") + (description.at("normalization") ? "present" : "absent"));
  if (description.at("unmerged")) lines.emplace_back("made by shards, not merged yet");
  for (const nlohmann::json& info : description.at("sequences")) {
    lines.push_back(info.at("name").get<std::string>() + ": " + info.at("split").get<std::string>() + ", " +
                    number(info.at("frames_complete")) + " of " + number(info.at("frames")) + " frames" +
                    (info.at("finished") ? "" : ", not finished") +
                    (info.contains("coarse") ? ", its own meshes: " + number(info.at("coarse").at("vertices")) +
                                                   " and " + number(info.at("fine").at("vertices")) + " vertices"
                                             : ""));
  }
  for (const auto& [split, counts] : description.at("splits").items()) {
    lines.push_back("split " + split + ": " + number(counts.at("sequences")) + " sequences, " +
                    number(counts.at("frames")) + " frames");
  }
  for (const auto& [name, reason] : description.at("dropped").items()) {
    lines.push_back(name + ": dropped, " + reason.get<std::string>());
  }
  if (description.at("not_begun") > 0)
    lines.push_back(number(description.at("not_begun")) + " sequences are not begun");
  return lines;
}

nlohmann::json to_json(const VerifyReport& report) {
  return {{"problems", report.problems},
          {"sequences", report.sequences},
          {"unmerged", report.unmerged},
          {"pending", report.pending},
          {"frames", report.frames},
          {"frames_judged", report.frames_judged},
          {"self_intersections", report.self_intersections},
          {"penetrations", report.penetrations},
          {"feature_distance_mean_m", report.feature_distance_mean_m},
          {"feature_distance_max_m", report.feature_distance_max_m}};
}

VerifyReport verify(const std::filesystem::path& folder, const VerifyOptions& options,
                    const std::function<void(const std::string&)>& on_sequence) {
  if (options.stride == 0) throw_invalid_argument("stride: at least 1");
  return Verifier(folder, options).run(on_sequence);
}

}  // namespace pleat::dataset
