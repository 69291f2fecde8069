#include "services/superres/training/initial.hpp"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/bundle/folder.hpp"
#include "services/superres/training/checkpoint.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

// What weights do not depend on: sizes of images, how positions are read from an answer, how fine the mesh is.
constexpr const char* kFree[] = {"/input",
                                 "/output",
                                 "/geometry_image/width",
                                 "/geometry_image/height",
                                 "/vertex_features/passes",
                                 "/vertex_features/anchor_weight",
                                 "/subdivision_rounds",
                                 "/subdivision_rule"};

/// All that has to agree, by name.
json traits(const Metadata& m) {
  json architecture = json::parse(m.architecture.options);
  architecture["kind"] = m.architecture.kind;
  json traits = json::parse(representation_json(m)).flatten();
  for (auto it = traits.begin(); it != traits.end();) {
    const bool free =
        std::any_of(std::begin(kFree), std::end(kFree), [&](const char* key) { return it.key().rfind(key, 0) == 0; });
    it = free ? traits.erase(it) : std::next(it);
  }
  const json network = json{{"architecture", architecture}}.flatten();
  for (const auto& [key, value] : network.items()) traits[key] = value;
  traits["/channels read"] = m.input.channels();
  traits["/channels answered"] = m.output.channels();
  traits["/constants"] = m.constants;
  return traits;
}

Metadata describe(const TrainConfig& config, const PairData& data) {
  Metadata m;
  m.architecture = config.architecture;
  m.representation = data.representation;
  const auto any = [](std::size_t channels) {
    return ChannelRanges{std::vector<float>(channels, 0.0F), std::vector<float>(channels, 1.0F), 0};
  };
  m.input = any(data.input_channels.size()), m.output = any(data.answer_channels.size());
  m.constants = data.constant_channels();
  return m;
}

std::string spoken(const std::string& key) {
  std::string name = key.substr(1);
  std::replace(name.begin(), name.end(), '/', '.');
  return name;
}

std::string text_of(const json& traits, const std::string& key) {
  const auto it = traits.find(key);
  return it == traits.end() ? "nothing" : it->dump();
}

Metadata read_initial(const TrainConfig& config, const PairData& data) {
  Metadata bundle = read_metadata(config.initial);
  const json theirs = traits(bundle), ours = traits(describe(config, data));
  const auto refuse = [&](const std::string& key) {
    throw_invalid_argument(config.initial + ": can't begin this training, its " + spoken(key) + " is " +
                           text_of(theirs, key) + ", the configuration's " + text_of(ours, key) +
                           (key == "/geometry_image/units" ? " (pleat-train --any-mesh writes it for any mesh)" : ""));
  };
  for (const auto& [key, value] : theirs.items()) {
    if (!ours.contains(key) || ours[key] != value) refuse(key);
  }
  for (const auto& [key, value] : ours.items()) {
    if (!theirs.contains(key)) refuse(key);
  }
  return bundle;
}

/// A check-point that does not exist is for load_initial to name.
bool begins_as_bundle(const TrainConfig& config) { return !config.initial.empty() && is_bundle(config.initial); }

}  // namespace

std::vector<std::string> changes_to_begin_with(const std::string& bundle) {
  if (!std::filesystem::exists(bundle)) throw_not_found(bundle + ": no such model bundle");
  if (!is_bundle(bundle)) throw_invalid_argument(bundle + ": no model bundle to begin with");
  const Metadata m = read_metadata(bundle);
  const auto* image = std::get_if<conversion::GeometryImageSpec>(&m.representation.kind);
  if (image == nullptr || !is_registered(m.architecture.kind)) {
    throw_invalid_argument(bundle + ": can't begin a training, it is no network of Pleat's on geometry images");
  }
  json architecture = json::parse(m.architecture.options);
  architecture["kind"] = m.architecture.kind;
  constexpr const char* kLayouts[] = {"published", "detail", "positions"};
  const bool any = m.topology_hash.empty();
  std::vector<std::string> changes{
      "initial=" + json(bundle).dump(),
      "architecture=" + architecture.dump(),
      "representation=geometry_image",
      std::string("serves=") + (any ? "any" : "mesh"),
      std::string("images.layout=") + kLayouts[static_cast<std::size_t>(image->layout)],
      std::string("images.base=") + (image->base == conversion::DetailBase::kTexels ? "texels" : "vertices"),
      std::string("images.units=") +
          (image->units == conversion::DetailUnits::kCoarseEdges ? "coarse_edges" : "metres"),
      "images.scale=" + std::to_string(image->image.scale),
      "window=" + std::to_string(m.representation.window),
      "window_stride=" + std::to_string(m.representation.window_stride)};
  if (any) changes.insert(changes.end(), {"images.coarse_width=0", "images.coarse_height=0"});
  return changes;
}

bool take_initial_ranges(const TrainConfig& config, PairData& data) {
  if (!begins_as_bundle(config)) return false;
  const Metadata bundle = read_initial(config, data);
  const auto* image = std::get_if<conversion::GeometryImageSpec>(&bundle.representation.kind);
  if (image == nullptr || image->layout != conversion::ImageLayout::kDetail ||
      image->units != conversion::DetailUnits::kCoarseEdges) {
    return false;
  }
  data.input_ranges = bundle.input, data.output_ranges = bundle.output;
  return true;
}

void take_initial_weights(const TrainConfig& config, const PairData& data, Network& network) {
  if (!begins_as_bundle(config)) return load_initial(config.initial, network);
  read_initial(config, data);
  Metadata metadata;
  const auto values = values_of(load_bundle(config.initial, metadata));
  const torch::NoGradGuard no_grad;
  for (auto [name, value] : network.parameters()) {
    const auto from = values.find(name);
    if (from == values.end() || from->second.size() != static_cast<std::size_t>(value.numel())) {
      throw_invalid_argument(config.initial + ": can't begin this training, its array " + name + " is " +
                             (from == values.end() ? "missing" : "of another size"));
    }
    value.copy_(torch::from_blob(const_cast<float*>(from->second.data()), value.sizes(), torch::kFloat32));
  }
}

}  // namespace pleat::superres
