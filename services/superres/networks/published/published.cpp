#include "services/superres/networks/published/published.hpp"

#include <memory>
#include <string>

#include "common/base/error.hpp"
#include "services/superres/networks/parts.hpp"

namespace pleat::superres {
namespace {

/// The meshes are held as long as the layers that read their maps.
std::shared_ptr<const PlaceMap> map_of(const Ports& ports, PlaceMap MeshPorts::*map) {
  return {ports.mesh, &(ports.mesh.get()->*map)};
}

Size row_of(const PlaceMap& map) { return {1, static_cast<int>(map.rows())}; }

/// One of the two autoencoders.
class Autoencoder {
 public:
  Autoencoder(Description& network, std::string name, std::shared_ptr<const PlaceMap> ring, int channels, int latent,
              bool norm, bool tanh)
      : network_(network),
        name_(std::move(name)),
        ring_(std::move(ring)),
        channels_(channels),
        latent_(latent),
        norm_(norm),
        tanh_(tanh) {}

  /// (frames C, 1, V) -> (frames latent, 1, 1)
  int encode(int features, int frames) {
    const Activation activation = norm_ ? Activation::kLeakyRelu : Activation::kTanh;
    int first = convolve(name_ + "_first", features, frames, activation, "");
    if (norm_) {
      first = network_.add(
          {.kind = LayerKind::kNorm, .name = name_ + "_norm", .inputs = {first}, .exact = true, .frames = frames});
    }
    const int second = convolve(name_ + "_second", first, frames, Activation::kNone, "");
    const int flat = reshape(second, frames * channels_ * vertices(), {1, 1});
    return network_.add({.name = name_ + "_latent",
                         .inputs = {flat},
                         .channels = frames * latent_,
                         .kernel = 1,
                         .exact = true,
                         .frames = frames});
  }

  /// (frames latent, 1, 1) -> (frames C, 1, V). After an encoder: the weights are its.
  int decode(int latent, int frames) {
    const int flat = network_.add({.name = name_ + "_again",
                                   .inputs = {latent},
                                   .channels = frames * channels_ * vertices(),
                                   .kernel = 1,
                                   .exact = true,
                                   .frames = frames,
                                   .tied = name_ + "_latent"});
    const int vertices_of = reshape(flat, frames * channels_, {1, vertices()});
    const int second = convolve(name_ + "_second_again", vertices_of, frames, Activation::kTanh, name_ + "_second");
    return convolve(name_ + "_first_again", second, frames, tanh_ ? Activation::kTanh : Activation::kNone,
                    name_ + "_first");
  }

 private:
  int vertices() const { return static_cast<int>(ring_->rows()); }
  int reshape(int value, int channels, Size size) {
    return network_.add({.kind = LayerKind::kReshape, .inputs = {value}, .channels = channels, .size = size});
  }
  int convolve(const std::string& name, int value, int frames, Activation activation, const std::string& tied) {
    const int around = network_.add(
        {.kind = LayerKind::kMean, .name = name_ + "_ring", .inputs = {value}, .size = row_of(*ring_), .map = ring_});
    return network_.add({.name = name,
                         .inputs = {value, around},
                         .channels = frames * channels_,
                         .kernel = 1,
                         .activation = activation,
                         .exact = true,
                         .frames = frames,
                         .tied = tied});
  }

  Description& network_;
  const std::string name_;
  const std::shared_ptr<const PlaceMap> ring_;
  const int channels_, latent_;
  const bool norm_, tanh_;
};

/// A block over the network's own tokens, which look at themselves and at the coarse ones.
int add_decoder_block(Description& network, const std::string& name, int tokens, int coarse, bool spatial,
                      bool temporal, const AttentionSizes& sizes) {
  int seen = -1;
  if (temporal) seen = add_attention(network, name + "_own", tokens, true, true, sizes, seen);
  if (spatial) seen = add_cross_attention(network, name + "_spatial", tokens, coarse, false, sizes, seen);
  if (temporal) seen = add_cross_attention(network, name + "_temporal", tokens, coarse, true, sizes, seen);
  return add_perceptron(network, name, seen < 0 ? tokens : seen, sizes);
}

/// What is known without meshes: what goes in and what comes out.
Description ends_of(const Ports& ports) {
  Description network(ports.inputs);
  network.ends_only = true;
  const int values = network.add({.name = "answer",
                                  .inputs = {0},
                                  .channels = ports.outputs * ports.scale * ports.scale,
                                  .kernel = 1,
                                  .exact = true});
  network.add({.kind = LayerKind::kPixelShuffle, .inputs = {values}, .factor = ports.scale});
  return network;
}

}  // namespace

Description describe_published(Options& options, const Ports& ports) {
  const int frames = ports.window;
  const AttentionSizes sizes = read_attention(options, frames);
  const int latent = options.integer("latent", 16, 1, 1024), blocks = options.integer("blocks", 2, 1, 32);
  const bool spatial = options.flag("spatial", true), temporal = options.flag("temporal", true);
  const bool norm = options.choice("norm", "none", {"none", "layer"}) == "layer";
  const bool tanh = options.choice("output", "tanh", {"tanh", "linear"}) == "tanh";
  if (!ports.mesh) return ends_of(ports);
  const MeshPorts& mesh = *ports.mesh;
  const int features = mesh.features, each = (ports.inputs - ports.constants) / (frames * mesh.corners);

  Description network(ports.inputs);
  const int corners = network.add({.kind = LayerKind::kSpread,
                                   .inputs = {0},
                                   .channels = frames * features,
                                   .frames = frames,
                                   .parts = mesh.corners,
                                   .each = each});
  const int coarse = network.add({.kind = LayerKind::kMean,
                                  .name = "coarse",
                                  .inputs = {corners},
                                  .size = row_of(mesh.coarse),
                                  .map = map_of(ports, &MeshPorts::coarse)});
  Autoencoder of_coarse(network, "coarse", map_of(ports, &MeshPorts::coarse_ring), features, latent, norm, tanh);
  const int coarse_codes = of_coarse.encode(coarse, frames);
  network.twins.push_back({of_coarse.decode(coarse_codes, frames), coarse, coarse_codes});

  const int given =
      network.add({.kind = LayerKind::kGiven, .inputs = {0}, .channels = ports.outputs, .factor = ports.scale});
  const int fine = network.add({.kind = LayerKind::kMean,
                                .name = "fine",
                                .inputs = {given},
                                .size = row_of(mesh.fine),
                                .map = map_of(ports, &MeshPorts::fine)});
  Autoencoder of_fine(network, "fine", map_of(ports, &MeshPorts::fine_ring), ports.outputs, latent, norm, tanh);
  network.given_memory = of_fine.encode(fine, 1);
  network.twins.push_back({of_fine.decode(network.given_memory, 1), fine, network.given_memory});
  const auto read_of = [&](int vertices) {
    return network.add({.kind = LayerKind::kMean,
                        .name = "fine_read",
                        .inputs = {vertices},
                        .size = {ports.scale, static_cast<int>(mesh.fine_read.rows()) / ports.scale},
                        .map = map_of(ports, &MeshPorts::fine_read)});
  };
  network.reconstructed = read_of(network.twins.back().out);

  network.remembered = frames;
  const int own_codes =
      network.add({.kind = LayerKind::kMemory, .inputs = {0}, .channels = frames * latent, .size = {1, 1}});
  const auto tokens_of = [&](const char* name, int codes) {
    return network.add({.kind = LayerKind::kTokens,
                        .name = name,
                        .inputs = {codes},
                        .channels = frames * sizes.features,
                        .frames = frames});
  };
  int seen = tokens_of("coarse_tokens", coarse_codes), own = tokens_of("own_tokens", own_codes);
  for (int b = 0; b < blocks; ++b) {
    seen = add_attention_block(network, "encoder" + std::to_string(b), seen, spatial, temporal, sizes);
  }
  for (int b = 0; b < blocks; ++b) {
    own = add_decoder_block(network, "decoder" + std::to_string(b), own, seen, spatial, temporal, sizes);
  }
  const int newest = network.add(
      {.kind = LayerKind::kPart, .inputs = {own}, .channels = sizes.features, .first = (frames - 1) * sizes.features});
  const int last = network.add(
      {.kind = LayerKind::kPart, .inputs = {own_codes}, .channels = latent, .first = (frames - 1) * latent});
  const int before = network.add({.kind = LayerKind::kReshape, .inputs = {last}, .channels = 1, .size = {1, latent}});
  const int next = network.add(
      {.name = "next", .inputs = {newest}, .channels = 1, .kernel = 1, .add = before, .exact = true, .zero = true});
  network.memory = network.add({.kind = LayerKind::kReshape, .inputs = {next}, .channels = latent, .size = {1, 1}});
  read_of(of_fine.decode(network.memory, 1));
  return network;
}

}  // namespace pleat::superres
