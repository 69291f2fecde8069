// What a model bundle says about itself: the file pleat.json inside the TorchScript archive (docs/superres.md).
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace pleat::superres {

inline constexpr int kChannels = 9;       ///< displacement, normal and velocity, three each
inline constexpr int kScale = 4;          ///< fine image : coarse image, in both directions
inline constexpr int kBundleVersion = 1;  ///< version of pleat.json that this program writes and reads

/// The names of the nine channels, in tensor order.
const std::vector<std::string>& channel_names();

/// A network of the registry. The defaults are the published [MFSR] one (section 5.1 and figure 4).
struct Architecture {
  int blocks = 16;    ///< residual dense blocks, or residual blocks
  int layers = 6;     ///< densely connected layers in a block ("mfsr")
  int growth = 32;    ///< features that a layer adds ("mfsr")
  int features = 64;  ///< features between the blocks
  /// "bilinear": features are upsampled, then each head is one 3x3 convolution (published).
  /// "subpixel": each head is one 3x3 convolution at the coarse size to 16 values a texel and channel, rearranged.
  std::string upsampling = "bilinear";
  /// What the heads' answer is added to: "none" (published), "bilinear": the bilinearly upsampled coarse image, or
  /// "mesh": the barycentrically upsampled coarse mesh, recovered from the coarse image (docs/superres.md). A network
  /// with "mesh" also sees where the coarse triangles lie, and serves one mesh and image size only.
  std::string residual = "none";
  /// "aligned": the network works in the axes of the rigid alignment (published); "local": it reads strain, curvature
  /// and velocity in the axes of the cloth at each texel and answers in them, so that it need not learn that a fold is
  /// the same fold in every direction. Needs residual "mesh" and conditioned.
  std::string axes = "aligned";
  bool conditioned = false;  ///< inputs standardised, plus their local detail as nine more channels; outputs scaled
  /// One of architecture_kinds(): "mfsr"; "srresnet": the same around residual blocks instead of dense ones ([MFSR]
  /// figure 13); "chen2018": residual blocks on positions alone ([MFSR]'s reference [13]). Or the author's own word for
  /// a module made elsewhere.
  std::string kind = "mfsr";
};

/// The networks that can be trained here.
const std::vector<std::string>& architecture_kinds();
bool is_registered(const Architecture& architecture);
/// True if the network holds constants of one mesh, so that it serves one mesh and image size only.
bool needs_mesh(const Architecture& architecture);

/// Throws kInvalidArgument for sizes that make no network or one beyond all sense (limits in docs/superres.md).
void validate(const Architecture& architecture);

/// Per-channel range that conversion maps to [0,1].
struct Normalization {
  std::array<float, kChannels> minimum{};
  std::array<float, kChannels> maximum{};
};

/// Everything that pleat.json holds.
struct Metadata {
  std::string name;           ///< the bundle's name; its file is <name>.pt
  Architecture architecture;  ///< of a module made elsewhere only the kind counts
  int scale = kScale;
  std::vector<std::string> channels = channel_names();
  Normalization normalization;
  int coarse_width = 0, coarse_height = 0;  ///< texels
  int fine_width = 0, fine_height = 0;      ///< texels; exactly scale times the coarse size
  std::string image_spec = "{}";            ///< JSON: how conversion has to make the images (method, size, margin)
  std::string topology_hash;          ///< of the coarse mesh; empty: serves any mesh whose images have these sizes
  std::string velocity = "backward";  ///< v_k = (x_k - x_{k-1}) / frame time
  /// Parameters whose names begin with one of these stay float32 when the rest is turned into bfloat16: the first
  /// convolutions read displacements of metres in which the wrinkles are millimetres. Empty: the module takes no
  /// bfloat16.
  std::vector<std::string> float32_parameters;
  std::string training = "{}";            ///< JSON: data set, sequences, epochs, losses
  std::map<std::string, double> metrics;  ///< for example "psnr_db", "vmse_m2", "barycentric_vmse_m2"
  std::string git_revision;
  std::int64_t parameters = 0;  ///< number of trained values
};

/// Metadata as pleat.json, indented.
std::string to_json(const Metadata& metadata);

/// Reads pleat.json. `source` is named in errors: kInvalidArgument for a wrong format, a version this program does not
/// know, a missing or ill-typed key, sizes that contradict each other; kDataLoss if the text is no JSON.
Metadata metadata_from_json(const std::string& text, const std::string& source);

}  // namespace pleat::superres
