#include "common/store/recording.hpp"

#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <cerrno>
#include <numeric>

#include "common/base/hash.hpp"
#include "common/base/own_file.hpp"

namespace pleat::store {
namespace {

hid_t memory_type(Array::Type type) {
  switch (type) {
    case Array::Type::kFloat:
      return H5T_NATIVE_FLOAT;
    case Array::Type::kDouble:
      return H5T_NATIVE_DOUBLE;
    case Array::Type::kUint32:
      return H5T_NATIVE_UINT32;
  }
  throw_internal("unknown array type");
}

std::size_t value_size(Array::Type type) { return type == Array::Type::kDouble ? 8 : 4; }

std::size_t row_bytes(const Array& array) {
  return std::accumulate(array.row.begin(), array.row.end(), value_size(array.type), std::multiplies<>());
}

std::uint32_t crc32_of(const void* data, std::size_t bytes) {
  return static_cast<std::uint32_t>(::crc32_z(0, static_cast<const Bytef*>(data), bytes));
}

constexpr const char* kChecksum = "crc32";

/// Where the checksums of the rows of `array` are.
std::string checksums_of(const std::string& array) { return "/checksums" + array; }

void check_row(const hdf5::File& file, const std::string& name, std::uint64_t row, const void* data, std::size_t bytes,
               std::uint32_t expected) {
  if (crc32_of(data, bytes) == expected) return;
  throw_data_loss(file.path().string() + ": damaged: frame " + std::to_string(row) + " of " + name +
                  " does not match its checksum");
}

template <typename Matrix>
void write_matrix(hdf5::File& file, const std::string& name, hid_t type, const Matrix& matrix) {
  file.write_array(name, type, {static_cast<hsize_t>(matrix.rows()), static_cast<hsize_t>(matrix.cols())},
                   matrix.data());
  const auto bytes = static_cast<std::size_t>(matrix.size()) * sizeof(typename Matrix::Scalar);
  file.set_attribute(name, kChecksum, std::uint64_t{crc32_of(matrix.data(), bytes)});
}

template <typename Matrix>
Matrix read_matrix(const hdf5::File& file, const std::string& name, hid_t type, hsize_t max_rows) {
  const auto extents = file.extents(name, 2, max_rows * Matrix::ColsAtCompileTime);
  if (extents[1] != static_cast<hsize_t>(Matrix::ColsAtCompileTime)) {
    throw_data_loss(file.path().string() + ": " + name + " should have " +
                    std::to_string(int{Matrix::ColsAtCompileTime}) + " columns");
  }
  Matrix matrix(static_cast<Eigen::Index>(extents[0]), static_cast<Eigen::Index>(Matrix::ColsAtCompileTime));
  file.rows(name).read(type, 0, extents[0], matrix.data());
  const auto bytes = static_cast<std::size_t>(matrix.size()) * sizeof(typename Matrix::Scalar);
  if (file.has_attribute(name, kChecksum) &&
      file.integer_attribute(name, kChecksum) != crc32_of(matrix.data(), bytes)) {
    throw_data_loss(file.path().string() + ": damaged: " + name + " does not match its checksum");
  }
  return matrix;
}

void write_topology(hdf5::File& file, const std::string& group, const Topology& topology) {
  write_matrix(file, group + "/rest_positions", H5T_NATIVE_FLOAT, topology.rest_positions);
  write_matrix(file, group + "/faces", H5T_NATIVE_UINT32, topology.faces);
  write_matrix(file, group + "/uv", H5T_NATIVE_FLOAT, topology.uv);
  write_matrix(file, group + "/uv_faces", H5T_NATIVE_UINT32, topology.uv_faces);
}

Topology read_topology(const hdf5::File& file, const std::string& group) {
  Topology topology;
  topology.rest_positions = read_matrix<Positions>(file, group + "/rest_positions", H5T_NATIVE_FLOAT, kMaxVertices);
  topology.faces = read_matrix<Faces>(file, group + "/faces", H5T_NATIVE_UINT32, kMaxFaces);
  topology.uv = read_matrix<Uv>(file, group + "/uv", H5T_NATIVE_FLOAT, 3 * kMaxFaces);
  topology.uv_faces = read_matrix<Faces>(file, group + "/uv_faces", H5T_NATIVE_UINT32, kMaxFaces);
  try {
    validate_topology(topology, group);
  } catch (const Error& error) {
    throw_data_loss(file.path().string() + ": " + error.what());
  }
  return topology;
}

}  // namespace

void write_topologies(hdf5::File& file, const MeshPair& topology) {
  write_topology(file, "/topology/coarse", topology.coarse);
  write_topology(file, "/topology/fine", topology.fine);
  file.write_array("/topology/feature_vertices", H5T_NATIVE_UINT32, {topology.feature_vertices.size()},
                   topology.feature_vertices.data());
}

MeshPair read_topologies(const hdf5::File& file) {
  MeshPair pair;
  pair.coarse = read_topology(file, "/topology/coarse");
  pair.fine = read_topology(file, "/topology/fine");
  const std::string name = "/topology/feature_vertices";
  pair.feature_vertices.resize(file.extents(name, 1, kMaxVertices)[0]);
  file.rows(name).read(H5T_NATIVE_UINT32, 0, pair.feature_vertices.size(), pair.feature_vertices.data());
  if (!pair.feature_vertices.empty() &&
      pair.feature_vertices.size() != static_cast<std::size_t>(pair.coarse.vertex_count())) {
    throw_data_loss(file.path().string() + ": " + name + " should have one entry per coarse vertex");
  }
  for (const std::uint32_t vertex : pair.feature_vertices) {
    if (vertex >= static_cast<std::uint64_t>(pair.fine.vertex_count())) {
      throw_data_loss(file.path().string() + ": " + name + " has " + std::to_string(vertex) + ", out of range");
    }
  }
  return pair;
}

void check_format(const hdf5::File& file, const std::string& format) {
  if (!file.has_attribute("/", "format") || file.string_attribute("/", "format") != format) {
    throw_invalid_argument(file.path().string() + ": not a " + format + " file");
  }
  const std::uint64_t version = file.integer_attribute("/", "version");
  if (version != kStoreVersion) {
    throw_invalid_argument(file.path().string() + ": version " + std::to_string(version) + " of " + format +
                           ", this program reads " + std::to_string(kStoreVersion));
  }
}

std::vector<Array> obstacle_arrays(const std::vector<ObstacleShape>& shapes,
                                   const std::vector<Eigen::Index>& vertices) {
  if (shapes.size() != vertices.size()) throw_invalid_argument("obstacles: one vertex count per obstacle is needed");
  std::vector<Array> arrays;
  for (std::size_t i = 0; i < shapes.size(); ++i) {
    if (shapes[i].name.empty() || shapes[i].name.find('/') != std::string::npos || shapes[i].name == ".") {
      throw_invalid_argument("obstacle name '" + shapes[i].name + "' can't be stored");
    }
    const std::string group = "/obstacles/" + shapes[i].name;
    if (shapes[i].capsules > 0) {
      arrays.push_back({group + "/capsule_ends", Array::Type::kFloat, {shapes[i].capsules, 2, 3}, false});
      arrays.push_back({group + "/capsule_radii", Array::Type::kFloat, {shapes[i].capsules}, false});
    } else if (shapes[i].faces.rows() == 0) {
      arrays.push_back({group + "/center", Array::Type::kFloat, {3}, false});
      arrays.push_back({group + "/radius", Array::Type::kFloat, {}, false});
    } else {
      if (vertices[i] <= 0) throw_invalid_argument("obstacle " + shapes[i].name + " has faces but no vertices");
      arrays.push_back({group + "/positions", Array::Type::kFloat, {static_cast<hsize_t>(vertices[i]), 3}, true});
    }
  }
  return arrays;
}

std::vector<const void*> obstacle_rows(const std::vector<ObstacleShape>& shapes,
                                       const std::vector<Eigen::Index>& vertices,
                                       const std::vector<ObstacleFrame>& frames) {
  if (frames.size() != shapes.size()) {
    throw_invalid_argument("obstacles: " + std::to_string(frames.size()) + " given, " + std::to_string(shapes.size()) +
                           " planned");
  }
  std::vector<const void*> rows;
  for (std::size_t i = 0; i < shapes.size(); ++i) {
    if (frames[i].name != shapes[i].name) {
      throw_invalid_argument("obstacle " + frames[i].name + " given where " + shapes[i].name + " is planned");
    }
    if (shapes[i].capsules > 0) {
      if (frames[i].capsule_radii.size() != shapes[i].capsules ||
          frames[i].capsule_ends.rows() != 2 * static_cast<Eigen::Index>(shapes[i].capsules)) {
        throw_invalid_argument("obstacle " + shapes[i].name + ": " + std::to_string(frames[i].capsule_radii.size()) +
                               " capsules given, " + std::to_string(shapes[i].capsules) + " planned");
      }
      rows.push_back(frames[i].capsule_ends.data());
      rows.push_back(frames[i].capsule_radii.data());
    } else if (shapes[i].faces.rows() == 0) {
      rows.push_back(frames[i].center.data());
      rows.push_back(&frames[i].radius);
    } else {
      if (frames[i].positions.rows() != vertices[i]) {
        throw_invalid_argument("obstacle " + shapes[i].name + ": " + std::to_string(frames[i].positions.rows()) +
                               " vertices given, " + std::to_string(vertices[i]) + " planned");
      }
      rows.push_back(frames[i].positions.data());
    }
  }
  return rows;
}

void write_obstacle_shapes(hdf5::File& file, const std::vector<ObstacleShape>& shapes) {
  for (std::size_t i = 0; i < shapes.size(); ++i) {
    const std::string group = "/obstacles/" + shapes[i].name;
    file.make_group(group);
    file.set_attribute(group, "order", static_cast<std::uint64_t>(i));
    if (shapes[i].faces.rows() > 0) write_matrix(file, group + "/faces", H5T_NATIVE_UINT32, shapes[i].faces);
  }
}

ObstacleTable read_obstacle_shapes(const hdf5::File& file) {
  const std::vector<std::string> names = file.list("/obstacles");
  ObstacleTable table;
  table.shapes.resize(names.size());
  table.vertices.resize(names.size());
  for (const std::string& name : names) {
    const std::string group = "/obstacles/" + name;
    const std::uint64_t order = file.integer_attribute(group, "order");
    if (order >= names.size() || !table.shapes[order].name.empty()) {
      throw_data_loss(file.path().string() + ": " + group + " has a wrong `order`");
    }
    table.shapes[order].name = name;
    if (file.is_array(group + "/capsule_radii")) {
      const auto extents = file.extents(group + "/capsule_radii", 2, kMaxFrames * kMaxCapsules);
      const auto ends = file.extents(group + "/capsule_ends", 4, 6 * kMaxFrames * kMaxCapsules);
      if (extents[1] == 0 || extents[1] > kMaxCapsules || ends[1] != extents[1] || ends[2] != 2 || ends[3] != 3) {
        throw_data_loss(file.path().string() + ": " + group + " has ends that do not fit its radii");
      }
      table.shapes[order].capsules = static_cast<std::uint32_t>(extents[1]);
    }
    if (!file.is_array(group + "/faces")) continue;
    const Faces faces = read_matrix<Faces>(file, group + "/faces", H5T_NATIVE_UINT32, kMaxFaces);
    const auto extents = file.extents(group + "/positions", 3, kMaxFrames * kMaxVertices);
    if (extents[2] != 3 || extents[1] == 0 || extents[1] > kMaxVertices ||
        (faces.rows() > 0 && faces.maxCoeff() >= extents[1])) {
      throw_data_loss(file.path().string() + ": " + group + " has faces that do not fit its positions");
    }
    table.shapes[order].faces = faces;
    table.vertices[order] = static_cast<Eigen::Index>(extents[1]);
  }
  return table;
}

std::vector<std::vector<ObstacleFrame>> read_obstacles(const hdf5::File& file, const ObstacleTable& table,
                                                       std::uint64_t first, std::uint64_t last) {
  std::vector<std::vector<ObstacleFrame>> frames(last - first, std::vector<ObstacleFrame>(table.shapes.size()));
  for (std::size_t i = 0; i < table.shapes.size(); ++i) {
    const std::string group = "/obstacles/" + table.shapes[i].name;
    for (auto& frame : frames) frame[i].name = table.shapes[i].name;
    if (table.vertices[i] > 0) {
      auto positions = read_positions(file, group + "/positions", table.vertices[i], first, last);
      for (std::size_t k = 0; k < frames.size(); ++k) frames[k][i].positions = std::move(positions[k]);
      continue;
    }
    if (const Eigen::Index capsules = table.shapes[i].capsules; capsules > 0) {
      const hdf5::Rows ends = file.rows(group + "/capsule_ends"), radii = file.rows(group + "/capsule_radii");
      for (std::size_t k = 0; k < frames.size(); ++k) {
        ObstacleFrame& frame = frames[k][i];
        frame.capsule_ends.resize(2 * capsules, 3);
        frame.capsule_radii.resize(static_cast<std::size_t>(capsules));
        ends.read(H5T_NATIVE_FLOAT, first + k, 1, frame.capsule_ends.data());
        radii.read(H5T_NATIVE_FLOAT, first + k, 1, frame.capsule_radii.data());
      }
      continue;
    }
    if (file.extents(group + "/center", 2, 3 * kMaxFrames)[1] != 3) {
      throw_data_loss(file.path().string() + ": " + group + "/center should have 3 columns");
    }
    file.extents(group + "/radius", 1, kMaxFrames);
    std::vector<float> centers(3 * frames.size()), radii(frames.size());
    file.rows(group + "/center").read(H5T_NATIVE_FLOAT, first, frames.size(), centers.data());
    file.rows(group + "/radius").read(H5T_NATIVE_FLOAT, first, frames.size(), radii.data());
    for (std::size_t k = 0; k < frames.size(); ++k) {
      frames[k][i].center = Eigen::Map<const Eigen::Vector3f>(centers.data() + 3 * k);
      frames[k][i].radius = radii[k];
    }
  }
  return frames;
}

std::vector<Positions> read_positions(const hdf5::File& file, const std::string& name, Eigen::Index vertices,
                                      std::uint64_t first, std::uint64_t last) {
  const auto extents = file.extents(name, 3, kMaxFrames * kMaxVertices);
  if (extents[1] != static_cast<hsize_t>(vertices) || extents[2] != 3) {
    throw_data_loss(file.path().string() + ": " + name + " has " + std::to_string(extents[1]) + " vertices, " +
                    std::to_string(vertices) + " expected");
  }
  const hdf5::Rows rows = file.rows(name);
  std::vector<std::uint32_t> checksums;  // not in older files
  if (file.is_array(checksums_of(name))) {
    file.extents(checksums_of(name), 1, kMaxFrames);
    checksums.resize(last - first);
    file.rows(checksums_of(name)).read(H5T_NATIVE_UINT32, first, checksums.size(), checksums.data());
  }
  std::vector<Positions> frames;
  for (std::uint64_t k = first; k < last; ++k) {
    Positions& frame = frames.emplace_back(vertices, 3);
    rows.read(H5T_NATIVE_FLOAT, k, 1, frame.data());
    if (checksums.empty()) continue;
    const auto bytes = static_cast<std::size_t>(frame.size()) * sizeof(float);
    check_row(file, name, k, frame.data(), bytes, checksums[k - first]);
  }
  return frames;
}

std::uint64_t frames_complete(const hdf5::File& file) {
  const std::uint64_t complete = file.integer_attribute("/", "frames_complete");
  const hsize_t rows = file.extents("/time_s", 1, kMaxFrames)[0];
  if (complete <= rows) return complete;
  throw_data_loss(file.path().string() + ": damaged: " + std::to_string(complete) +
                  " frames should be complete, it has " + std::to_string(rows));
}

void check_range(const hdf5::File& file, std::uint64_t first, std::uint64_t last, std::uint64_t complete) {
  if (first > last || last > complete) {
    throw_invalid_argument(file.path().string() + ": frames " + std::to_string(first) + " to " + std::to_string(last) +
                           " asked for, " + std::to_string(complete) + " are complete");
  }
}

std::string fingerprint(const std::string& text) { return Hash().add(text).hex(); }

Recording::Recording(Plan plan) : plan_(std::move(plan)), partial_(plan_.path.string() + ".partial") {
  if (plan_.frames == 0 || plan_.frames > kMaxFrames) {
    throw_invalid_argument(plan_.path.string() + ": " + std::to_string(plan_.frames) + " frames can't be recorded");
  }
  if (plan_.path.has_parent_path()) {
    std::error_code error;
    std::filesystem::create_directories(plan_.path.parent_path(), error);
    if (error) {
      throw_invalid_argument(plan_.path.parent_path().string() + ": can't be made (" + error.message() + ")");
    }
  }
  const auto lock = hdf5::lock();
  require_absent_or(hdf5::is_own(plan_.path), plan_.path);
  const bool own = hdf5::is_own(partial_);
  if (own) lock_ = std::make_unique<FileLock>(partial_);
  if (!plan_.resume || !try_resume()) {
    // Made under another name first: a .partial is whole from its first moment.
    const std::filesystem::path fresh = partial_.string() + ".new";
    file_.emplace(hdf5::File::create(fresh));
    make(*file_, plan_.frames, false);
    file_->flush();
    if (!own) set_aside(partial_);
    lock_ = std::make_unique<FileLock>(fresh);
    file_->rename(partial_);
  }
  open_rows();
}

void Recording::open_rows() {
  for (const Array& array : plan_.arrays) {
    rows_.push_back(file_->rows(array.name));
    checksums_.push_back(array.large ? std::optional(file_->rows(checksums_of(array.name))) : std::nullopt);
  }
}

Recording::~Recording() {
  const auto lock = hdf5::lock();
  rows_.clear();
  checksums_.clear();
  file_.reset();
}

Recording::FileLock::FileLock(const std::filesystem::path& path) : descriptor(open(path.c_str(), O_RDWR | O_CLOEXEC)) {
  if (descriptor < 0) throw_not_found(path.string() + ": can't be opened");
  // Not flock(): readers that use HDF5's own locks, as h5py does, shall open the file while it grows.
  struct flock whole {};
  whole.l_type = F_WRLCK;
  whole.l_whence = SEEK_SET;
  // A network file system may have no locks: there the folder must have one writer (of shards: their leases).
  const auto has_none = [](int cause) { return cause == ENOLCK || cause == EOPNOTSUPP || cause == ENOSYS; };
  if (fcntl(descriptor, F_OFD_SETLK, &whole) != 0 && !has_none(errno)) {
    close(descriptor);
    throw Error(ErrorCode::kFailedPrecondition, path.string() + ": another writer has it open");
  }
}

Recording::FileLock::~FileLock() { close(descriptor); }

bool Recording::try_resume() {
  if (lock_ == nullptr) return false;  // there is no .partial
  try {
    hdf5::File file = hdf5::File::open(partial_, true);
    if (file.string_attribute("/", "fingerprint") != plan_.fingerprint) return false;
    const std::uint64_t complete = file.integer_attribute("/", "frames_complete");
    if (complete > plan_.frames) return false;
    for (const Array& array : plan_.arrays) {
      file.rows(array.name);
      if (array.large) file.rows(checksums_of(array.name));
    }
    frames_complete_ = complete;
    file_.emplace(std::move(file));
    return true;
  } catch (const Error&) {
    return false;  // not a recording that can be continued: it is made anew
  }
}

void Recording::make(hdf5::File& file, std::uint64_t frames, bool deflate) const {
  file.set_attribute("/", "frames_complete", std::uint64_t{0});
  plan_.write_header(file);
  file.set_attribute("/", "fingerprint", plan_.fingerprint);
  for (const Array& array : plan_.arrays) {
    if (array.large) file.make_rows(checksums_of(array.name), H5T_NATIVE_UINT32, {frames}, 1024, false);
  }
  for (const Array& array : plan_.arrays) {
    std::vector<hsize_t> extents = {frames};
    extents.insert(extents.end(), array.row.begin(), array.row.end());
    file.make_rows(array.name, memory_type(array.type), extents, array.large ? 1 : 1024, deflate && array.large);
  }
}

void Recording::append(const std::vector<const void*>& rows) {
  if (!file_.has_value()) throw Error(ErrorCode::kFailedPrecondition, plan_.path.string() + ": already finished");
  if (rows.size() != plan_.arrays.size()) throw_internal(plan_.path.string() + ": a row per array is needed");
  if (frames_complete_ >= plan_.frames) {
    throw_invalid_argument(plan_.path.string() + ": more than the planned " + std::to_string(plan_.frames) + " frames");
  }
  const auto lock = hdf5::lock();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    rows_[i].write(memory_type(plan_.arrays[i].type), frames_complete_, 1, rows[i]);
    if (!checksums_[i]) continue;
    const std::uint32_t checksum = crc32_of(rows[i], row_bytes(plan_.arrays[i]));
    checksums_[i]->write(H5T_NATIVE_UINT32, frames_complete_, 1, &checksum);
  }
  file_->set_attribute("/", "frames_complete", frames_complete_ + 1);
  file_->flush();
  ++frames_complete_;
}

void Recording::finish() {
  if (!file_.has_value()) return;
  const auto lock = hdf5::lock();
  if (plan_.deflate) {
    copy_compressed();
    return;
  }
  if (frames_complete_ < plan_.frames) {
    for (const Array& array : plan_.arrays) {
      file_->cut_rows(array.name, frames_complete_);
      if (array.large) file_->cut_rows(checksums_of(array.name), frames_complete_);
    }
  }
  rows_.clear();
  checksums_.clear();
  file_->close();
  file_->rename(plan_.path);
  file_.reset();
  lock_.reset();
}

void Recording::copy_compressed() {
  const std::filesystem::path packed = plan_.path.string() + ".packed.partial";
  hdf5::File copy = hdf5::File::create(packed);
  make(copy, frames_complete_, true);
  copy.flush();  // from here on it is known as ours if we are killed
  std::vector<char> row;
  for (std::size_t i = 0; i < plan_.arrays.size(); ++i) {
    const Array& array = plan_.arrays[i];
    row.resize(row_bytes(array));
    hdf5::Rows target = copy.rows(array.name);
    std::vector<std::uint32_t> checksums(checksums_[i] ? frames_complete_ : 0);
    if (!checksums.empty()) {
      checksums_[i]->read(H5T_NATIVE_UINT32, 0, checksums.size(), checksums.data());
      copy.rows(checksums_of(array.name)).write(H5T_NATIVE_UINT32, 0, checksums.size(), checksums.data());
    }
    for (std::uint64_t k = 0; k < frames_complete_; ++k) {
      rows_[i].read(memory_type(array.type), k, 1, row.data());
      if (checksums_[i]) check_row(*file_, array.name, k, row.data(), row.size(), checksums[k]);
      target.write(memory_type(array.type), k, 1, row.data());
    }
  }
  copy.set_attribute("/", "frames_complete", frames_complete_);
  copy.close();
  copy.rename(plan_.path);
  rows_.clear();
  checksums_.clear();
  file_.reset();
  std::filesystem::remove(partial_);
  lock_.reset();
}

}  // namespace pleat::store
