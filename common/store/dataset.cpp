#include "common/store/dataset.hpp"

#include <algorithm>
#include <set>
#include <sstream>

#include "common/base/own_file.hpp"
#include "common/store/hdf5.hpp"
#include "common/store/recording.hpp"

namespace pleat {
namespace {

constexpr const char* kDatasetFormat = "pleat.dataset";
constexpr const char* kSequenceFormat = "pleat.sequence";

void check_name(const std::string& name) {
  const auto allowed = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '_' ||
           c == '-';
  };
  if (name.empty() || name.front() == '.' || name.size() > 200 || !std::all_of(name.begin(), name.end(), allowed)) {
    throw_invalid_argument("sequence name '" + name + "' must consist of letters, digits, '.', '_' and '-'");
  }
}

std::filesystem::path sequence_path(const std::filesystem::path& folder, const std::string& name) {
  return folder / "sequences" / (name + ".h5");
}

std::vector<double> read_times(const hdf5::File& file, std::uint64_t first, std::uint64_t last) {
  file.extents("/time_s", 1, kMaxFrames);
  std::vector<double> times(last - first);
  file.rows("/time_s").read(H5T_NATIVE_DOUBLE, first, times.size(), times.data());
  return times;
}

}  // namespace

void write_dataset_master(const std::filesystem::path& folder, const DatasetMaster& master) {
  for (const std::string& name : master.sequences) check_name(name);
  std::error_code error;
  std::filesystem::create_directories(folder / "sequences", error);
  if (error) throw_invalid_argument(folder.string() + ": can't be made (" + error.message() + ")");
  const std::filesystem::path path = folder / "dataset.h5";
  const std::filesystem::path partial = path.string() + ".partial";
  const auto lock = hdf5::lock();
  require_absent_or(hdf5::is_own(path), path);
  hdf5::File file = hdf5::File::create(partial);
  file.set_attribute("/", "format", std::string(kDatasetFormat));
  file.set_attribute("/", "version", std::uint64_t{kStoreVersion});
  file.set_attribute("/", "units", std::string("m, s, Y up"));
  file.set_attribute("/", "time_step_s", master.time_step_s);
  file.set_attribute("/", "frame_time_s", master.frame_time_s);
  file.set_attribute("/", "seed", master.seed);
  file.set_attribute("/", "fine", std::string(master.tracked ? "tracked" : "free"));
  file.set_attribute("/", "git_revision", master.git_revision);
  if (!master.material.empty()) file.set_attribute("/", "material", master.material);
  store::write_topologies(file, master.topology);
  if (master.normalization) {
    check_ranges(*master.normalization, kFrameChannels, path.string() + ": normalisation");
    std::vector<float> maximum = master.normalization->offset;
    for (std::size_t c = 0; c < maximum.size(); ++c) maximum[c] += master.normalization->scale[c];
    const std::vector<hsize_t> extents{maximum.size()};
    file.write_array("/normalization/minimum", H5T_NATIVE_FLOAT, extents, master.normalization->offset.data());
    file.write_array("/normalization/maximum", H5T_NATIVE_FLOAT, extents, maximum.data());
  }
  file.make_group("/sequences");
  for (const std::string& name : master.sequences) {
    const std::string target = "sequences/" + name + ".h5";
    const std::string link = "/sequences/" + name;
    if (H5Lcreate_external(target.c_str(), "/", file.id(), link.c_str(), H5P_DEFAULT, H5P_DEFAULT) < 0) {
      hdf5::fail(ErrorCode::kInternal, partial, "can't link " + name);
    }
  }
  file.close();
  file.rename(path);
}

struct SequenceWriter::State {
  SequenceOptions options;
  store::Recording recording;
};

namespace {

store::Recording::Plan sequence_plan(const std::filesystem::path& folder, const SequenceOptions& options) {
  check_name(options.name);
  if (options.coarse_vertices <= 0 || options.fine_vertices <= 0) {
    throw_invalid_argument("sequence " + options.name + ": the meshes have no vertices");
  }
  if (options.meshes && (options.meshes->coarse.vertex_count() != options.coarse_vertices ||
                         options.meshes->fine.vertex_count() != options.fine_vertices ||
                         topology_hash(options.meshes->fine) != options.topology_hash)) {
    throw_invalid_argument("sequence " + options.name + ": its own meshes are others than it says");
  }
  store::Recording::Plan plan;
  plan.path = sequence_path(folder, options.name);
  plan.frames = options.frames;
  plan.resume = true;
  plan.deflate = options.deflate;
  using Type = store::Array::Type;
  // Small arrays first, so that a disk that fills up hurts the large ones' last frames and not every frame.
  plan.arrays = {{"/time_s", Type::kDouble, {}, false}};
  const auto obstacles = store::obstacle_arrays(options.obstacles, options.obstacle_vertices);
  plan.arrays.insert(plan.arrays.end(), obstacles.begin(), obstacles.end());
  plan.arrays.push_back({"/coarse/positions", Type::kFloat, {static_cast<hsize_t>(options.coarse_vertices), 3}, true});
  plan.arrays.push_back({"/fine/positions", Type::kFloat, {static_cast<hsize_t>(options.fine_vertices), 3}, true});
  std::ostringstream key;
  key << options.name << '\n'
      << options.split << '\n'
      << options.scene << '\n'
      << options.frames << '\n'
      << options.topology_hash << '\n';
  if (options.meshes) key << "own " << topology_hash(options.meshes->coarse) << '\n';
  for (const store::Array& array : plan.arrays) {
    key << array.name;
    for (const hsize_t extent : array.row) key << ' ' << extent;
    key << '\n';
  }
  plan.fingerprint = store::fingerprint(key.str());
  plan.write_header = [options](hdf5::File& file) {
    file.set_attribute("/", "format", std::string(kSequenceFormat));
    file.set_attribute("/", "version", std::uint64_t{kStoreVersion});
    file.set_attribute("/", "split", options.split);
    file.set_attribute("/", "scene", options.scene);
    file.set_attribute("/", "frames", options.frames);
    file.set_attribute("/", "topology_hash", options.topology_hash);
    store::write_obstacle_shapes(file, options.obstacles);
    if (options.meshes) store::write_topologies(file, *options.meshes);
  };
  return plan;
}

}  // namespace

SequenceWriter::SequenceWriter(const std::filesystem::path& folder, const SequenceOptions& options)
    : state_(std::make_unique<State>(State{options, store::Recording(sequence_plan(folder, options))})) {}
SequenceWriter::~SequenceWriter() = default;
SequenceWriter::SequenceWriter(SequenceWriter&&) noexcept = default;
SequenceWriter& SequenceWriter::operator=(SequenceWriter&&) noexcept = default;

std::uint64_t SequenceWriter::frames_complete() const { return state_->recording.frames_complete(); }

void SequenceWriter::append(const SequenceFrame& frame) {
  const SequenceOptions& options = state_->options;
  if (frame.coarse.rows() != options.coarse_vertices || frame.fine.rows() != options.fine_vertices) {
    throw_invalid_argument("sequence " + options.name + ": " + std::to_string(frame.coarse.rows()) + " coarse and " +
                           std::to_string(frame.fine.rows()) + " fine vertices given, " +
                           std::to_string(options.coarse_vertices) + " and " + std::to_string(options.fine_vertices) +
                           " planned");
  }
  std::vector<const void*> rows = {&frame.time_s};
  const auto obstacles = store::obstacle_rows(options.obstacles, options.obstacle_vertices, frame.obstacles);
  rows.insert(rows.end(), obstacles.begin(), obstacles.end());
  rows.push_back(frame.coarse.data());
  rows.push_back(frame.fine.data());
  state_->recording.append(rows);
}

void SequenceWriter::finish() {
  if (frames_complete() != state_->options.frames) {
    throw Error(ErrorCode::kFailedPrecondition, "sequence " + state_->options.name + ": " +
                                                    std::to_string(frames_complete()) + " of " +
                                                    std::to_string(state_->options.frames) + " frames recorded");
  }
  state_->recording.finish();
}

struct DatasetReader::State {
  std::filesystem::path folder;
  DatasetMaster master;
  mutable std::set<std::filesystem::path> examined;  ///< files are opened for each call, and examined once

  struct Opened {
    hdf5::File file;
    bool finished;
    std::uint64_t complete;
  };

  /// The finished file, else the partial one. With hdf5::lock().
  Opened open(const std::string& name) const {
    if (std::find(master.sequences.begin(), master.sequences.end(), name) == master.sequences.end()) {
      throw_not_found(folder.string() + ": no sequence " + name);
    }
    const std::filesystem::path path = sequence_path(folder, name);
    const std::filesystem::path partial = path.string() + ".partial";
    std::error_code error;
    const bool finished = std::filesystem::exists(path, error);
    const std::filesystem::path& chosen = finished ? path : partial;
    const bool known = !examined.insert(chosen).second;
    hdf5::File file = known ? hdf5::File::open_own(chosen, false) : hdf5::File::open(chosen, false);
    store::check_format(file, kSequenceFormat);
    const std::uint64_t complete = store::frames_complete(file);
    return {std::move(file), finished, complete};
  }

  /// Of one of "coarse" and "fine". With hdf5::lock().
  Eigen::Index vertices(const hdf5::File& file, const std::string& which) const {
    if (!has_meshes(file)) return (which == "coarse" ? master.topology.coarse : master.topology.fine).vertex_count();
    return static_cast<Eigen::Index>(file.extents("/topology/" + which + "/rest_positions", 2, 3 * kMaxVertices)[0]);
  }
  static bool has_meshes(const hdf5::File& file) { return file.exists("/topology"); }
  std::vector<Positions> positions(const std::string& sequence, const std::string& which, std::uint64_t first,
                                   std::uint64_t last) const {
    const auto lock = hdf5::lock();
    const Opened opened = open(sequence);
    store::check_range(opened.file, first, last, opened.complete);
    return store::read_positions(opened.file, "/" + which + "/positions", vertices(opened.file, which), first, last);
  }
};

DatasetReader::DatasetReader(const std::filesystem::path& folder) : state_(std::make_shared<State>()) {
  state_->folder = folder;
  const auto lock = hdf5::lock();
  const hdf5::File file = hdf5::File::open(folder / "dataset.h5", false);
  store::check_format(file, kDatasetFormat);
  DatasetMaster& master = state_->master;
  master.time_step_s = file.number_attribute("/", "time_step_s");
  master.frame_time_s = file.number_attribute("/", "frame_time_s");
  master.seed = file.integer_attribute("/", "seed");
  // Files from before there was a choice are of tracked simulations.
  master.tracked = !file.has_attribute("/", "fine") || file.string_attribute("/", "fine") == "tracked";
  master.git_revision = file.string_attribute("/", "git_revision");
  if (file.has_attribute("/", "material")) master.material = file.string_attribute("/", "material");
  master.topology = store::read_topologies(file);
  if (file.exists("/normalization/minimum")) {
    ChannelRanges ranges;
    for (const auto& [name, values] :
         {std::pair{"/normalization/minimum", &ranges.offset}, std::pair{"/normalization/maximum", &ranges.scale}}) {
      if (file.extents(name, 1, kFrameChannels)[0] != kFrameChannels) {
        throw_data_loss(file.path().string() + ": " + name + " should have " + std::to_string(kFrameChannels) +
                        " values");
      }
      values->resize(kFrameChannels);
      file.rows(name).read(H5T_NATIVE_FLOAT, 0, kFrameChannels, values->data());
    }
    for (std::size_t c = 0; c < ranges.channels(); ++c) ranges.scale[c] -= ranges.offset[c];
    master.normalization = std::move(ranges);
  }
  master.sequences = file.list("/sequences");
  for (const std::string& name : master.sequences) {
    try {
      check_name(name);
    } catch (const Error& error) {
      throw_data_loss(file.path().string() + ": " + error.what());
    }
  }
}

DatasetReader::~DatasetReader() = default;

const DatasetMaster& DatasetReader::master() const { return state_->master; }
const std::filesystem::path& DatasetReader::folder() const { return state_->folder; }

std::vector<SequenceInfo> DatasetReader::sequences() const {
  return sequences([](const std::string&, const Error& error) { throw error; });
}

std::vector<SequenceInfo> DatasetReader::sequences(
    const std::function<void(const std::string&, const Error&)>& damaged) const {
  std::vector<SequenceInfo> infos;
  for (const std::string& name : state_->master.sequences) {
    const std::filesystem::path path = sequence_path(state_->folder, name);
    std::error_code error;
    if (!std::filesystem::exists(path, error) && !std::filesystem::exists(path.string() + ".partial", error)) continue;
    try {
      const auto lock = hdf5::lock();
      const State::Opened opened = state_->open(name);
      SequenceInfo info;
      info.name = name;
      info.split = opened.file.string_attribute("/", "split");
      info.scene = opened.file.string_attribute("/", "scene");
      info.frames = opened.file.integer_attribute("/", "frames");
      info.topology_hash = opened.file.string_attribute("/", "topology_hash");
      info.frames_complete = opened.complete;
      info.finished = opened.finished;
      info.own_meshes = State::has_meshes(opened.file);
      info.obstacles = store::read_obstacle_shapes(opened.file).shapes;
      infos.push_back(std::move(info));
    } catch (const Error& cause) {
      damaged(name, cause);
    }
  }
  return infos;
}

std::vector<Positions> DatasetReader::coarse(const std::string& sequence, std::uint64_t first,
                                             std::uint64_t last) const {
  return state_->positions(sequence, "coarse", first, last);
}

std::vector<Positions> DatasetReader::fine(const std::string& sequence, std::uint64_t first, std::uint64_t last) const {
  return state_->positions(sequence, "fine", first, last);
}

std::shared_ptr<const MeshPair> DatasetReader::meshes(const std::string& sequence) const {
  const auto lock = hdf5::lock();
  const State::Opened opened = state_->open(sequence);
  if (!State::has_meshes(opened.file)) return {state_, &state_->master.topology};
  auto meshes = std::make_shared<MeshPair>(store::read_topologies(opened.file));
  const std::string hash = opened.file.string_attribute("/", "topology_hash");
  if (topology_hash(meshes->fine) != hash) {
    throw_data_loss(opened.file.path().string() + ": its meshes are not those of topology_hash " + hash);
  }
  return meshes;
}

std::vector<double> DatasetReader::times(const std::string& sequence, std::uint64_t first, std::uint64_t last) const {
  const auto lock = hdf5::lock();
  const State::Opened opened = state_->open(sequence);
  store::check_range(opened.file, first, last, opened.complete);
  return read_times(opened.file, first, last);
}

std::vector<std::vector<ObstacleFrame>> DatasetReader::obstacles(const std::string& sequence, std::uint64_t first,
                                                                 std::uint64_t last) const {
  const auto lock = hdf5::lock();
  const State::Opened opened = state_->open(sequence);
  store::check_range(opened.file, first, last, opened.complete);
  return store::read_obstacles(opened.file, store::read_obstacle_shapes(opened.file), first, last);
}

}  // namespace pleat
