#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/base/parallel.hpp"
#include "common/features/frame_features.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "services/superres/training/frame_converter.hpp"
#include "services/superres/training/initial.hpp"
#include "services/superres/training/mesh_tools.hpp"
#include "services/superres/training/pair_file.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

constexpr std::size_t kMeasuredFrames = 256;
constexpr std::size_t kMeasuredOfSequence = 6;
constexpr double kPublishedRange = 0.95;  ///< to whose positive and negative [acap] maps its features
constexpr float kDetailLimit = 6;         ///< folds have curvatures far beyond the deviation

/// A feature's value at rest.
double rest_of(const std::string& channel) {
  for (const char* one : {"rotation_w", "stretch_xx", "stretch_yy", "stretch_zz"}) {
    if (channel.rfind(one, 0) == 0) return 1;
  }
  return 0;
}

conversion::VertexFeatureSpec features_spec(const FeaturesConfig& c) {
  const auto answer = c.answer == "features"         ? conversion::AnswerKind::kFeatures
                      : c.answer == "features_alone" ? conversion::AnswerKind::kFeaturesAlone
                                                     : conversion::AnswerKind::kGradients;
  return {c.rotation == "quaternion" ? conversion::RotationCode::kQuaternion : conversion::RotationCode::kLogarithm,
          c.axes == "fixed",
          c.passes,
          c.anchor_weight,
          answer,
          c.obstacles};
}

conversion::GeometryImageSpec image_spec(const ImagesConfig& c) {
  conversion::GeometryImageSpec kind;
  kind.layout = c.layout == "detail"      ? conversion::ImageLayout::kDetail
                : c.layout == "positions" ? conversion::ImageLayout::kPositions
                                          : conversion::ImageLayout::kPublished;
  kind.base = c.base == "texels" ? conversion::DetailBase::kTexels : conversion::DetailBase::kVertices;
  kind.units = c.units == "coarse_edges" ? conversion::DetailUnits::kCoarseEdges : conversion::DetailUnits::kMetres;
  kind.image.texels_per_fine_vertex = c.texels_per_fine_vertex;
  kind.image.coarse_width = c.coarse_width;
  kind.image.coarse_height = c.coarse_height;
  kind.image.scale = c.scale;
  kind.image.method =
      c.method == "sampled" ? conversion::FineImageMethod::kSampled : conversion::FineImageMethod::kFitted;
  kind.image.lambda = c.lambda;
  return kind;
}

conversion::RepresentationSpec make_spec(const TrainConfig& config, const MeshPair& pair) {
  conversion::RepresentationSpec spec;
  spec.kind = image_spec(config.images);
  if (config.representation == "vertex_features") spec.kind = features_spec(config.vertex_features);
  spec.window = config.window;
  spec.window_stride = config.window_stride;
  const auto subdivision = find_subdivision(pair.coarse, pair.fine);
  if (subdivision && subdivision->rule != SubdivisionRule::kLoop) {
    spec.subdivision = *subdivision;
  } else {
    throw_invalid_argument(
        config.dataset + ": the fine mesh is no subdivision of the coarse one, so a bundle could not say which it is");
  }
  return spec;
}

bool in_validation(const TrainConfig& config, const SequenceInfo& sequence) {
  const auto& names = config.validation.sequences;
  if (!names.empty()) return std::find(names.begin(), names.end(), sequence.name) != names.end();
  return sequence.split == config.validation.split;
}

json ranges_json(const ChannelRanges& ranges) { return {ranges.offset, ranges.scale, ranges.limit}; }

/// A coarse mesh and its fine one, with what conversion makes of them.
class LoadedMesh {
 public:
  LoadedMesh(const TrainConfig& config, std::shared_ptr<const MeshPair> pair)
      : pair_(std::move(pair)), spec_(make_spec(config, *pair_)) {}

  const MeshPair& pair() const { return *pair_; }
  /// Made when it is asked for.
  const std::shared_ptr<const conversion::Representation>& representation() const {
    if (!representation_) representation_ = conversion::make_representation(pair_->coarse, spec_);
    return representation_;
  }
  /// The fit of fine images alone takes tens of megabytes, which hundreds of meshes have no room for.
  void release() const { representation_.reset(); }

  PairFileKey key;  ///< without content and frames

 private:
  std::shared_ptr<const MeshPair> pair_;
  conversion::RepresentationSpec spec_;
  mutable std::shared_ptr<const conversion::Representation> representation_;
};

/// One training: what load_pairs() does, step by step.
class Loader {
 public:
  Loader(const TrainConfig& config, const std::function<void(const std::string&)>& report,
         const std::function<bool()>& stopped)
      : config_(config),
        report_(report),
        reader_(config.dataset),
        pool_(static_cast<std::size_t>(config.threads)),
        stopped_(stopped) {}

  LoadedPairs run() {
    find_sequences();
    describe_data();
    check_size();
    measure_ranges();
    auto meshes = std::make_shared<FrameMeshes>(loaded_.data.output_ranges);
    for (const Usable& one : usable_) load(one, *meshes);
    PairData& data = loaded_.data;
    if (data.sequences.empty()) throw_invalid_argument(config_.dataset + ": no sequences with frames");
    json description{{"dataset", std::filesystem::path(config_.dataset).filename().string()},
                     {"dataset_git_revision", master().git_revision},
                     {"dataset_seed", master().seed},
                     {"frame_time_s", master().frame_time_s},
                     {"frames", frames_},
                     {"sequences", names_}};
    if (meshes_.size() > 1) description["meshes"] = meshes_.size();
    data.description = description.dump();
    data.check();
    if (config_.losses.needs_vertices() && !config_.published_images()) data.geometry = meshes;
    loaded_.judge = std::make_unique<FrameJudge>(meshes);
    return std::move(loaded_);
  }

 private:
  struct Usable {
    SequenceInfo info;
    std::size_t mesh = 0;
  };

  const DatasetMaster& master() const { return reader_.master(); }
  std::size_t stride_of(const SequenceInfo& sequence) const {
    return static_cast<std::size_t>(in_validation(config_, sequence) ? 1 : config_.every_frames);
  }
  std::uint64_t frames_of(const SequenceInfo& sequence) const {
    return (sequence.frames_complete + stride_of(sequence) - 1) / stride_of(sequence);
  }

  /// Sequences that can be used, and nothing about those that can't beyond a line each.
  void find_sequences() {
    const auto skip = [&](const std::string& text) {
      if (config_.strict) throw_data_loss(text);
      report_("warning: skipped: " + text);
    };
    const auto all = reader_.sequences(
        [&](const std::string& name, const Error& error) { skip("sequence " + name + ": " + error.what()); });
    const std::string hash = topology_hash(reader_.topology().fine);
    std::map<std::string, std::size_t> known;  // fine meshes
    for (const SequenceInfo& sequence : all) {
      if (sequence.split != "train" && !in_validation(config_, sequence)) continue;
      if (!sequence.own_meshes && sequence.topology_hash != hash) {
        throw_invalid_argument(config_.dataset + ": sequence " + sequence.name + " has another mesh (" +
                               sequence.topology_hash + ") than the data set (" + hash + ")");
      }
      if (!sequence.finished || sequence.frames_complete < sequence.frames) {
        skip("sequence " + sequence.name + ": " + std::to_string(sequence.frames_complete) + " of " +
             std::to_string(sequence.frames) + " frames were recorded");
        continue;
      }
      if (sequence.frames_complete == 0) continue;
      const auto [found, is_new] = known.try_emplace(sequence.topology_hash, meshes_.size());
      if (is_new) meshes_.emplace_back(config_, reader_.meshes(sequence.name));
      usable_.push_back({sequence, found->second});
    }
    if (std::none_of(usable_.begin(), usable_.end(), [&](const auto& s) { return !in_validation(config_, s.info); })) {
      throw_invalid_argument(config_.dataset + ": no finished sequence to train on (split 'train')");
    }
    for (const std::string& name : config_.validation.sequences) {
      if (std::none_of(usable_.begin(), usable_.end(), [&](const auto& s) { return s.info.name == name; })) {
        throw_not_found(config_.dataset + ": key 'validation.sequences' names " + name +
                        ", which does not exist or can't be used");
      }
    }
    if (meshes_.size() > 1 && config_.serves != "any") {
      throw_invalid_argument(config_.dataset + ": its sequences have " + std::to_string(meshes_.size()) +
                             " meshes, which needs key 'serves' = 'any'");
    }
    for (const Usable& one : usable_) frames_ += frames_of(one.info);
  }

  void describe_data() {
    PairData& data = loaded_.data;
    const conversion::Representation& first = *meshes_.front().representation();
    data.representation = first.spec();
    data.input_channels = first.input_channels();
    data.answer_channels = first.answer_channels();
    data.mesh = make_mesh_ports(first);
    data.frame_time_s = master().frame_time_s;
    data.meshes.clear();
    for (LoadedMesh& mesh : meshes_) {
      describe_mesh(mesh);
      if (meshes_.size() > 1) mesh.release();
    }
  }

  void describe_mesh(LoadedMesh& mesh) {
    const conversion::Representation& representation = *mesh.representation();
    const Topology& coarse = mesh.pair().coarse;
    PairMesh one;
    one.topology_hash = topology_hash(coarse);
    one.rest_positions.assign(coarse.rest_positions.data(),
                              coarse.rest_positions.data() + coarse.rest_positions.size());
    one.answer_mask = representation.answer_mask();
    one.constants = representation.constants();
    one.sheet_axes = flat_sheet_axes(coarse);
    if (config_.losses.needs_vertices()) one.mesh_read = make_mesh_read(representation);
    loaded_.data.meshes.push_back(std::move(one));
    const auto input = representation.input_shape(), answer = representation.answer_shape();
    PairFileKey& key = mesh.key;
    key.input_channels = static_cast<int>(input[0]) * config_.window;
    key.answer_channels = static_cast<int>(answer[0]);
    key.height = static_cast<int>(input[1]), key.width = static_cast<int>(input[2]);
    key.scale = static_cast<int>(answer[1] / input[1]);
    if (config_.cache == "uint16") {
      const bool features = config_.representation == "vertex_features";
      key.fixed_point = features && config_.vertex_features.normalization == "range" ? kAroundZero
                        : features || loaded_.data.detail()                          ? kUnitDeviation
                                                                                     : kUnitRange;
    }
  }

  void check_size() const {
    std::size_t bytes = 0;
    for (const Usable& one : usable_) {
      const PairFileKey& key = meshes_[one.mesh].key;
      const auto texels = static_cast<std::size_t>(key.height) * static_cast<std::size_t>(key.width);
      const auto square = static_cast<std::size_t>(key.scale) * static_cast<std::size_t>(key.scale);
      bytes += static_cast<std::size_t>(frames_of(one.info)) * texels *
               (static_cast<std::size_t>(key.input_channels) * sizeof(float) +
                static_cast<std::size_t>(key.answer_channels) * square * (key.fixed_point.used() ? 2 : sizeof(float)));
    }
    const std::size_t megabytes = bytes >> 20;
    if (megabytes <= static_cast<std::size_t>(config_.cache_limit_mb)) return;
    throw Error(ErrorCode::kResourceExhausted,
                config_.dataset + ": " + std::to_string(frames_) + " frames need " + std::to_string(megabytes) +
                    " MB of images, key 'cache_limit_mb' allows " + std::to_string(config_.cache_limit_mb));
  }

  FrameConverter converter(const LoadedMesh& mesh) { return {reader_, *mesh.representation(), pool_, stopped_}; }

  /// Every n-th frame is measured, n being this.
  std::size_t measured_stride() const {
    std::size_t training = 0, longest = 1;
    for (const auto& [info, mesh] : usable_) {
      if (in_validation(config_, info)) continue;
      training += info.frames_complete;
      longest = std::max<std::size_t>(longest, info.frames_complete);
    }
    const std::size_t stride = std::max<std::size_t>(1, training / kMeasuredFrames);
    // Of many short sequences the first frames alone, in which cloth is flat, would count too much.
    return meshes_.size() > 1 ? std::min(stride, std::max<std::size_t>(1, longest / kMeasuredOfSequence)) : stride;
  }

  /// Those of the weights that begin the training, where they mean the same here; of the published layout the data
  /// set's own; else measured on some frames of the training split.
  void measure_ranges() {
    PairData& data = loaded_.data;
    const bool published = config_.published_images();
    if (take_initial_ranges(config_, data)) {
      report_("normalisation is that of " + config_.initial);
    } else if (published && master().normalization) {
      data.input_ranges = data.output_ranges = *master().normalization;
    } else {
      if (published) report_("the data set has no normalisation: measuring it on the training split");
      RangeMeasure inputs(data.input_channels.size()), answers(data.answer_channels.size());
      const std::size_t stride = measured_stride();
      for (const auto& [info, m] : usable_) {
        if (in_validation(config_, info)) continue;
        const LoadedMesh& mesh = meshes_[m];
        const auto representation = mesh.representation();
        converter(mesh).run(info, stride, [&](std::uint64_t, Converted& frame) {
          // The newest frame, which comes last.
          const std::size_t one = frame.input.values.size() / static_cast<std::size_t>(config_.window);
          inputs.add(std::span(frame.input.values).last(one), representation->input_mask());
          answers.add(frame.answer, representation->answer_mask());
        });
        if (meshes_.size() > 1) mesh.release();
      }
      if (config_.representation == "vertex_features") {
        data.input_ranges = features_ranges(inputs, data.input_channels, false);
        data.output_ranges = features_ranges(answers, data.answer_channels, data.detail());
      } else if (data.detail()) {
        // An answer of zeros stays the coarse surface.
        data.input_ranges = inputs.moments(), data.output_ranges = answers.moments();
        data.input_ranges.limit = kDetailLimit;
        std::fill(data.output_ranges.offset.begin(), data.output_ranges.offset.end(), 0.0F);
      } else {
        inputs.merge(answers);
        data.input_ranges = data.output_ranges = inputs.extremes();
      }
    }
    // A channel that never changes (a cloth at rest has no velocity) is not to divide by nothing in the answer.
    for (float& scale : data.output_ranges.scale) {
      if (!(scale > 1e-9F)) scale = 1;
    }
  }

  /// By key 'vertex_features.normalization'. detail: zeros have to stay zeros.
  ChannelRanges features_ranges(const RangeMeasure& measure, const std::vector<std::string>& channels,
                                bool detail) const {
    const std::string& how = config_.vertex_features.normalization;
    ChannelRanges ranges = measure.moments();
    const auto count = channels.size();
    if (how == "channel") {
      // What is read is cut off far out: collapsed one-rings have any values.
      if (&channels == &loaded_.data.input_channels) ranges.limit = kDetailLimit;
      if (detail) std::fill(ranges.offset.begin(), ranges.offset.end(), 0.0F);
      return ranges;
    }
    const ChannelRanges extremes = measure.extremes();
    const auto group = [&](std::size_t c) { return channels[c].substr(0, channels[c].find('_')); };
    ChannelRanges result = ranges;
    for (std::size_t c = 0; c < count; ++c) {
      double square = 0, low = std::numeric_limits<double>::infinity(), high = -low, members = 0;
      for (std::size_t other = 0; other < count; ++other) {
        if (group(other) != group(c)) continue;
        const double rest = rest_of(channels[other]), mean = static_cast<double>(ranges.offset[other]) - rest;
        square += mean * mean + std::pow(static_cast<double>(ranges.scale[other]), 2);
        low = std::min(low, static_cast<double>(extremes.offset[other]));
        high = std::max(high, static_cast<double>(extremes.offset[other]) + static_cast<double>(extremes.scale[other]));
        ++members;
      }
      if (how == "group") {
        result.offset[c] = static_cast<float>(detail ? 0.0 : rest_of(channels[c]));
        result.scale[c] = static_cast<float>(std::sqrt(square / members));
      } else {
        result.offset[c] = static_cast<float>(detail ? 0.0 : (low + high) / 2);
        result.scale[c] =
            static_cast<float>((detail ? std::max(std::abs(low), std::abs(high)) : (high - low) / 2) / kPublishedRange);
      }
    }
    return result;
  }

  std::uint64_t content_of(const Usable& one) const {
    const SequenceInfo& info = one.info;
    const PairFileKey& key = meshes_[one.mesh].key;
    const std::filesystem::path finished = std::filesystem::path(config_.dataset) / "sequences" / (info.name + ".h5");
    const std::filesystem::path file = info.finished ? finished : std::filesystem::path(finished.string() + ".partial");
    std::error_code error;
    const auto written = std::filesystem::last_write_time(file, error).time_since_epoch().count();
    const ImagesConfig& c = config_.images;
    const FeaturesConfig& f = config_.vertex_features;
    const json content{
        {"topology", {loaded_.data.meshes[one.mesh].topology_hash, info.topology_hash}},
        {"images", {c.layout, c.base, c.units, key.width, key.height, c.scale, c.method, c.lambda}},
        {"representation", {config_.representation, f.rotation, f.axes, f.answer, f.normalization, f.obstacles}},
        {"window", {config_.window, config_.window_stride}},
        {"input", ranges_json(loaded_.data.input_ranges)},
        {"output", ranges_json(loaded_.data.output_ranges)},
        {"frames", info.frames_complete},
        {"frame_time_s", master().frame_time_s},
        {"every_frames", stride_of(info)},
        {"file", {std::filesystem::file_size(file, error), written}}};
    return Hash().add(content.dump()).value();
  }

  void convert(const Usable& one, const PairFileKey& key, const std::filesystem::path& path) {
    std::size_t clamped = 0;
    PairFileWriter writer(path, key);
    converter(meshes_[one.mesh]).run(one.info, stride_of(one.info), [&](std::uint64_t, Converted& frame) {
      for (int t = 0; t < config_.window; ++t) {
        const std::size_t size = frame.input.values.size() / static_cast<std::size_t>(config_.window);
        normalize(loaded_.data.input_ranges,
                  std::span(frame.input.values).subspan(static_cast<std::size_t>(t) * size, size));
      }
      normalize(loaded_.data.output_ranges, frame.answer);
      for (const float v : frame.answer.values) clamped += key.fixed_point.holds(v) ? 0 : 1;
      RotationRows rotation{};
      Eigen::Map<Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(rotation.data()) = frame.alignment.rotation;
      writer.append(frame.input.values, frame.answer.values, rotation);
    });
    writer.finish();
    report_(one.info.name + ": " + std::to_string(key.frames) + " frames converted" +
            (clamped > 0 ? ", " + std::to_string(clamped) + " values beyond what 16 bits hold cut off" : ""));
  }

  void load(const Usable& one, FrameMeshes& meshes) {
    const SequenceInfo& info = one.info;
    const LoadedMesh& mesh = meshes_[one.mesh];
    PairSequence sequence;
    sequence.name = info.name;
    sequence.validation = in_validation(config_, info);
    sequence.mesh = one.mesh;
    PairFileKey key = mesh.key;
    key.frames = frames_of(info);
    key.content = content_of(one);
    char file[24];
    std::snprintf(file, sizeof file, "-%016llx.bin", static_cast<unsigned long long>(key.content));
    const std::filesystem::path folder = config_.cache_folder.empty()
                                             ? std::filesystem::path(config_.dataset) / "images"
                                             : std::filesystem::path(config_.cache_folder);
    const std::filesystem::path path = folder / (info.name + file);
    if (map_pair_file(path, key, sequence)) {
      report_(info.name + ": " + std::to_string(key.frames) + " frames from " + path.string());
    } else {
      try {
        convert(one, key, path);
      } catch (const Error& error) {
        // The attributes promised frames that the file does not hold.
        if (error.code() != ErrorCode::kDataLoss || config_.strict) throw;
        report_("warning: skipped: sequence " + info.name + ": " + error.what());
        return;
      }
      if (!map_pair_file(path, key, sequence)) throw_data_loss(path.string() + ": can't be read back");
    }
    if (meshes_.size() > 1) mesh.release();
    const std::size_t index = loaded_.data.sequences.size(), stride = stride_of(info);
    if (sequence.validation) {
      const auto every = static_cast<std::uint64_t>(config_.validation.every_frames);
      for (std::uint64_t k = 0; k < info.frames_complete; k += every) {
        meshes.add(index, k, mesh.representation(), std::move(reader_.coarse(info.name, k, k + 1).at(0)),
                   std::move(reader_.fine(info.name, k, k + 1).at(0)));
      }
    } else if (config_.losses.needs_vertices() && !config_.published_images()) {
      auto coarse = reader_.coarse(info.name, 0, info.frames_complete);
      for (std::size_t k = 0; k < coarse.size(); k += stride) {
        meshes.add(index, k / stride, mesh.representation(), std::move(coarse[k]), {});
      }
    }
    names_[sequence.validation ? "validation" : "train"].push_back(info.name);
    loaded_.data.sequences.push_back(std::move(sequence));
  }

  const TrainConfig& config_;
  const std::function<void(const std::string&)>& report_;
  const DatasetReader reader_;
  ThreadPool pool_;
  const std::function<bool()>& stopped_;
  std::vector<LoadedMesh> meshes_;
  std::vector<Usable> usable_;
  std::size_t frames_ = 0;
  json names_ = {{"train", json::array()}, {"validation", json::array()}};
  LoadedPairs loaded_;
};

}  // namespace

LoadedPairs load_pairs(const TrainConfig& config, const std::function<void(const std::string&)>& report,
                       const std::function<bool()>& stopped) {
  return Loader(config, report, stopped).run();
}

}  // namespace pleat::superres
