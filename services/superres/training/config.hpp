// What pleat-train reads. docs/training.md documents every key; the names here are the names there.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "services/conversion/representation.hpp"
#include "services/superres/networks/registry.hpp"

namespace pleat::superres {

/// How conversion makes a geometry image (docs/conversion.md).
struct ImagesConfig {
  std::string layout = "published";         ///< "published", "detail" or "positions"
  std::string base = "vertices";            ///< of "detail": where it is added, at "vertices" or "texels"
  std::string units = "metres";             ///< of "detail": "metres", or "coarse_edges", which are of no mesh
  int coarse_width = 0, coarse_height = 0;  ///< texels; 0: chosen from texels_per_fine_vertex
  int scale = conversion::kDefaultScale;    ///< answers are that many times as high and wide
  double texels_per_fine_vertex = conversion::ImageSpec{}.texels_per_fine_vertex;
  std::string method = "fitted";                  ///< "fitted" or "sampled" fine images
  double lambda = conversion::kDefaultFitWeight;  ///< smoothness of fitted images
};

/// How conversion makes vertex features (docs/vertex-features.md).
struct FeaturesConfig {
  std::string rotation = "logarithm";       ///< "logarithm" or "quaternion"
  std::string axes = "heading";             ///< of the values: "heading", turned with the cloth, or "fixed"
  int passes = conversion::kDefaultPasses;  ///< corrections of an answer's positions by its gradients
  double anchor_weight = conversion::kDefaultAnchorWeight;
  std::string answer = "gradients";  ///< or "features", "features_alone" (conversion::AnswerKind)
  bool obstacles = false;            ///< the network reads where obstacles are, too
  /// Of inputs and answers. "channel": mean and deviation of each; "group": one deviation for rotations, one for
  /// stretches and so on, zero at rest; "range": one smallest and largest value for each such group, mapped to -0.95 to
  /// 0.95, as published.
  std::string normalization = "channel";
};

/// Of networks that remember (Description::memory).
struct HistoryConfig {
  int frames = 8;       ///< consecutive frames of a window
  double share = 0.1;   ///< of the steps, in which a window's frames go on from the network's own answers
  int lead = 0;         ///< frames before such a window, from which on the answers are its own, without gradients
  double starts = 0.1;  ///< of the windows, which are the first frames of a sequence
  double noise = 0.03;  ///< deviation of what is added to true answers in the others, in units of the memory's own
};

/// Of networks with autoencoders (Description::twins).
struct AutoencoderConfig {
  int epochs = 0;      ///< in which they alone are trained; then they stay as they are
  double largest = 5;  ///< codes beyond +-largest cost something, linearly
};

struct LossConfig {
  double displacement = 0.9, normal = 0.03, velocity = 0.03, kinematic = 0.03;  ///< weights of [MFSR] eq. 6
  int frames = 3;                                                               ///< n of eq. 5
  /// Weights of the losses on the fine mesh that is read from the image: positions, normals, lengths of edges.
  double vertices = 0, vertex_normals = 0, edges = 0;
  double codes = 0;  ///< of the one on what the network remembers: squared difference to what a true answer would leave
  double wrinkles = 0;                 ///< of the one on the amount of wrinkling by scale, wherever the folds lie
  std::string target = "synthesized";  ///< d_k of eq. 5: "synthesized" (the paper) or "ground_truth" (its supplement)
  std::string alignment = "exact";     ///< "exact": each frame's own rigid alignment; "shared": the first one's, eq. 5
  /// "none": mean squares in normalised units, as published; "deviation": each channel is divided by the deviation of
  /// what the bilinearly upsampled coarse image lacks, so that the weights compare like with like.
  std::string scaling = "none";

  bool needs_normals() const { return vertex_normals > 0 || wrinkles > 0; }
  bool needs_vertices() const { return vertices > 0 || needs_normals() || edges > 0; }
};

struct OptimizerConfig {
  double learning_rate = 1e-4, beta1 = 0.9, beta2 = 0.9, epsilon = 1e-8;
  double clip = 0;  ///< largest norm of the whole gradient; 0: no limit
  double average =
      0;  ///< decay of the running mean of the weights that is validated and kept; 0: the weights themselves
};

struct ScheduleConfig {
  std::string kind = "step";        ///< "step", "cosine" or "constant"
  int step_epochs = 20;             ///< "step": divided by 10 every so many epochs ...
  int fixed_after = 60;             ///< ... until this epoch
  std::string progress = "epochs";  ///< "cosine": "epochs" of `epochs`, or "minutes" of `max_minutes`
  double final_factor = 0.01;       ///< "cosine": last rate over the first
  int warm_up_steps = 0;            ///< linear rise at the beginning
};

struct ValidationConfig {
  std::string split = "test";          ///< used if `sequences` is empty
  std::vector<std::string> sequences;  ///< named ones; they are left out of training whatever their split
  int every_frames = 8;                ///< every n-th frame, n being this
  int every_epochs = 1;
};

struct TrainConfig {
  std::string name;     ///< of the bundle
  std::string dataset;  ///< folder
  std::string output;   ///< folder: NAME.pt, log.csv, checkpoint.pt
  std::uint64_t seed = 1;
  Architecture architecture;
  std::string serves = "mesh";  ///< the data set's "mesh", or "any" in units that mean the same of each
  std::string representation = "geometry_image";  ///< or "vertex_features"
  ImagesConfig images;                            ///< of the former
  FeaturesConfig vertex_features;                 ///< of the latter
  int window = 1;                                 ///< frames that the network reads at once
  int window_stride = 1;                          ///< from one of them to the next
  HistoryConfig history;
  AutoencoderConfig autoencoders;
  LossConfig losses;
  OptimizerConfig optimizer;
  ScheduleConfig schedule;
  ValidationConfig validation;
  int epochs = 120;
  int batch = 16;           ///< windows a step; a window has losses.frames + 1 frames if losses.kinematic > 0, else 1
  int patch = 72;           ///< side of the coarse patches in texels; 0 or more than the image: whole images
  int every_frames = 1;     ///< of training sequences: every n-th frame, for data sets with more than time allows
  int steps_per_epoch = 0;  ///< 0: as many as show as many frames as the training split has
  bool mirror = false;      ///< mirrored copies in u, v and across the sheet; needs a flat rest mesh
  std::string precision = "float32";  ///< of the body: "float32" or "bfloat16"
  std::string kernels = "own";   ///< on the CPU: "own" convolutions (services/superres/cpu), or those of "libtorch"
  std::string device = "auto";   ///< "auto", "cpu" or "cuda"
  std::string cache = "uint16";  ///< answers in memory: "uint16" (fixed point) or "float32"
  std::string cache_folder;      ///< files of the images, which are mapped into memory; empty: DATASET/images
  int cache_limit_mb = 32768;    ///< of them together
  bool strict = false;           ///< sequences that can't be used are an error, not a warning
  int threads = 0;               ///< 0: all processors this process may use
  double max_minutes = 0;        ///< of `clock`, over all resumed runs; 0: no limit
  std::string clock = "wall";    ///< "wall", or "processor": time that the (first) process computed
  double checkpoint_minutes = 2;
  /// Windows that one pass holds; a step adds up the gradients of several. 0: all of them, fewer after the device ran
  /// out of memory.
  int micro_batch = 0;
  /// The channels of a frame to the same, in the units of the data set's own normalisation.
  bool published_images() const { return representation == "geometry_image" && images.layout == "published"; }
  std::string initial;  ///< check-point or model bundle whose weights begin the training; empty: fresh weights
};

/// Throws kInvalidArgument, beginning with `where`, unless a network that reads its own last answers can learn this
/// way.
void check_remembering(const TrainConfig& config, const std::string& where = "");

/// Reads JSON. An unknown key, an ill-typed value or one out of range is kInvalidArgument and names the key with its
/// place, for example "optimizer.learning_rate"; text that is no JSON too.
TrainConfig train_config_from_json(const std::string& text, const std::string& source);
/// The same from a file. Key "base" names another file, relative to it, whose keys hold where the file has none.
/// `changes` are "key=value" or "section.key=value", applied last; a value that is no JSON is a string.
/// kNotFound if a file can't be read.
TrainConfig read_train_config(const std::string& path, const std::vector<std::string>& changes = {});

/// All keys, with defaults filled in.
std::string to_json(const TrainConfig& config);

/// The first key, among those that change what is computed, in which two configurations differ; "" if none. A key that
/// is missing, because the configuration is older than the key, has its default. Time limits, threads, folders and the
/// number of epochs may change between a run and its resumption.
std::string first_difference(const std::string& a, const std::string& b);

}  // namespace pleat::superres
