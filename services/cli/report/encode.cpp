#include "services/cli/report/encode.hpp"

#include <zlib.h>

#include <algorithm>
#include <cmath>

#include "common/base/error.hpp"

namespace pleat {

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
  if (!positions.allFinite()) {
    throw_invalid_argument(name + " frame " + std::to_string(index) + " has a value that is not finite");
  }
  return positions;
}

std::uint16_t zigzag(std::uint16_t difference) {
  const auto sign = static_cast<std::uint16_t>(difference & 0x8000u ? 0xffffu : 0u);
  return static_cast<std::uint16_t>((difference << 1) ^ sign);
}

}  // namespace

QuantizedSequence quantize_sequence(const std::function<Positions(std::size_t)>& frame, std::size_t count,
                                    std::size_t stride, Eigen::Index vertices, const std::string& name) {
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
  std::vector<std::uint8_t> planes(2 * values * out.frames);
  std::vector<std::uint16_t> previous(values, 0);
  for (std::size_t t = 0; t < out.frames; ++t) {
    const Positions positions = checked_frame(frame, t * stride, vertices, name);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const float origin = out.origin[3 * t + axis];
      std::uint16_t neighbour = 0;
      for (std::size_t v = 0; v < out.vertices; ++v) {
        const float scaled =
            (positions(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(axis)) - origin) / out.step;
        const auto q = static_cast<std::uint16_t>(std::clamp(std::lround(scaled), 0L, 65535L));
        const std::size_t slot = axis * out.vertices + v;
        const std::uint16_t predicted = t == 0 ? neighbour : previous[slot];
        const std::uint16_t residual = zigzag(static_cast<std::uint16_t>(q - predicted));
        planes[t * values + slot] = static_cast<std::uint8_t>(residual);
        planes[(out.frames + t) * values + slot] = static_cast<std::uint8_t>(residual >> 8);
        previous[slot] = q;
        neighbour = q;
      }
    }
  }
  out.deflated = deflate(planes);
  return out;
}

}  // namespace pleat
