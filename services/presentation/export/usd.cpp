// USD as text: one mesh, whose points and extent have a sample per frame; and a package of it.
#include <zlib.h>

#include <charconv>
#include <cstdio>
#include <functional>
#include <string_view>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "services/presentation/export/own_export.hpp"
#include "services/presentation/export/writers.hpp"

namespace pleat::presentation {

namespace {

/// The shortest digits that read back as the same number.
template <class T>
void append_number(std::string& text, T value) {
  char digits[32];
  const auto end = std::to_chars(digits, digits + sizeof digits, value);
  text.append(digits, end.ptr);
}

/// "[(x, y, z), ...]" of the rows.
template <class Matrix>
std::string tuples(const Matrix& rows) {
  std::string text = "[";
  text.reserve(static_cast<std::size_t>(rows.size()) * 12);
  for (Eigen::Index r = 0; r < rows.rows(); ++r) {
    text += r == 0 ? "(" : ", (";
    for (Eigen::Index c = 0; c < rows.cols(); ++c) {
      if (c > 0) text += ", ";
      append_number(text, rows(r, c));
    }
    text += ')';
  }
  return text + "]";
}

std::string indices(const Faces& faces) {
  std::string text = "[";
  for (Eigen::Index i = 0; i < faces.size(); ++i) {
    if (i > 0) text += ", ";
    append_number(text, faces.data()[i]);
  }
  return text + "]";
}

std::string extent(const Positions& positions) {
  Positions corners(2, 3);
  corners.row(0) = positions.colwise().minCoeff();
  corners.row(1) = positions.colwise().maxCoeff();
  return tuples(corners);
}

/// A prim name holds letters, digits and underscores, and does not begin with a digit.
std::string prim_name(const std::string& name) {
  std::string out;
  for (const char c : name) {
    const bool letter = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
    const bool digit = c >= '0' && c <= '9';
    if (out.empty() && digit) out += '_';
    out += letter || digit ? c : '_';
  }
  return out.empty() ? "cloth" : out;
}

/// Takes the text, part by part.
using Sink = std::function<void(std::string_view)>;

void write_stage(const Sink& write, const ExportInput& input, const FrameSource& frame) {
  const Topology& topology = input.topology;
  const std::string prim = prim_name(input.name);
  std::string rate;
  append_number(rate, 1.0 / input.frame_time_s);
  std::string unit;
  append_number(unit, input.metres_per_unit);
  const std::string last = std::to_string(input.frame_count - 1);
  write("#usda 1.0\n(\n    " + std::string(kUsdMark) + "\n    defaultPrim = \"" + prim +
        "\"\n    endTimeCode = " + last + "\n    framesPerSecond = " + rate + "\n    metersPerUnit = " + unit +
        "\n    startTimeCode = 0\n    timeCodesPerSecond = " + rate + "\n    upAxis = \"" + (input.z_up ? "Z" : "Y") +
        "\"\n)\n\ndef Mesh \"" + prim + "\"\n{\n    uniform bool doubleSided = 1\n");
  write("    int[] faceVertexCounts = [");
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) write(f == 0 ? "3" : ", 3");
  write("]\n    int[] faceVertexIndices = " + indices(topology.faces) +
        "\n    uniform token orientation = \"rightHanded\"\n");
  write("    point3f[] points.timeSamples = {\n");
  std::string extents;
  for (std::size_t t = 0; t < input.frame_count; ++t) {
    const Positions positions = frame(t);
    write("        " + std::to_string(t) + ": " + tuples(positions) + ",\n");
    extents += "        " + std::to_string(t) + ": " + extent(positions) + ",\n";
  }
  write("    }\n    float3[] extent.timeSamples = {\n" + extents + "    }\n");
  if (topology.uv.rows() > 0) {
    write("    texCoord2f[] primvars:st = " + tuples(topology.uv) +
          " (\n        interpolation = \"faceVarying\"\n    )\n    int[] primvars:st:indices = " +
          indices(topology.uv_faces) + "\n");
  }
  write("    uniform token subdivisionScheme = \"none\"\n}\n");
}

/// One file in a zip archive without compression, its content at a multiple of 64 bytes: what USDZ asks for.
class Package {
 public:
  Package(WholeFile& file, std::string name) : file_(file), name_(std::move(name)) { write_header(); }

  void write(std::string_view bytes) {
    file_.write(bytes);
    bytes_ += bytes.size();
    sum_ = crc32_z(sum_, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size());
  }

  /// The directory at the end, and the sizes that the header could not know.
  void finish() {
    if (bytes_ > kMaxBytes) {
      throw_invalid_argument(file_.path().string() + ": the package holds 4096 MiB; export fewer frames, or usda");
    }
    std::string end;
    word(end, 0x02014b50);
    half(end, kVersion);
    common(end);
    half(end, 0);  // comment
    half(end, 0);  // disk
    half(end, 0);  // attributes
    word(end, 0);
    word(end, 0);  // place of the header
    end += name_;
    const std::size_t directory = end.size();
    word(end, 0x06054b50);
    half(end, 0);
    half(end, 0);
    half(end, 1);
    half(end, 1);
    word(end, directory);
    word(end, kContent + bytes_);
    half(end, 0);
    file_.write(end);
    std::fseek(file_.stream(), 0, SEEK_SET);
    write_header();
  }

 private:
  static constexpr std::size_t kContent = 64, kMaxBytes = 0xffffff00u, kFixed = 30;
  static constexpr unsigned kVersion = 10;

  static void half(std::string& text, std::size_t value) {
    for (int shift = 0; shift < 16; shift += 8) text += static_cast<char>((value >> shift) & 0xffu);
  }
  static void word(std::string& text, std::size_t value) {
    for (int shift = 0; shift < 32; shift += 8) text += static_cast<char>((value >> shift) & 0xffu);
  }
  /// What header and directory have in common.
  void common(std::string& text, std::size_t padding = 0) const {
    half(text, kVersion);
    half(text, 0);       // flags
    half(text, 0);       // no compression
    half(text, 0);       // time
    half(text, 0x0021);  // 1980-01-01: the same export gives the same bytes
    word(text, sum_);
    word(text, bytes_);
    word(text, bytes_);
    half(text, name_.size());
    half(text, padding);
  }
  void write_header() {
    std::string head;
    // The padding is an extra field of its own.
    const std::size_t padding = kContent - kFixed - name_.size();
    word(head, 0x04034b50);
    common(head, padding);
    head += name_;
    half(head, 0x1986);
    half(head, padding - 4);
    head.resize(kContent, '\0');
    file_.write(head);
  }

  WholeFile& file_;
  const std::string name_;
  std::size_t bytes_ = 0;
  uLong sum_ = crc32_z(0, nullptr, 0);
};

}  // namespace

void write_usda(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame) {
  WholeFile file(path);
  write_stage([&file](std::string_view text) { file.write(text); }, input, frame);
  file.commit();
}

void write_usdz(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame) {
  WholeFile file(path);
  Package package(file, "cloth.usda");
  write_stage([&package](std::string_view text) { package.write(text); }, input, frame);
  package.finish();
  file.commit();
}

}  // namespace pleat::presentation
