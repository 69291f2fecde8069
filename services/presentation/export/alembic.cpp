// Alembic in its Ogawa form: one PolyMesh whose points have a sample a frame. The container is groups of places in the
// file, and blocks of bytes; what an object or a property is, its parent's block of headers says.
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <map>

#include "common/base/hash.hpp"
#include "common/base/whole_file.hpp"
#include "services/presentation/export/own_export.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {
namespace {

static_assert(std::endian::native == std::endian::little,
              "the format is little-endian, and so is what is written here");

constexpr std::uint64_t kIsData = std::uint64_t{1} << 63, kEmptyGroup = 0, kEmptyData = kIsData;
constexpr std::int32_t kFileVersion = 0, kLibraryVersion = 10800;

template <class T>
std::string bytes_of(const T* values, std::size_t count) {
  return {reinterpret_cast<const char*>(values), count * sizeof(T)};
}
template <class T>
std::string bytes_of(T value) {
  return bytes_of(&value, 1);
}

/// Puts groups and blocks one behind the other.
class Container {
 public:
  explicit Container(const std::filesystem::path& path) : file_(path) {
    file_.write(std::string_view("Ogawa\xff\0\1", 8));
    file_.write(std::string(8, '\0'));  // the place of the root comes last
    at_ = 16;
  }

  std::uint64_t data(std::string_view bytes) {
    const std::uint64_t place = at_;
    put(bytes_of(std::uint64_t{bytes.size()}));
    put(bytes);
    return place | kIsData;
  }
  std::uint64_t group(const std::vector<std::uint64_t>& children) {
    const std::uint64_t place = at_;
    put(bytes_of(std::uint64_t{children.size()}));
    put(bytes_of(children.data(), children.size()));
    return place;
  }
  void finish(std::uint64_t root) {
    std::fseek(file_.stream(), 8, SEEK_SET);
    file_.write(bytes_of(root));
    file_.commit();
  }

 private:
  void put(std::string_view bytes) {
    file_.write(bytes);
    at_ += bytes.size();
  }
  WholeFile file_;
  std::uint64_t at_ = 0;
};

/// Names and types of numbers, by the format's own numbers.
enum Pod : std::uint32_t { kUint32 = 5, kInt32 = 6, kFloat32 = 10, kFloat64 = 11 };
enum Kind : std::uint32_t { kCompound = 0, kScalar = 1, kArray = 2 };

struct Property {
  std::string name, metadata;
  Kind kind = kCompound;
  Pod pod = kInt32;
  std::uint32_t extent = 1, samples = 1;
  std::vector<std::uint64_t> children;  ///< of its group
};

class Writer {
 public:
  Writer(const std::filesystem::path& path, const ExportInput& input) : container_(path), input_(input) {
    // First, where own_export looks for it.
    about_ = container_.data(std::string("_ai_Application=Pleat;_ai_Description=") + kAlembicMark +
                             ";_ai_AlembicVersion=Alembic 1.8.0");
  }

  void write(const FrameSource& frame) {
    const Topology& topology = input_.topology;
    const auto frames = static_cast<std::uint32_t>(input_.frame_count);
    Property bounds{".selfBnds", "interpretation=box", kScalar, kFloat64, 6, frames, {}};
    Property points{"P", "geoScope=vtx;interpretation=point", kArray, kFloat32, 3, frames, {}};
    for (std::size_t t = 0; t < input_.frame_count; ++t) {
      const Positions now = frame(t);
      std::array<double, 6> box{};
      for (int axis = 0; axis < 3; ++axis) {
        box[static_cast<std::size_t>(axis)] = static_cast<double>(now.col(axis).minCoeff());
        box[static_cast<std::size_t>(axis) + 3] = static_cast<double>(now.col(axis).maxCoeff());
      }
      bounds.children.push_back(sample(bytes_of(box.data(), box.size())));
      add_array(points, bytes_of(now.data(), static_cast<std::size_t>(now.size())));
    }
    // Faces are clockwise here.
    const Faces faces = topology.faces.rowwise().reverse(), uv_faces = topology.uv_faces.rowwise().reverse();
    Property corners{".faceIndices", "", kArray, kInt32, 1, 1, {}}, sizes{".faceCounts", "", kArray, kInt32, 1, 1, {}};
    add_array(corners, bytes_of(faces.data(), static_cast<std::size_t>(faces.size())));
    const std::vector<std::int32_t> threes(static_cast<std::size_t>(faces.rows()), 3);
    add_array(sizes, bytes_of(threes.data(), threes.size()));
    std::vector<Property> geometry{bounds, points, corners, sizes};
    if (topology.uv.rows() > 0) {
      Property values{".vals", "interpretation=vector", kArray, kFloat32, 2, 1, {}};
      Property indices{".indices", "", kArray, kUint32, 1, 1, {}};
      add_array(values, bytes_of(topology.uv.data(), static_cast<std::size_t>(topology.uv.size())));
      add_array(indices, bytes_of(uv_faces.data(), static_cast<std::size_t>(uv_faces.size())));
      geometry.push_back({"uv",
                          "arrayExtent=1;geoScope=fvr;interpretation=vector;isGeomParam=true;podExtent=2;"
                          "podName=float32_t",
                          kCompound, kFloat32, 2, 0, compound({values, indices})});
    }
    const Property schema{
        ".geom",           "schema=AbcGeom_PolyMesh_v1;schemaBaseType=AbcGeom_GeomBase_v1", kCompound, kFloat32, 0, 0,
        compound(geometry)};
    const std::uint64_t mesh =
        container_.group({container_.group(compound({schema})), container_.data(std::string(hashes(schema.name)))});
    std::string header = bytes_of(static_cast<std::uint32_t>(input_.name.size())) + input_.name;
    header += static_cast<char>(metadata_index("schema=AbcGeom_PolyMesh_v1;schemaObjTitle=AbcGeom_PolyMesh_v1:.geom"));
    const std::uint64_t top = container_.group({kEmptyGroup, mesh, container_.data(header + hashes(input_.name))});
    const std::uint64_t versions[] = {container_.data(bytes_of(kFileVersion)),
                                      container_.data(bytes_of(kLibraryVersion))};
    const std::uint64_t times = container_.data(sampling(1, 1) + sampling(frames, input_.frame_time_s));
    std::string metadata;
    for (const std::string& text : metadata_) metadata += static_cast<char>(text.size()) + text;
    container_.finish(container_.group({versions[0], versions[1], top, about_, times, container_.data(metadata)}));
  }

 private:
  /// Samples have a key before them that is one for one content.
  std::uint64_t sample(const std::string& bytes) {
    Hash begin, end;
    begin.add(bytes);
    end.add("Pleat").add(bytes);
    return container_.data(bytes_of(begin.value()) + bytes_of(end.value()) + bytes);
  }
  /// An array's extents follow it; those of plain numbers are what the bytes say.
  void add_array(Property& property, const std::string& bytes) {
    property.children.push_back(sample(bytes));
    property.children.push_back(kEmptyData);
  }

  /// The children of a group of properties: theirs, then the headers.
  std::vector<std::uint64_t> compound(const std::vector<Property>& properties) {
    std::vector<std::uint64_t> children;
    std::string headers;
    for (const Property& property : properties) {
      children.push_back(container_.group(property.children));
      headers += header(property);
    }
    children.push_back(container_.data(headers));
    return children;
  }

  std::string header(const Property& property) {
    constexpr std::uint32_t kHasTimes = 0x100, kEvenSizes = 0x400, kConstant = 0x800;
    const std::uint32_t longest = std::max(static_cast<std::uint32_t>(property.name.size()), property.samples);
    const std::uint32_t width = longest < 256 ? 0 : longest < 65536 ? 1 : 2;
    const auto number = [width](std::uint32_t value) { return bytes_of(value).substr(0, std::size_t{1} << width); };
    std::uint32_t info = property.kind | width << 2 | metadata_index(property.metadata) << 20;
    std::string text;
    if (property.kind != kCompound) {
      const bool animated = property.samples > 1;
      info |= property.pod << 4 | property.extent << 12 | kEvenSizes | (animated ? kHasTimes : kConstant);
      text = number(property.samples) + (animated ? number(1) : "");
    }
    return bytes_of(info) + text + number(static_cast<std::uint32_t>(property.name.size())) + property.name;
  }

  std::uint32_t metadata_index(const std::string& text) {
    if (text.empty()) return 0;
    const auto found = std::find(metadata_.begin(), metadata_.end(), text);
    const auto index = static_cast<std::uint32_t>(found - metadata_.begin());
    if (found == metadata_.end()) metadata_.push_back(text);
    return index + 1;
  }

  static std::string sampling(std::uint32_t samples, double step) {
    return bytes_of(samples) + bytes_of(step) + bytes_of(std::uint32_t{1}) + bytes_of(0.0);
  }

  /// Of an object's properties and children; readers compare, and do not compute them.
  static std::string hashes(const std::string& name) {
    Hash hash;
    hash.add(name);
    std::string text;
    for (int k = 0; k < 4; ++k) text += bytes_of(hash.add("hash").value());
    return text;
  }

  Container container_;
  const ExportInput& input_;
  std::uint64_t about_ = 0;
  std::vector<std::string> metadata_;
};

}  // namespace

void write_alembic(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame) {
  Writer(path, input).write(frame);
}

}  // namespace pleat::presentation
