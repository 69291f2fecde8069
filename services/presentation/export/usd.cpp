// USD as text: one mesh, whose points and extent have a sample per frame.
#include <charconv>

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

}  // namespace

void write_usda(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame) {
  const Topology& topology = input.topology;
  const std::string prim = prim_name(input.name);
  std::string rate;
  append_number(rate, 1.0 / input.frame_time_s);
  const std::string last = std::to_string(input.frame_count - 1);
  WholeFile file(path);
  file.write("#usda 1.0\n(\n    " + std::string(kUsdMark) + "\n    defaultPrim = \"" + prim +
             "\"\n    endTimeCode = " + last + "\n    framesPerSecond = " + rate +
             "\n    metersPerUnit = 1\n    startTimeCode = 0\n    timeCodesPerSecond = " + rate +
             "\n    upAxis = \"Y\"\n)\n\ndef Mesh \"" + prim + "\"\n{\n    uniform bool doubleSided = 1\n");
  file.write("    int[] faceVertexCounts = [");
  for (Eigen::Index f = 0; f < topology.face_count(); ++f) file.write(f == 0 ? "3" : ", 3");
  file.write("]\n    int[] faceVertexIndices = " + indices(topology.faces) +
             "\n    uniform token orientation = \"rightHanded\"\n");
  file.write("    point3f[] points.timeSamples = {\n");
  std::string extents;
  for (std::size_t t = 0; t < input.frame_count; ++t) {
    const Positions positions = frame(t);
    file.write("        " + std::to_string(t) + ": " + tuples(positions) + ",\n");
    extents += "        " + std::to_string(t) + ": " + extent(positions) + ",\n";
  }
  file.write("    }\n    float3[] extent.timeSamples = {\n" + extents + "    }\n");
  if (topology.uv.rows() > 0) {
    file.write("    texCoord2f[] primvars:st = " + tuples(topology.uv) +
               " (\n        interpolation = \"faceVarying\"\n    )\n    int[] primvars:st:indices = " +
               indices(topology.uv_faces) + "\n");
  }
  file.write("    uniform token subdivisionScheme = \"none\"\n}\n");
  file.commit();
}

}  // namespace pleat::presentation
