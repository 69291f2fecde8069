#include "services/conversion/vertex_features/stream_state.hpp"

#include <cmath>
#include <cstring>

#include "common/base/error.hpp"

namespace pleat::conversion {
namespace {

constexpr std::string_view kMagic = "PVF1";
constexpr float kLargestLabel = 1e3f;  // beyond some 160 turns a logarithm has lost its digits

struct Header {
  char magic[4];
  std::uint32_t channels, vertices;
  float heading;
};

}  // namespace

std::string to_bytes(const StreamState& state, RotationCode code) {
  const auto channels = static_cast<std::size_t>(rotation_channels(code));
  Header header{
      {}, static_cast<std::uint32_t>(channels), static_cast<std::uint32_t>(state.labels.size()), state.heading};
  kMagic.copy(header.magic, sizeof(header.magic));
  std::string bytes(sizeof(header) + state.labels.size() * channels * sizeof(float), '\0');
  std::memcpy(bytes.data(), &header, sizeof(header));
  char* to = bytes.data() + sizeof(header);
  for (const Float4& label : state.labels) {
    std::memcpy(to, &label, channels * sizeof(float));
    to += channels * sizeof(float);
  }
  return bytes;
}

StreamState stream_state_from_bytes(std::string_view bytes, RotationCode code, std::size_t vertex_count) {
  StreamState state;
  if (bytes.empty()) return state;
  const auto channels = static_cast<std::size_t>(rotation_channels(code));
  Header header;
  if (bytes.size() != sizeof(header) + vertex_count * channels * sizeof(float)) {
    throw_invalid_argument("stream state of " + std::to_string(bytes.size()) + " bytes does not belong to " +
                           std::to_string(vertex_count) + " vertices");
  }
  std::memcpy(&header, bytes.data(), sizeof(header));
  if (std::string_view(header.magic, sizeof(header.magic)) != kMagic || header.channels != channels ||
      header.vertices != vertex_count || !(std::abs(header.heading) < 1e6f)) {
    throw_invalid_argument("stream state of another kind, or damaged");
  }
  state.heading = header.heading;
  state.labels.assign(vertex_count, Float4{});
  const char* from = bytes.data() + sizeof(header);
  for (std::size_t v = 0; v < vertex_count; ++v, from += channels * sizeof(float)) {
    std::memcpy(&state.labels[v], from, channels * sizeof(float));
    for (int k = 0; k < 4; ++k) {
      if (!(std::abs(state.labels[v][k]) < kLargestLabel)) {
        throw_invalid_argument("stream state: the rotation of vertex " + std::to_string(v) + " is not usable");
      }
    }
  }
  return state;
}

}  // namespace pleat::conversion
