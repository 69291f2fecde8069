#include "services/presentation/input/sequence_input.hpp"

#include <optional>
#include <system_error>
#include <utility>

#include "common/base/error.hpp"
#include "common/mesh/animated_mesh.hpp"
#include "common/mesh/garment.hpp"
#include "common/mesh/mesh_file.hpp"
#include "common/store/dataset.hpp"
#include "common/store/hdf5.hpp"
#include "common/store/result.hpp"
#include "services/presentation/input/numbered_files.hpp"
#include "services/presentation/input/point_sequence.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

void check_finite(const Positions& positions, const std::string& what) {
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    if (!positions.row(v).allFinite())
      throw_invalid_argument(what + ": vertex " + std::to_string(v) + " is not finite");
  }
}

void check_vertex_count(Eigen::Index count, const Topology& rest, const std::string& what) {
  if (count != rest.vertex_count())
    throw_invalid_argument(what + " has " + std::to_string(count) + " vertices, the rest mesh " +
                           std::to_string(rest.vertex_count()));
}

class MeshFiles final : public FrameSequence {
 public:
  MeshFiles(std::vector<fs::path> files, const Topology& rest) : files_(std::move(files)), rest_(rest) {
    positions(0);  // a wrong first frame is worth an error before services start
  }
  std::size_t frame_count() const override { return files_.size(); }
  Positions positions(std::size_t frame) const override { return read_mesh_frame(files_.at(frame), rest_); }

 private:
  std::vector<fs::path> files_;
  Topology rest_;
};

class Points final : public FrameSequence {
 public:
  Points(const std::string& source, const Topology& rest) : points_(open_points(source)) {
    check_vertex_count(points_->point_count(), rest, source);
  }
  std::size_t frame_count() const override { return points_->frame_count(); }
  Positions positions(std::size_t frame) const override { return points_->positions(frame); }
  double frame_time_s() const override { return points_->frame_time_s(); }
  std::string warning() const override { return points_->warning(); }

 private:
  std::unique_ptr<PointSequence> points_;
};

class AnimatedFile final : public FrameSequence {
 public:
  AnimatedFile(const fs::path& path, const Topology& rest) : frames_(path, rest) {}
  std::size_t frame_count() const override { return frames_.frame_count(); }
  Positions positions(std::size_t frame) const override { return frames_.positions(frame); }
  double frame_time_s() const override { return frames_.frame_time_s(); }

 private:
  MatchedFrames frames_;
};

class ResultSequence final : public FrameSequence {
 public:
  ResultSequence(const fs::path& path, const Topology& rest) : path_(path), reader_(path) {
    check_vertex_count(reader_.info().topology.coarse.vertex_count(), rest, path.string());
  }
  std::size_t frame_count() const override { return reader_.frames_complete(); }
  Positions positions(std::size_t frame) const override {
    Positions positions = std::move(reader_.coarse(frame, frame + 1).at(0));
    check_finite(positions, path_.string() + " frame " + std::to_string(frame));
    return positions;
  }
  std::vector<ObstacleShape> obstacle_shapes() const override { return reader_.info().obstacles; }
  std::vector<ObstacleFrame> obstacles(std::size_t frame) const override {
    return std::move(reader_.obstacles(frame, frame + 1).at(0));
  }
  double frame_time_s() const override { return reader_.info().frame_time_s; }

 private:
  fs::path path_;
  ResultReader reader_;
};

class DatasetSequence final : public FrameSequence {
 public:
  DatasetSequence(const fs::path& folder, const std::string& name, const Topology& rest)
      : reader_(folder), name_(name) {
    for (SequenceInfo& info : reader_.sequences())
      if (info.name == name) info_ = std::move(info);
    if (info_.name.empty()) throw_not_found(folder.string() + " has no sequence '" + name + "'");
    check_vertex_count(reader_.meshes(name)->coarse.vertex_count(), rest, folder.string());
  }
  std::size_t frame_count() const override { return info_.frames_complete; }
  Positions positions(std::size_t frame) const override {
    Positions positions = std::move(reader_.coarse(name_, frame, frame + 1).at(0));
    check_finite(positions, "sequence " + name_ + " frame " + std::to_string(frame));
    return positions;
  }
  std::vector<ObstacleShape> obstacle_shapes() const override { return info_.obstacles; }
  std::vector<ObstacleFrame> obstacles(std::size_t frame) const override {
    return std::move(reader_.obstacles(name_, frame, frame + 1).at(0));
  }
  double frame_time_s() const override { return reader_.master().frame_time_s; }

 private:
  DatasetReader reader_;
  std::string name_;
  SequenceInfo info_;
};

/// Whether the file says that it is a result of ours, finished or not.
bool is_result(const fs::path& path) {
  if (lower_extension(path) == ".partial") return true;
  const auto lock = hdf5::lock();
  return hdf5::File::open(path, false).has_attribute("/", "format");
}

/// The data set and the name of the sequence that the file is one of.
std::optional<std::pair<fs::path, std::string>> sequence_of_dataset(const fs::path& path) {
  const fs::path folder = fs::absolute(path).parent_path();
  std::error_code ignored;
  if (folder.filename() != "sequences" || !fs::exists(folder.parent_path() / "dataset.h5", ignored))
    return std::nullopt;
  fs::path name = path.filename();
  if (lower_extension(path) == ".partial") name = name.stem();
  return std::pair(folder.parent_path(), name.stem().string());
}

bool is_hdf5(const fs::path& path) {
  const std::string extension = lower_extension(path);
  return extension == ".h5" || extension == ".hdf5" || extension == ".partial";
}

}  // namespace

std::unique_ptr<FrameSequence> open_frame_sequence(const std::vector<std::string>& sources, const Topology& rest) {
  if (sources.size() > 1) return std::make_unique<MeshFiles>(numbered_files(sources), rest);
  return open_frame_sequence(sources.empty() ? "" : sources[0], rest);
}

RestMesh rest_of_frames(const std::vector<std::string>& sources, double scale, std::vector<std::string>& notes) {
  if (sources.empty()) throw_invalid_argument("no frames given");
  const fs::path path = sources[0];
  std::error_code ignored;
  const bool is_file = fs::is_regular_file(path, ignored);
  const auto read = [&](const fs::path& mesh) -> RestMesh {
    Topology garment = read_mesh(mesh, MeshUse::kGarment);
    if (garment.uv_faces.rows() == 0)
      throw_invalid_argument(mesh.string() + ": no material coordinates; name the garment by --rest");
    return {mesh.string(), made_garment(std::move(garment), mesh.string(), notes, scale)};
  };
  if (sources.size() > 1) return read(numbered_files(sources)[0]);
  if (is_file && is_hdf5(path)) {
    if (const auto sequence = sequence_of_dataset(path))
      return {sources[0],
              made_garment(DatasetReader(sequence->first).meshes(sequence->second)->coarse, sources[0], notes, scale)};
    if (is_result(path))
      return {sources[0], made_garment(ResultReader(path).info().topology.coarse, sources[0], notes, scale)};
  }
  if (is_mesh_file(path) || !is_point_sequence(sources[0])) return read(is_file ? path : numbered_files(sources[0])[0]);
  if (!fs::exists(path, ignored) && path.string().find(':') == std::string::npos)
    throw_not_found(sources[0] + ": no such file");
  const fs::path beside = fs::path(path).replace_extension(".obj");
  if (fs::is_regular_file(beside, ignored)) return read(beside);
  throw_invalid_argument(sources[0] + ": points without faces, and no " + beside.string() +
                         "; name the garment by --rest");
}

std::unique_ptr<FrameSequence> open_frame_sequence(const std::string& source, const Topology& rest) {
  if (source.empty()) throw_invalid_argument("no frames given");
  const fs::path path = source;
  std::error_code ignored;
  const bool is_folder = fs::is_directory(path, ignored);
  if (is_folder && fs::exists(path / "dataset.h5", ignored)) {
    throw_invalid_argument(source + ": a data set; name one of its sequences, " + source + "/sequences/NAME.h5");
  }
  if (!is_folder && fs::exists(path, ignored)) {
    if (is_animated_mesh_file(path)) return std::make_unique<AnimatedFile>(path, rest);
    if (is_mesh_file(path)) return std::make_unique<MeshFiles>(std::vector<fs::path>{path}, rest);
    if (is_hdf5(path)) {
      if (const auto sequence = sequence_of_dataset(path))
        return std::make_unique<DatasetSequence>(sequence->first, sequence->second, rest);
      if (is_result(path)) return std::make_unique<ResultSequence>(path, rest);
    }
    if (is_point_sequence(source)) return std::make_unique<Points>(source, rest);
    throw_invalid_argument(source +
                           ": frames are read from .obj, .ply, .glb, .gltf, .fbx, .abc, .usda, .pc2, .mdd, .npy, .h5 "
                           "and folders of meshes");
  }
  if (!is_folder && is_point_sequence(source)) return std::make_unique<Points>(source, rest);
  return std::make_unique<MeshFiles>(numbered_files(source), rest);
}

}  // namespace pleat::presentation
