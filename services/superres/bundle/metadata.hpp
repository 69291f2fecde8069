// What a model bundle says about itself: the file pleat.json inside the TorchScript archive (docs/superres.md).
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "common/features/channel_ranges.hpp"
#include "services/conversion/representation.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

inline constexpr int kBundleVersion = 2;  ///< version of pleat.json that this program writes and reads

/// Everything that pleat.json holds.
struct Metadata {
  std::string name;                               ///< the bundle's name; its file is <name>.pt
  Architecture architecture;                      ///< of a module made elsewhere only the kind counts
  conversion::RepresentationSpec representation;  ///< how conversion has to be set up
  ChannelRanges input, output;                    ///< of the channels of one frame, and of an answer; not empty
  int constants = 0;                              ///< channels of what the network reads beside the frames
  /// Height and width of what it reads, for networks that fit one size alone; zeros: the representation says it, or
  /// any.
  std::array<int, 2> input_size = {};
  /// (channels, height, width) of what it remembers from frame to frame; zeros: nothing. Its module has forward(x,
  /// memory), which returns the answer and what is remembered after it; zeros in the beginning.
  std::array<int, 3> memory = {};
  std::string topology_hash;  ///< of the coarse mesh; empty: serves any mesh and any size of image
  /// (V x 3) rest positions of that mesh, by which one that was only moved or turned is known again; may be empty.
  std::vector<float> rest_positions;
  std::string velocity = "backward";  ///< v_k = (x_k - x_{k-1}) / frame time
  /// Parameters whose names begin with one of these stay float32 when the rest is turned into bfloat16. Empty: the
  /// module takes no bfloat16.
  std::vector<std::string> float32_parameters;
  std::string training = "{}";            ///< JSON: data set, sequences, epochs, losses
  std::map<std::string, double> metrics;  ///< for example "psnr_db", "vmse_m2", "barycentric_vmse_m2"
  std::string git_revision;
  std::int64_t parameters = 0;  ///< number of trained values
};

/// Numbers that the network remembers; 0: none.
inline std::size_t memory_values(const Metadata& metadata) {
  std::size_t count = 1;
  for (const int extent : metadata.memory) count *= static_cast<std::size_t>(extent);
  return count;
}

/// A bundle of geometry images that serves any mesh, with images as large as each mesh asks for.
void forget_mesh(Metadata& metadata);

/// What the network of a bundle is put between.
Ports ports_of(const Metadata& metadata);

/// The representation as JSON: protobuf's form of pleat.v1.Representation, ranges included.
std::string representation_json(const Metadata& metadata);

/// Metadata as pleat.json, indented.
std::string to_json(const Metadata& metadata);

/// Reads pleat.json. `source` is named in errors: kInvalidArgument for a wrong format, a version this program does not
/// know (with the command that re-exports older bundles), a missing or ill-typed key, sizes that contradict each other;
/// kDataLoss if the text is no JSON.
Metadata metadata_from_json(const std::string& text, const std::string& source);

}  // namespace pleat::superres
