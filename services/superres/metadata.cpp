#include "services/superres/metadata.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

constexpr const char* kFormat = "pleat.bundle";
constexpr int kMaxImageSide = 8192;

template <typename T>
T get(const json& object, const char* key, const std::string& source) {
  const auto it = object.find(key);
  if (it == object.end()) throw_invalid_argument(source + ": pleat.json has no key '" + key + "'");
  try {
    return it->get<T>();
  } catch (const json::exception&) {
    throw_invalid_argument(source + ": pleat.json: key '" + std::string(key) + "' has the wrong type");
  }
}

template <typename T>
T get_or(const json& object, const char* key, T fallback, const std::string& source) {
  return object.contains(key) ? get<T>(object, key, source) : fallback;
}

std::array<float, kChannels> get_channels(const json& object, const char* key, const std::string& source) {
  const auto values = get<std::vector<float>>(object, key, source);
  if (values.size() != kChannels) {
    throw_invalid_argument(source + ": pleat.json: '" + key + "' needs 9 values, has " + std::to_string(values.size()));
  }
  std::array<float, kChannels> result{};
  std::copy(values.begin(), values.end(), result.begin());
  return result;
}

std::array<int, 2> get_size(const json& object, const char* key, const std::string& source) {
  const auto values = get<std::vector<int>>(object, key, source);
  if (values.size() != 2 || values[0] < 1 || values[1] < 1 || values[0] > kMaxImageSide || values[1] > kMaxImageSide) {
    throw_invalid_argument(source + ": pleat.json: '" + key + "' must be [width, height] in texels, 1 to " +
                           std::to_string(kMaxImageSide));
  }
  return {values[0], values[1]};
}

void check_range(const char* key, int value, int low, int high) {
  if (value < low || value > high) {
    throw_invalid_argument("architecture: " + std::string(key) + " = " + std::to_string(value) + " is outside " +
                           std::to_string(low) + " to " + std::to_string(high));
  }
}

}  // namespace

const std::vector<std::string>& channel_names() {
  static const std::vector<std::string> names{"displacement_x", "displacement_y", "displacement_z",
                                              "normal_x",       "normal_y",       "normal_z",
                                              "velocity_x",     "velocity_y",     "velocity_z"};
  return names;
}

const std::vector<std::string>& architecture_kinds() {
  static const std::vector<std::string> kinds{"mfsr", "srresnet", "chen2018"};
  return kinds;
}

bool is_registered(const Architecture& architecture) {
  const auto& kinds = architecture_kinds();
  return std::find(kinds.begin(), kinds.end(), architecture.kind) != kinds.end();
}

bool needs_mesh(const Architecture& architecture) {
  return is_registered(architecture) && (architecture.residual == "mesh" || architecture.kind == "chen2018");
}

void validate(const Architecture& architecture) {
  if (!is_registered(architecture)) {
    throw_invalid_argument("architecture: kind '" + architecture.kind + "' is not 'mfsr', 'srresnet' or 'chen2018'");
  }
  check_range("blocks", architecture.blocks, 1, 64);
  check_range("layers", architecture.layers, 1, 32);
  check_range("growth", architecture.growth, 1, 256);
  check_range("features", architecture.features, 1, 512);
  if (architecture.upsampling != "bilinear" && architecture.upsampling != "subpixel") {
    throw_invalid_argument("architecture: upsampling must be 'bilinear' or 'subpixel', is '" + architecture.upsampling +
                           "'");
  }
  if (architecture.axes != "aligned" && architecture.axes != "local") {
    throw_invalid_argument("architecture: axes must be 'aligned' or 'local', is '" + architecture.axes + "'");
  }
  if (architecture.axes == "local" && (architecture.residual != "mesh" || !architecture.conditioned)) {
    throw_invalid_argument("architecture: axes 'local' needs residual 'mesh' and conditioned");
  }
  if (architecture.residual != "none" && architecture.residual != "bilinear" && architecture.residual != "mesh") {
    throw_invalid_argument("architecture: residual must be 'none', 'bilinear' or 'mesh', is '" + architecture.residual +
                           "'");
  }
  if (architecture.kind == "chen2018" && (architecture.residual != "none" || architecture.axes != "aligned" ||
                                          architecture.conditioned || architecture.upsampling != "subpixel")) {
    throw_invalid_argument(
        "architecture: kind 'chen2018' has residual 'none', axes 'aligned', upsampling 'subpixel' and no conditioning");
  }
}

std::string to_json(const Metadata& metadata) {
  const Architecture& a = metadata.architecture;
  json document;
  document["format"] = kFormat;
  document["version"] = kBundleVersion;
  document["name"] = metadata.name;
  document["architecture"] = {{"kind", a.kind},
                              {"blocks", a.blocks},
                              {"layers", a.layers},
                              {"growth", a.growth},
                              {"features", a.features},
                              {"upsampling", a.upsampling},
                              {"residual", a.residual},
                              {"axes", a.axes},
                              {"conditioned", a.conditioned},
                              {"parameters", metadata.parameters}};
  document["scale"] = metadata.scale;
  document["channels"] = metadata.channels;
  document["normalization"] = {{"minimum", metadata.normalization.minimum},
                               {"maximum", metadata.normalization.maximum}};
  document["coarse_image"] = {metadata.coarse_width, metadata.coarse_height};
  document["fine_image"] = {metadata.fine_width, metadata.fine_height};
  document["image_spec"] = json::parse(metadata.image_spec);
  document["topology_hash"] = metadata.topology_hash;
  document["velocity"] = metadata.velocity;
  document["float32_parameters"] = metadata.float32_parameters;
  document["training"] = json::parse(metadata.training);
  document["metrics"] = metadata.metrics;
  document["git_revision"] = metadata.git_revision;
  return document.dump(2);
}

Metadata metadata_from_json(const std::string& text, const std::string& source) {
  const json document = json::parse(text, nullptr, false);
  if (document.is_discarded()) throw_data_loss(source + ": pleat.json is no JSON");
  if (!document.is_object() || get<std::string>(document, "format", source) != kFormat) {
    throw_invalid_argument(source + ": pleat.json: format is not '" + kFormat + "'");
  }
  const int version = get<int>(document, "version", source);
  if (version != kBundleVersion) {
    throw_invalid_argument(source + ": bundle version " + std::to_string(version) + ", this program reads version " +
                           std::to_string(kBundleVersion));
  }
  Metadata m;
  m.name = get<std::string>(document, "name", source);
  const json architecture = get<json>(document, "architecture", source);
  if (!architecture.is_object()) throw_invalid_argument(source + ": pleat.json: 'architecture' must be an object");
  m.architecture.kind = get_or<std::string>(architecture, "kind", "mfsr", source);
  m.parameters = get_or<std::int64_t>(architecture, "parameters", 0, source);
  if (is_registered(m.architecture)) {
    Architecture& a = m.architecture;
    a.blocks = get<int>(architecture, "blocks", source);
    a.layers = get<int>(architecture, "layers", source);
    a.growth = get<int>(architecture, "growth", source);
    a.features = get<int>(architecture, "features", source);
    a.upsampling = get_or<std::string>(architecture, "upsampling", "bilinear", source);
    a.residual = get_or<std::string>(architecture, "residual", "none", source);
    a.axes = get_or<std::string>(architecture, "axes", "aligned", source);
    a.conditioned = get_or<bool>(architecture, "conditioned", false, source);
    validate(a);
  }
  m.scale = get<int>(document, "scale", source);
  if (m.scale != kScale)
    throw_invalid_argument(source + ": pleat.json: scale must be 4, is " + std::to_string(m.scale));
  m.channels = get<std::vector<std::string>>(document, "channels", source);
  if (m.channels != channel_names()) {
    throw_invalid_argument(source + ": pleat.json: channels must be displacement, normal, velocity, each _x, _y, _z");
  }
  const json normalization = get<json>(document, "normalization", source);
  if (!normalization.is_object()) throw_invalid_argument(source + ": pleat.json: 'normalization' must be an object");
  m.normalization.minimum = get_channels(normalization, "minimum", source);
  m.normalization.maximum = get_channels(normalization, "maximum", source);
  for (std::size_t c = 0; c < kChannels; ++c) {
    const float low = m.normalization.minimum[c], high = m.normalization.maximum[c];
    if (!std::isfinite(low) || !std::isfinite(high) || !(low < high)) {
      throw_invalid_argument(source + ": pleat.json: normalization of " + m.channels[c] + " is not minimum < maximum");
    }
  }
  const auto coarse = get_size(document, "coarse_image", source);
  const auto fine = get_size(document, "fine_image", source);
  m.coarse_width = coarse[0], m.coarse_height = coarse[1], m.fine_width = fine[0], m.fine_height = fine[1];
  if (fine[0] != m.scale * coarse[0] || fine[1] != m.scale * coarse[1]) {
    throw_invalid_argument(source + ": pleat.json: fine_image is not 4 times coarse_image");
  }
  m.image_spec = get_or<json>(document, "image_spec", json::object(), source).dump();
  m.topology_hash = get<std::string>(document, "topology_hash", source);
  m.velocity = get<std::string>(document, "velocity", source);
  if (m.velocity != "backward") {
    throw_invalid_argument(source + ": pleat.json: velocity must be 'backward', is '" + m.velocity + "'");
  }
  m.float32_parameters = get_or<std::vector<std::string>>(document, "float32_parameters", {}, source);
  m.training = get_or<json>(document, "training", json::object(), source).dump();
  m.metrics = get_or<std::map<std::string, double>>(document, "metrics", {}, source);
  m.git_revision = get_or<std::string>(document, "git_revision", "", source);
  return m;
}

}  // namespace pleat::superres
