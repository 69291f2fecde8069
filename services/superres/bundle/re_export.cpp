#include "services/superres/bundle/re_export.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/mesh/garment.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/networks/network.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;
using Values = std::map<std::string, std::vector<float>>;

constexpr float kDetailLimit = 6;  ///< to which version 1 cut what it read
constexpr int kConstants = 32;     ///< two weights of each of the 4 x 4 fine texels of a coarse one
constexpr int kOldScale = 4;

const std::vector<float>& get(const Values& values, const std::string& name, const std::string& path) {
  const auto it = values.find(name);
  if (it == values.end()) throw_invalid_argument(path + ": no array " + name);
  return it->second;
}

Architecture architecture_of(const json& old) {
  json options = json::object();
  for (const char* key : {"blocks", "layers", "growth", "features", "upsampling"}) {
    const bool dense = key == std::string("layers") || key == std::string("growth");
    if (old.contains(key) && !(dense && old.value("kind", "mfsr") != "mfsr")) options[key] = old[key];
  }
  return complete({old.value("kind", "mfsr"), options.dump()});
}

Metadata metadata_of(const json& old, const Values& values, const std::string& path) {
  const json& network = old.at("architecture");
  Metadata m;
  m.name = old.at("name").get<std::string>();
  m.architecture = architecture_of(network);
  const std::string residual = network.value("residual", "none"), axes = network.value("axes", "aligned");
  const bool detail = residual == "mesh" && axes == "local";
  if (!detail && (residual != "none" || axes != "aligned" || network.value("conditioned", false))) {
    throw_invalid_argument(path + ": residual '" + residual + "' and axes '" + axes +
                           "' have no form in version 2; train it again");
  }
  conversion::GeometryImageSpec spec;
  spec.layout = detail ? conversion::ImageLayout::kDetail : conversion::ImageLayout::kPublished;
  spec.base = conversion::DetailBase::kTexels;
  spec.image.coarse_width = old.at("coarse_image").at(0).get<int>();
  spec.image.coarse_height = old.at("coarse_image").at(1).get<int>();
  spec.image.scale = kOldScale;
  m.representation.kind = spec;
  if (detail) {
    m.input = {get(values, "local_mean", path), get(values, "local_deviation", path), kDetailLimit};
    const auto& deviation = get(values, "local_output", path);
    m.output = {{0, 0, 0}, {deviation.begin(), deviation.begin() + 3}, 0};
    m.constants = kConstants;
  } else {
    m.input.offset = old.at("normalization").at("minimum").get<std::vector<float>>();
    m.input.scale = old.at("normalization").at("maximum").get<std::vector<float>>();
    for (std::size_t c = 0; c < m.input.channels(); ++c) m.input.scale[c] -= m.input.offset[c];
    m.output = m.input;
  }
  m.topology_hash = old.at("topology_hash").get<std::string>();
  m.training = old.value("training", json::object()).dump();
  m.metrics = old.value("metrics", std::map<std::string, double>());
  m.git_revision = old.value("git_revision", "");
  return m;
}

}  // namespace

void re_export(const std::string& old_path, const std::string& path) {
  std::string text;
  const Values values = values_of(load_module(old_path, text));
  const json old = json::parse(text, nullptr, false);
  if (old.is_discarded() || !old.is_object() || old.value("format", "") != "pleat.bundle" ||
      old.value("version", 0) != 1) {
    throw_invalid_argument(old_path + ": no bundle of version 1");
  }
  Metadata metadata;
  try {
    metadata = metadata_of(old, values, old_path);
  } catch (const json::exception& error) {
    throw_invalid_argument(old_path + ": pleat.json: " + error.what());
  }
  const Network network(describe(metadata.architecture, ports_of(metadata)), 1);
  {
    const torch::NoGradGuard no_grad;
    for (auto [name, value] : network.parameters()) {
      const std::vector<float>& from = get(values, name, old_path);
      // The first outputs of the heads are the displacements.
      const auto count = static_cast<std::size_t>(value.numel());
      if (from.size() != count && !(name.rfind("heads_", 0) == 0 && from.size() > count)) {
        throw_invalid_argument(old_path + ": array " + name + " has another size");
      }
      std::copy_n(from.begin(), count, value.data_ptr<float>());
    }
  }
  metadata.parameters = network.parameter_count();
  metadata.float32_parameters = network.float32_parameters();
  save_bundle(network.to_script(), metadata, path);
}

void add_rest_mesh(const std::string& bundle_path, const std::string& garment, const std::string& path) {
  Metadata metadata;
  const torch::jit::Module module = load_bundle(bundle_path, metadata);
  std::vector<std::string> notes;
  const Topology mesh = read_garment(garment, notes);
  if (topology_hash(mesh) != metadata.topology_hash) {
    throw_invalid_argument(bundle_path + ": was trained for the mesh " + metadata.topology_hash + ", " + garment +
                           " is " + topology_hash(mesh));
  }
  metadata.rest_positions.assign(mesh.rest_positions.data(), mesh.rest_positions.data() + mesh.rest_positions.size());
  save_bundle(module, metadata, path);
}

}  // namespace pleat::superres
