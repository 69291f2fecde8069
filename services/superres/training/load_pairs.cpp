#include <Eigen/Cholesky>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/base/parallel.hpp"
#include "common/features/frame_features.hpp"
#include "common/mesh/connectivity.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "services/conversion/geometry_image/image_map.hpp"
#include "services/superres/training/make_mesh_base.hpp"
#include "services/superres/training/pair_file.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

constexpr std::uint64_t kChunk = 32;             ///< frames read and converted together
constexpr std::size_t kNormalizationStride = 4;  ///< frames skipped where the range has to be measured here

ImageSpec make_spec(const ImagesConfig& config) {
  ImageSpec spec;
  spec.texels_per_fine_vertex = config.texels_per_fine_vertex;
  spec.coarse_width = config.coarse_width;
  spec.coarse_height = config.coarse_height;
  spec.scale = kScale;
  spec.method = config.method == "sampled" ? FineImageMethod::kSampled : FineImageMethod::kFitted;
  spec.lambda = config.lambda;
  return spec;
}

/// `previous` is the frame before positions[0], or empty at the beginning of a sequence.
Frame make_frame(const std::vector<Positions>& positions, std::size_t index, const Positions& previous,
                 double frame_time_s) {
  Frame frame;
  frame.positions = positions[index];
  frame.velocities = backward_velocities(frame.positions, index > 0 ? positions[index - 1] : previous, frame_time_s);
  return frame;
}

void scale_to_unit(Tensor& image, const Normalization& normalization) {
  const std::size_t plane = image.values.size() / kChannels;
  for (std::size_t c = 0; c < kChannels; ++c) {
    const float low = normalization.minimum[c], range = normalization.maximum[c] - low;
    for (std::size_t i = c * plane; i < (c + 1) * plane; ++i) image.values[i] = (image.values[i] - low) / range;
  }
}

void scale_back(Tensor& image, const Normalization& normalization) {
  const std::size_t plane = image.values.size() / kChannels;
  for (std::size_t c = 0; c < kChannels; ++c) {
    const float low = normalization.minimum[c], range = normalization.maximum[c] - low;
    for (std::size_t i = c * plane; i < (c + 1) * plane; ++i) image.values[i] = image.values[i] * range + low;
  }
}

/// One sequence's frames, converted chunk by chunk on all threads.
class Converter {
 public:
  Converter(const DatasetReader& reader, const ImageMap& map, ThreadPool& pool, double frame_time_s,
            const std::atomic<bool>* stop)
      : reader_(reader), map_(map), pool_(pool), frame_time_s_(frame_time_s), stop_(stop) {}

  struct Converted {
    Tensor coarse, fine;
    RigidTransform transform;
    Positions coarse_positions, fine_positions;
  };

  /// Calls use(frame index, converted) in frame order, for every `stride`-th frame. Throws kCancelled when it is to
  /// stop.
  template <typename Use>
  void run(const SequenceInfo& sequence, std::size_t stride, const Use& use) const {
    Positions last_coarse, last_fine;
    for (std::uint64_t first = 0; first < sequence.frames_complete; first += kChunk) {
      if (stop_ != nullptr && stop_->load()) {
        throw Error(ErrorCode::kCancelled, "stopped while the images of sequence " + sequence.name +
                                               " were converted; nothing was trained yet");
      }
      const std::uint64_t end = std::min(first + kChunk, sequence.frames_complete);
      const auto coarse = reader_.coarse(sequence.name, first, end);
      const auto fine = reader_.fine(sequence.name, first, end);
      std::vector<Converted> results(coarse.size());
      pool_.parallel_for(coarse.size(), 1, [&](std::size_t begin, std::size_t stop) {
        for (std::size_t i = begin; i < stop; ++i) {
          if ((first + i) % stride != 0) continue;
          auto image = map_.coarse_image(make_frame(coarse, i, last_coarse, frame_time_s_));
          results[i].fine = map_.fine_image(make_frame(fine, i, last_fine, frame_time_s_), image.transform);
          results[i].coarse = std::move(image.image);
          results[i].transform = image.transform;
          results[i].coarse_positions = coarse[i];
          results[i].fine_positions = fine[i];
        }
      });
      for (std::size_t i = 0; i < results.size(); ++i) {
        if ((first + i) % stride == 0) use(first + i, results[i]);
      }
      last_coarse = coarse.back();
      last_fine = fine.back();
    }
  }

 private:
  const DatasetReader& reader_;
  const ImageMap& map_;
  ThreadPool& pool_;
  double frame_time_s_;
  const std::atomic<bool>* stop_;
};

void extend(Normalization& range, const Tensor& image, const std::vector<std::uint8_t>& mask) {
  const std::size_t plane = mask.size();
  for (std::size_t c = 0; c < kChannels; ++c) {
    for (std::size_t i = 0; i < plane; ++i) {
      if (mask[i] == 0) continue;
      range.minimum[c] = std::min(range.minimum[c], image.values[c * plane + i]);
      range.maximum[c] = std::max(range.maximum[c], image.values[c * plane + i]);
    }
  }
}

class Judge : public MeshJudge {
 public:
  Judge(std::unique_ptr<ImageMap> map, const MeshPair& pair, const Normalization& normalization)
      : map_(std::move(map)), normalization_(normalization), coarse_faces_(pair.coarse.faces) {
    subdivision_ = subdivide(pair.coarse, 2);
    if (subdivision_.fine.vertex_count() != pair.fine.vertex_count() ||
        subdivision_.fine.rest_positions != pair.fine.rest_positions) {
      throw_invalid_argument("data set: the fine mesh is not the coarse one with every edge split in four");
    }
  }

  struct Truth {
    Positions coarse, fine;
    RigidTransform transform;
  };
  void add(std::size_t sequence, std::size_t frame, Truth truth) { truths_[{sequence, frame}] = std::move(truth); }

  double squared_error(std::size_t sequence, std::size_t frame, std::span<const float> fine_image) override {
    Tensor image{
        {kChannels, map_->fine_height(), map_->fine_width()}, channel_names(), {fine_image.begin(), fine_image.end()}};
    scale_back(image, normalization_);
    const Truth& truth = at(sequence, frame);
    return mean_square(map_->to_mesh(image, truth.transform), truth.fine);
  }

  double barycentric_squared_error(std::size_t sequence, std::size_t frame) override {
    const Truth& truth = at(sequence, frame);
    return mean_square(upsample(subdivision_, coarse_faces_, truth.coarse), truth.fine);
  }

  std::vector<float> barycentric_image(std::size_t sequence, std::size_t frame) override {
    const Truth& truth = at(sequence, frame);
    Frame upsampled;
    upsampled.positions = upsample(subdivision_, coarse_faces_, truth.coarse);
    Tensor image = map_->fine_image(upsampled, truth.transform);
    scale_to_unit(image, normalization_);
    return std::move(image.values);
  }

 private:
  const Truth& at(std::size_t sequence, std::size_t frame) const {
    const auto it = truths_.find({sequence, frame});
    if (it == truths_.end()) throw_internal("judge: not a validation frame");
    return it->second;
  }
  static double mean_square(const Positions& a, const Positions& b) {
    return (a - b).cast<double>().squaredNorm() / static_cast<double>(a.rows());
  }

  std::unique_ptr<ImageMap> map_;
  Normalization normalization_;
  Faces coarse_faces_;
  Subdivision subdivision_;
  std::map<std::pair<std::size_t, std::size_t>, Truth> truths_;
};

/// u and v directions if the rest positions are an affine function of the material coordinates, and those are mirror
/// symmetric as a rectangle is; else empty.
std::vector<std::array<float, 3>> flat_sheet_axes(const Topology& mesh) {
  const Eigen::Index corners = mesh.uv_faces.size();
  Eigen::MatrixX3d a(corners, 3), x(corners, 3);
  for (Eigen::Index i = 0; i < corners; ++i) {
    const auto uv = mesh.uv.row(mesh.uv_faces.data()[i]).cast<double>();
    a.row(i) << uv[0], uv[1], 1;
    x.row(i) = mesh.rest_positions.row(mesh.faces.data()[i]).cast<double>();
  }
  const Eigen::Matrix3d solution = (a.transpose() * a).ldlt().solve(a.transpose() * x);
  const double extent = (mesh.uv.colwise().maxCoeff() - mesh.uv.colwise().minCoeff()).norm();
  if ((a * solution - x).cwiseAbs().maxCoeff() > 1e-4 * extent) return {};
  const Eigen::Vector3d u = solution.row(0), v = solution.row(1);
  if (std::abs(u.dot(v)) > 1e-4 * u.norm() * v.norm()) return {};
  const auto to_array = [](const Eigen::Vector3d& d) {
    return std::array<float, 3>{static_cast<float>(d[0]), static_cast<float>(d[1]), static_cast<float>(d[2])};
  };
  return {to_array(u), to_array(v)};
}

MeshRead make_mesh_read(const VertexReads& reads, const Topology& fine) {
  MeshRead result;
  const auto vertices = static_cast<std::size_t>(fine.vertex_count());
  std::size_t most = 1;
  for (std::size_t v = 0; v < vertices; ++v) {
    most = std::max<std::size_t>(most, reads.offsets[v + 1] - reads.offsets[v]);
  }
  result.texels.assign(most * vertices, 0);
  result.weights.assign(most * vertices, 0.0F);
  for (std::size_t v = 0; v < vertices; ++v) {
    for (std::size_t i = reads.offsets[v]; i < reads.offsets[v + 1]; ++i) {
      const std::size_t place = (i - reads.offsets[v]) * vertices + v;
      result.texels[place] = reads.places[i];
      result.weights[place] = reads.weights[i];
    }
  }
  // Column by column.
  const auto rest = fine.rest_positions.reshaped<Eigen::ColMajor>();
  const auto faces = fine.faces.reshaped<Eigen::ColMajor>();
  result.rest.assign(rest.begin(), rest.end());
  result.faces.assign(faces.begin(), faces.end());
  std::vector<std::int64_t> ends;
  for (const Edge& edge : build_connectivity(fine.vertex_count(), fine.faces).edges) {
    if (fine.rest_positions.row(edge.v0) == fine.rest_positions.row(edge.v1)) continue;
    result.edges.push_back(edge.v0);
    ends.push_back(edge.v1);
  }
  result.edges.insert(result.edges.end(), ends.begin(), ends.end());
  return result;
}

bool in_validation(const TrainConfig& config, const SequenceInfo& sequence) {
  const auto& names = config.validation.sequences;
  if (!names.empty()) return std::find(names.begin(), names.end(), sequence.name) != names.end();
  return sequence.split == config.validation.split;
}

/// Of everything that decides the images of a sequence.
std::uint64_t content_hash(const TrainConfig& config, const SequenceInfo& info, const PairData& data,
                           std::size_t stride) {
  const std::filesystem::path finished = std::filesystem::path(config.dataset) / "sequences" / (info.name + ".h5");
  const std::filesystem::path file = info.finished ? finished : std::filesystem::path(finished.string() + ".partial");
  std::error_code error;
  const auto written = std::filesystem::last_write_time(file, error).time_since_epoch().count();
  json content{{"topology", {data.topology_hash, info.topology_hash}},
               {"images", data.image_spec},
               {"minimum", data.normalization.minimum},
               {"maximum", data.normalization.maximum},
               {"frames", info.frames_complete},
               {"frame_time_s", data.frame_time_s},
               {"file", {std::filesystem::file_size(file, error), written}}};
  if (stride > 1) content["every_frames"] = stride;
  return Hash().add(content.dump()).value();
}

/// Sequences that can be used, and nothing about those that can't beyond a line each.
std::vector<SequenceInfo> usable_sequences(const TrainConfig& config, const DatasetReader& reader,
                                           const std::function<void(const std::string&)>& report) {
  const auto skip = [&](const std::string& text) {
    if (config.strict) throw_data_loss(text);
    report("warning: skipped: " + text);
  };
  std::vector<SequenceInfo> usable;
  const auto all = reader.sequences(
      [&](const std::string& name, const Error& error) { skip("sequence " + name + ": " + error.what()); });
  const std::string hash = topology_hash(reader.topology().fine);
  for (const SequenceInfo& sequence : all) {
    if (sequence.split != "train" && !in_validation(config, sequence)) continue;
    if (sequence.topology_hash != hash) {
      throw_invalid_argument(config.dataset + ": sequence " + sequence.name + " has another mesh (" +
                             sequence.topology_hash + ") than the data set (" + hash + ")");
    }
    if (!sequence.finished || sequence.frames_complete < sequence.frames) {
      skip("sequence " + sequence.name + ": " + std::to_string(sequence.frames_complete) + " of " +
           std::to_string(sequence.frames) + " frames were recorded");
      continue;
    }
    if (sequence.frames_complete > 0) usable.push_back(sequence);
  }
  if (std::none_of(usable.begin(), usable.end(), [&](const auto& s) { return !in_validation(config, s); })) {
    throw_invalid_argument(config.dataset + ": no finished sequence to train on (split 'train')");
  }
  return usable;
}

}  // namespace

LoadedPairs load_pairs(const TrainConfig& config, const std::function<void(const std::string&)>& report,
                       const std::atomic<bool>* stop) {
  const DatasetReader reader(config.dataset);
  const DatasetMaster& master = reader.master();
  auto map = std::make_unique<ImageMap>(master.topology.coarse, master.topology.fine, make_spec(config.images));
  ThreadPool pool(static_cast<std::size_t>(config.threads));
  const Converter converter(reader, *map, pool, master.frame_time_s, stop);

  const std::vector<SequenceInfo> sequences = usable_sequences(config, reader, report);
  const auto stride_of = [&](const SequenceInfo& sequence) {
    return static_cast<std::size_t>(in_validation(config, sequence) ? 1 : config.every_frames);
  };
  const auto frames_of = [&](const SequenceInfo& sequence) {
    return (sequence.frames_complete + stride_of(sequence) - 1) / stride_of(sequence);
  };
  std::size_t frames = 0;
  for (const SequenceInfo& sequence : sequences) frames += frames_of(sequence);
  for (const std::string& name : config.validation.sequences) {
    if (std::none_of(sequences.begin(), sequences.end(), [&](const auto& s) { return s.name == name; })) {
      throw_not_found(config.dataset + ": key 'validation.sequences' names " + name +
                      ", which does not exist or can't be used");
    }
  }
  const auto coarse_texels =
      static_cast<std::size_t>(map->coarse_width()) * static_cast<std::size_t>(map->coarse_height());
  const std::size_t value = config.cache == "float32" ? 4 : 2;
  const std::size_t megabytes = frames * kChannels * coarse_texels * (sizeof(float) + kScale * kScale * value) >> 20;
  if (megabytes > static_cast<std::size_t>(config.cache_limit_mb)) {
    throw Error(ErrorCode::kResourceExhausted,
                config.dataset + ": " + std::to_string(frames) + " frames need " + std::to_string(megabytes) +
                    " MB of images, key 'cache_limit_mb' allows " + std::to_string(config.cache_limit_mb));
  }
  const std::filesystem::path image_folder = config.cache_folder.empty()
                                                 ? std::filesystem::path(config.dataset) / "images"
                                                 : std::filesystem::path(config.cache_folder);

  LoadedPairs loaded;
  PairData& data = loaded.data;
  data.frame_time_s = master.frame_time_s;
  data.topology_hash = topology_hash(master.topology.coarse);
  data.fine_mask = map->fine_mask();
  data.sheet_axes = flat_sheet_axes(master.topology.coarse);
  data.image_spec = json{{"coarse_width", map->coarse_width()},
                         {"coarse_height", map->coarse_height()},
                         {"scale", kScale},
                         {"method", config.images.method},
                         {"lambda", config.images.lambda}}
                        .dump();
  if (master.normalization) {
    for (std::size_t c = 0; c < kChannels; ++c) {
      data.normalization.minimum[c] = master.normalization->offset[c];
      data.normalization.maximum[c] = master.normalization->offset[c] + master.normalization->scale[c];
    }
  } else {
    data.normalization.minimum.fill(std::numeric_limits<float>::infinity());
    data.normalization.maximum.fill(-std::numeric_limits<float>::infinity());
    report("the data set has no normalisation: measuring it on the training split");
    for (const SequenceInfo& sequence : sequences) {
      if (in_validation(config, sequence)) continue;
      converter.run(sequence, kNormalizationStride, [&](std::uint64_t, const Converter::Converted& frame) {
        extend(data.normalization, frame.coarse, map->coarse_mask());
        extend(data.normalization, frame.fine, map->fine_mask());
      });
    }
  }
  for (std::size_t c = 0; c < kChannels; ++c) {
    // A channel that never changes (a cloth at rest has no velocity) keeps its value at 0.
    if (!(data.normalization.maximum[c] - data.normalization.minimum[c] > 1e-9F)) {
      data.normalization.maximum[c] = data.normalization.minimum[c] + 1;
    }
  }

  auto judge = std::make_unique<Judge>(
      std::make_unique<ImageMap>(master.topology.coarse, master.topology.fine, make_spec(config.images)),
      master.topology, data.normalization);
  json names = {{"train", json::array()}, {"validation", json::array()}};
  if (needs_mesh(config.architecture)) data.mesh_base = make_mesh_base(master.topology, make_spec(config.images));
  if (config.losses.needs_vertices()) data.mesh_read = make_mesh_read(map->vertex_reads(), master.topology.fine);
  for (const SequenceInfo& info : sequences) {
    PairSequence sequence;
    sequence.name = info.name;
    sequence.validation = in_validation(config, info);
    PairFileKey key{0, frames_of(info), map->coarse_height(), map->coarse_width(), config.cache == "uint16"};
    key.content = content_hash(config, info, data, stride_of(info));
    char file[24];
    std::snprintf(file, sizeof file, "-%016llx.bin", static_cast<unsigned long long>(key.content));
    const std::filesystem::path path = image_folder / (info.name + file);
    if (map_pair_file(path, key, sequence)) {
      report(info.name + ": " + std::to_string(frames_of(info)) + " frames from " + path.string());
    } else {
      std::size_t clamped = 0;
      PairFileWriter writer(path, key);
      const auto convert = [&] {
        converter.run(info, stride_of(info), [&](std::uint64_t, Converter::Converted& frame) {
          scale_to_unit(frame.coarse, data.normalization);
          scale_to_unit(frame.fine, data.normalization);
          for (const float v : frame.fine.values) clamped += key.fixed_point && (v < -0.5F || v >= 1.5F) ? 1 : 0;
          std::array<float, 9> rotation{};
          for (std::size_t i = 0; i < 9; ++i) {
            rotation[i] = frame.transform.rotation(static_cast<Eigen::Index>(i / 3), static_cast<Eigen::Index>(i % 3));
          }
          writer.append(frame.coarse.values, frame.fine.values, rotation);
        });
      };
      try {
        convert();
      } catch (const Error& error) {
        // The attributes promised frames that the file does not hold.
        if (error.code() != ErrorCode::kDataLoss || config.strict) throw;
        report("warning: skipped: sequence " + info.name + ": " + error.what());
        continue;
      }
      writer.finish();
      if (!map_pair_file(path, key, sequence)) throw_data_loss(path.string() + ": can't be read back");
      report(info.name + ": " + std::to_string(frames_of(info)) + " frames converted" +
             (clamped > 0 ? ", " + std::to_string(clamped) + " values beyond [-0.5, 1.5) clamped" : ""));
    }
    if (sequence.validation) {
      const auto every = static_cast<std::uint64_t>(config.validation.every_frames);
      for (std::uint64_t k = 0; k < info.frames_complete; k += every) {
        Judge::Truth truth{
            std::move(reader.coarse(info.name, k, k + 1).at(0)), std::move(reader.fine(info.name, k, k + 1).at(0)), {}};
        truth.transform = map->align(truth.coarse);
        judge->add(data.sequences.size(), k, std::move(truth));
      }
    }
    names[sequence.validation ? "validation" : "train"].push_back(info.name);
    data.sequences.push_back(std::move(sequence));
  }
  if (data.sequences.empty()) throw_invalid_argument(config.dataset + ": no sequences with frames");
  data.description = json{
      {"dataset", std::filesystem::path(config.dataset).filename().string()},
      {"dataset_git_revision", master.git_revision},
      {"dataset_seed", master.seed},
      {"frame_time_s", master.frame_time_s},
      {"frames", frames},
      {"sequences",
       names}}.dump();
  data.check();
  loaded.judge = std::move(judge);
  return loaded;
}

}  // namespace pleat::superres
