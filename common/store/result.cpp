#include "common/store/result.hpp"

#include <algorithm>
#include <sstream>

#include "common/store/hdf5.hpp"
#include "common/store/recording.hpp"

namespace pleat {
namespace {

constexpr const char* kResultFormat = "pleat.result";

store::Recording::Plan result_plan(const std::filesystem::path& path, const ResultOptions& options, bool resume) {
  validate_topology(options.topology.coarse, "the coarse mesh");
  validate_topology(options.topology.fine, "the fine mesh");
  store::Recording::Plan plan;
  plan.path = path;
  plan.frames = options.frames;
  plan.resume = resume;
  plan.deflate = options.deflate;
  using Type = store::Array::Type;
  const std::vector<hsize_t> fine_row = {static_cast<hsize_t>(options.topology.fine.vertex_count()), 3};
  // Small arrays first, as in data sets.
  plan.arrays = {{"/time_s", Type::kDouble, {}, false}};
  for (const std::string& stage : options.stages) {
    plan.arrays.push_back({"/stages/" + stage + "/ms", Type::kFloat, {}, false});
  }
  for (const std::string& name : options.counts) plan.arrays.push_back({"/counts/" + name, Type::kUint32, {}, false});
  const auto obstacles = store::obstacle_arrays(options.obstacles, options.obstacle_vertices);
  plan.arrays.insert(plan.arrays.end(), obstacles.begin(), obstacles.end());
  plan.arrays.push_back(
      {"/coarse/positions", Type::kFloat, {static_cast<hsize_t>(options.topology.coarse.vertex_count()), 3}, true});
  plan.arrays.push_back({"/enhanced/positions", Type::kFloat, fine_row, true});
  if (options.has_fine) plan.arrays.push_back({"/fine/positions", Type::kFloat, fine_row, true});
  std::ostringstream key;
  key << topology_hash(options.topology.coarse) << topology_hash(options.topology.fine) << '\n'
      << options.frames << '\n'
      << options.frame_time_s << '\n'
      << options.model << '\n'
      << options.scene << '\n';
  for (const store::Array& array : plan.arrays) {
    key << array.name;
    for (const hsize_t extent : array.row) key << ' ' << extent;
    key << '\n';
  }
  plan.fingerprint = store::fingerprint(key.str());
  plan.write_header = [options](hdf5::File& file) {
    file.set_attribute("/", "format", std::string(kResultFormat));
    file.set_attribute("/", "version", std::uint64_t{kStoreVersion});
    file.set_attribute("/", "units", std::string("m, s, Y up"));
    file.set_attribute("/", "frame_time_s", options.frame_time_s);
    file.set_attribute("/", "model", options.model);
    file.set_attribute("/", "scene", options.scene);
    store::write_topologies(file, options.topology);
    store::write_obstacle_shapes(file, options.obstacles);
  };
  return plan;
}

void check_rows(Eigen::Index given, Eigen::Index planned, const char* what) {
  if (given != planned) {
    throw_invalid_argument(std::string(what) + ": " + std::to_string(given) + " vertices given, " +
                           std::to_string(planned) + " planned");
  }
}

}  // namespace

struct ResultWriter::State {
  ResultOptions options;
  store::Recording recording;
};

ResultWriter::ResultWriter(const std::filesystem::path& path, const ResultOptions& options, bool resume)
    : state_(std::make_unique<State>(State{options, store::Recording(result_plan(path, options, resume))})) {}
ResultWriter::~ResultWriter() = default;
ResultWriter::ResultWriter(ResultWriter&&) noexcept = default;
ResultWriter& ResultWriter::operator=(ResultWriter&&) noexcept = default;

std::uint64_t ResultWriter::frames_complete() const { return state_->recording.frames_complete(); }

void ResultWriter::append(const ResultFrame& frame) {
  const ResultOptions& options = state_->options;
  const Eigen::Index fine_vertices = options.topology.fine.vertex_count();
  check_rows(frame.coarse.rows(), options.topology.coarse.vertex_count(), "coarse");
  check_rows(frame.enhanced.rows(), fine_vertices, "enhanced");
  if (options.has_fine) check_rows(frame.fine.rows(), fine_vertices, "fine");
  if (frame.stages_ms.size() != options.stages.size() || frame.counts.size() != options.counts.size()) {
    throw_invalid_argument("a result frame needs " + std::to_string(options.stages.size()) + " stage times and " +
                           std::to_string(options.counts.size()) + " counts");
  }
  std::vector<const void*> rows = {&frame.time_s};
  for (const float& ms : frame.stages_ms) rows.push_back(&ms);
  for (const std::uint32_t& count : frame.counts) rows.push_back(&count);
  const auto obstacles = store::obstacle_rows(options.obstacles, options.obstacle_vertices, frame.obstacles);
  rows.insert(rows.end(), obstacles.begin(), obstacles.end());
  rows.push_back(frame.coarse.data());
  rows.push_back(frame.enhanced.data());
  if (options.has_fine) rows.push_back(frame.fine.data());
  state_->recording.append(rows);
}

void ResultWriter::finish() { state_->recording.finish(); }

struct ResultReader::State {
  explicit State(hdf5::File opened) : file(std::move(opened)) {}
  ~State() {
    const auto lock = hdf5::lock();
    hdf5::File closing = std::move(file);
  }
  hdf5::File file;
  ResultOptions info;
  store::ObstacleTable obstacles;

  template <typename T>
  std::vector<T> column(const std::string& name, hid_t type, std::uint64_t first, std::uint64_t last) const {
    store::check_range(file, first, last, info.frames);
    file.extents(name, 1, kMaxFrames);
    std::vector<T> values(last - first);
    file.rows(name).read(type, first, values.size(), values.data());
    return values;
  }
};

ResultReader::ResultReader(const std::filesystem::path& path, FileOrigin origin) {
  const auto lock = hdf5::lock();
  state_ = std::make_unique<State>(origin == FileOrigin::kOwn ? hdf5::File::open_own(path, false)
                                                              : hdf5::File::open(path, false));
  const hdf5::File& file = state_->file;
  store::check_format(file, kResultFormat);
  ResultOptions& info = state_->info;
  info.topology = store::read_topologies(file);
  info.frames = store::frames_complete(file);
  info.frame_time_s = file.number_attribute("/", "frame_time_s");
  info.model = file.string_attribute("/", "model");
  info.scene = file.string_attribute("/", "scene");
  info.has_fine = file.is_array("/fine/positions");
  state_->obstacles = store::read_obstacle_shapes(file);
  info.obstacles = state_->obstacles.shapes;
  info.obstacle_vertices = state_->obstacles.vertices;
  info.stages = file.list("/stages");
  info.counts = file.list("/counts");
}

ResultReader::~ResultReader() = default;

const ResultOptions& ResultReader::info() const { return state_->info; }

std::vector<Positions> ResultReader::coarse(std::uint64_t first, std::uint64_t last) const {
  const auto lock = hdf5::lock();
  store::check_range(state_->file, first, last, state_->info.frames);
  return store::read_positions(state_->file, "/coarse/positions", info().topology.coarse.vertex_count(), first, last);
}

std::vector<Positions> ResultReader::enhanced(std::uint64_t first, std::uint64_t last) const {
  const auto lock = hdf5::lock();
  store::check_range(state_->file, first, last, state_->info.frames);
  return store::read_positions(state_->file, "/enhanced/positions", info().topology.fine.vertex_count(), first, last);
}

std::vector<Positions> ResultReader::fine(std::uint64_t first, std::uint64_t last) const {
  const auto lock = hdf5::lock();
  if (!info().has_fine) {
    throw Error(ErrorCode::kFailedPrecondition, state_->file.path().string() + ": has no simulated fine frames");
  }
  store::check_range(state_->file, first, last, state_->info.frames);
  return store::read_positions(state_->file, "/fine/positions", info().topology.fine.vertex_count(), first, last);
}

std::vector<double> ResultReader::times(std::uint64_t first, std::uint64_t last) const {
  const auto lock = hdf5::lock();
  return state_->column<double>("/time_s", H5T_NATIVE_DOUBLE, first, last);
}

std::vector<std::vector<ObstacleFrame>> ResultReader::obstacles(std::uint64_t first, std::uint64_t last) const {
  const auto lock = hdf5::lock();
  store::check_range(state_->file, first, last, state_->info.frames);
  return store::read_obstacles(state_->file, state_->obstacles, first, last);
}

std::vector<float> ResultReader::stage_ms(const std::string& stage, std::uint64_t first, std::uint64_t last) const {
  const auto lock = hdf5::lock();
  return state_->column<float>("/stages/" + stage + "/ms", H5T_NATIVE_FLOAT, first, last);
}

std::vector<std::uint32_t> ResultReader::counts(const std::string& name, std::uint64_t first,
                                                std::uint64_t last) const {
  const auto lock = hdf5::lock();
  return state_->column<std::uint32_t>("/counts/" + name, H5T_NATIVE_UINT32, first, last);
}

}  // namespace pleat
