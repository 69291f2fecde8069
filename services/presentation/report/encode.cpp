#include "services/presentation/report/encode.hpp"

#include <zlib.h>

#include <algorithm>
#include <cmath>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"

namespace pleat::presentation {

std::string base64(std::span<const std::uint8_t> bytes) {
  static constexpr char kAlphabet[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text((bytes.size() + 2) / 3 * 4, '=');
  std::size_t out = 0;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t left = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = std::uint32_t{bytes[i]} << 16;
    if (left > 1) group |= std::uint32_t{bytes[i + 1]} << 8;
    if (left > 2) group |= bytes[i + 2];
    for (std::size_t k = 0; k <= left; ++k) text[out + k] = kAlphabet[(group >> (18 - 6 * k)) & 63];
    out += 4;
  }
  return text;
}

std::vector<std::uint8_t> deflate(std::span<const std::uint8_t> bytes, int level) {
  uLongf size = compressBound(static_cast<uLong>(bytes.size()));
  std::vector<std::uint8_t> out(size);
  if (compress2(out.data(), &size, bytes.data(), static_cast<uLong>(bytes.size()), level) != Z_OK) {
    throw Error(ErrorCode::kResourceExhausted, "zlib could not compress " + std::to_string(bytes.size()) + " bytes");
  }
  out.resize(size);
  return out;
}

std::vector<std::uint8_t> byte_planes(std::span<const std::uint32_t> words) {
  std::vector<std::uint8_t> out(words.size() * 4);
  for (std::size_t plane = 0; plane < 4; ++plane) {
    for (std::size_t i = 0; i < words.size(); ++i) {
      out[plane * words.size() + i] = static_cast<std::uint8_t>(words[i] >> (8 * plane));
    }
  }
  return out;
}

namespace {

Positions checked_frame(const std::function<Positions(std::size_t)>& frame, std::size_t index, Eigen::Index vertices,
                        const std::string& name) {
  Positions positions = frame(index);
  if (positions.rows() != vertices) {
    throw_invalid_argument(name + " frame " + std::to_string(index) + " has " + std::to_string(positions.rows()) +
                           " vertices, expected " + std::to_string(vertices));
  }
  if (!all_finite(positions)) {
    throw_invalid_argument(name + " frame " + std::to_string(index) + " has a value that is not finite");
  }
  return positions;
}

/// The difference modulo 2^16, as a signed number.
std::int32_t wrap(std::int32_t difference) { return static_cast<std::int16_t>(static_cast<std::uint16_t>(difference)); }

std::uint32_t zigzag(std::int32_t wrapped) {
  return wrapped < 0 ? static_cast<std::uint32_t>(-2 * wrapped - 1) : static_cast<std::uint32_t>(2 * wrapped);
}

/// The earlier mates of each vertex (encode.hpp), in compressed rows.
struct Mates {
  std::vector<std::uint32_t> offsets;
  std::vector<std::uint32_t> vertices;

  Mates(std::size_t vertex_count, const Faces& faces) : offsets(vertex_count + 1, 0) {
    for_each(faces, [&](std::uint32_t later, std::uint32_t) { ++offsets[later + 1]; });
    for (std::size_t v = 0; v < vertex_count; ++v) offsets[v + 1] += offsets[v];
    vertices.resize(offsets.back());
    std::vector<std::uint32_t> next(offsets.begin(), offsets.end() - 1);
    for_each(faces, [&](std::uint32_t later, std::uint32_t earlier) { vertices[next[later]++] = earlier; });
  }

  /// residuals: of this frame and axis, known below `vertex`.
  std::int32_t predict(std::span<const std::int32_t> residuals, std::size_t vertex) const {
    const std::uint32_t begin = offsets[vertex];
    const auto count = static_cast<std::int32_t>(offsets[vertex + 1] - begin);
    if (count == 0) return vertex == 0 ? 0 : residuals[vertex - 1];
    std::int32_t sum = 0;
    for (std::uint32_t i = begin; i < offsets[vertex + 1]; ++i) sum += residuals[vertices[i]];
    const std::int32_t quotient = sum / count;
    return quotient - (sum % count < 0 ? 1 : 0);
  }

 private:
  template <class Visit>
  static void for_each(const Faces& faces, const Visit& visit) {
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      for (Eigen::Index a = 0; a < 3; ++a) {
        for (Eigen::Index b = 0; b < 3; ++b) {
          if (faces(f, a) > faces(f, b)) visit(faces(f, a), faces(f, b));
        }
      }
    }
  }
};

}  // namespace

QuantizedSequence quantize_sequence(const std::function<Positions(std::size_t)>& frame, std::size_t count,
                                    std::size_t stride, Eigen::Index vertices, const Faces& faces,
                                    const std::string& name) {
  if (faces.size() > 0 && static_cast<Eigen::Index>(faces.maxCoeff()) >= vertices) {
    throw_invalid_argument(name + ": a face names vertex " + std::to_string(faces.maxCoeff()) + " of " +
                           std::to_string(vertices));
  }
  QuantizedSequence out;
  out.vertices = static_cast<std::size_t>(vertices);
  float extent = 0;
  for (std::size_t index = 0; index < count; index += stride) {
    const Positions positions = checked_frame(frame, index, vertices, name);
    const Eigen::RowVector3f lower =
        vertices > 0 ? Eigen::RowVector3f(positions.colwise().minCoeff()) : Eigen::RowVector3f(0, 0, 0);
    if (vertices > 0) extent = std::max(extent, (positions.colwise().maxCoeff() - lower).maxCoeff());
    out.origin.insert(out.origin.end(), lower.data(), lower.data() + 3);
    ++out.frames;
  }
  out.step = extent > 0 ? extent / 65535.0f : 1.0f;

  const std::size_t values = out.vertices * 3;
  const Mates mates(out.vertices, faces);
  std::vector<std::uint8_t> planes(2 * values * out.frames);
  std::vector<std::int32_t> before(values, 0);       // q[t-1]
  std::vector<std::int32_t> before_that(values, 0);  // q[t-2]
  std::vector<std::int32_t> residuals(out.vertices);
  for (std::size_t t = 0; t < out.frames; ++t) {
    const Positions positions = checked_frame(frame, t * stride, vertices, name);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const float origin = out.origin[3 * t + axis];
      for (std::size_t v = 0; v < out.vertices; ++v) {
        const float place = positions(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(axis)) - origin;
        const auto q = static_cast<std::int32_t>(std::clamp(std::lround(place / out.step), 0L, 65535L));
        const std::size_t slot = axis * out.vertices + v;
        const std::int32_t expected = t < 2 ? before[slot] : 2 * before[slot] - before_that[slot];
        residuals[v] = wrap(q - expected);
        const std::uint32_t coded = zigzag(wrap(residuals[v] - mates.predict(residuals, v)));
        planes[t * values + slot] = static_cast<std::uint8_t>(coded);
        planes[(out.frames + t) * values + slot] = static_cast<std::uint8_t>(coded >> 8);
        before_that[slot] = before[slot];
        before[slot] = q;
      }
    }
  }
  out.deflated = deflate(planes);
  return out;
}

}  // namespace pleat::presentation
