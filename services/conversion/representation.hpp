// What a network sees of a cloth frame, and what its answer means: the one interface of conversion. A representation
// owns both meshes; a network maps tensors to tensors and knows none. docs/extending.md says how to add one.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <variant>
#include <vector>

#include "common/features/channel_ranges.hpp"
#include "common/frame/frame.hpp"
#include "common/frame/obstacle_field.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/conversion/geometry_image/image_spec.hpp"
#include "services/conversion/vertex_features/vertex_spec.hpp"
#include "services/conversion/vertex_reads.hpp"

namespace pleat::conversion {

/// Frames that a network may read at once.
inline constexpr int kMaxWindow = 16;

/// What decides a representation, besides the coarse mesh. One kind of the variant per folder of this room.
struct RepresentationSpec {
  std::variant<GeometryImageSpec, VertexFeatureSpec> kind;
  SubdivisionSpec subdivision;
  int window = 1;         ///< frames that the network reads, 1 to kMaxWindow
  int window_stride = 1;  ///< from one of them to the next, 1 to kMaxWindow
};

/// What a spec says of a network's answers before there is a mesh.
struct AnswerForm {
  int scale = 1;             ///< an answer is that many times as high and wide as what the network reads
  bool detail = false;       ///< an answer of zeros is the upsampled coarse mesh
  bool own_axes = false;     ///< its vectors are in the cloth's own axes, answer_axes() below
  bool first_three = false;  ///< decode() reads no more than the first three channels
  int block = 1;  ///< of the scale^2 values that an answer has for a place of the input, so many mean something: the
                  ///< first ones, row by row
  /// Height and width of what the network reads, if the spec fixes them.
  std::optional<std::array<std::int64_t, 2>> input_size;
};
AnswerForm answer_form(const RepresentationSpec& spec);

/// Values here are physical (metres, m/s, no unit); ChannelRanges are taken off and put back outside, with normalize()
/// and denormalize(). Constants are the exception: they come as the network reads them.
/// Immutable: every const member may be called from several threads. Those that write into the caller's memory take
/// none of their own once they have run.
class Representation {
 public:
  virtual ~Representation() = default;

  /// As it was asked for, with the sizes that were chosen here.
  virtual const RepresentationSpec& spec() const = 0;
  virtual const Topology& coarse() const = 0;
  /// The fine mesh, and how it comes from the coarse one. Without parents (parent_face empty) if the fine mesh was
  /// given.
  virtual const Subdivision& subdivision() const = 0;
  const Topology& fine() const { return subdivision().fine; }

  /// Extents of what one frame gives and of one answer, channels first; and the channels' names.
  virtual std::vector<std::int64_t> input_shape() const = 0;
  virtual std::vector<std::int64_t> answer_shape() const = 0;
  virtual std::vector<std::string> input_channels() const = 0;
  virtual std::vector<std::string> answer_channels() const = 0;

  /// What the network reads besides the frames: (C, ...), the same for the whole stream. Without a shape: nothing.
  virtual const Tensor& constants() const = 0;

  /// The rigid alignment of a coarse frame, which its encoding, target and answer share.
  virtual RigidTransform align(const Positions& coarse) const = 0;

  /// A window of coarse frames as the network reads it: (T C, ...), the oldest frame's channels first. frames: T >= 1,
  /// the newest last; all in the alignment of the newest one. obstacles: of the newest frame; read by those that
  /// reads_obstacles(), null is none. Throws kInvalidArgument for a wrong vertex count or values that are not finite.
  virtual void encode(std::span<const Frame> frames, const RigidTransform& alignment, Tensor& input,
                      ObstacleField* obstacles) const = 0;
  virtual bool reads_obstacles() const = 0;

  /// What the network should answer for a coarse frame whose fine frame is known. Throws as encode().
  virtual void target(const Frame& coarse, const Frame& fine, const RigidTransform& alignment,
                      Tensor& answer) const = 0;

  /// The fine positions (V_fine x 3) that an answer means, in the frame's own axes. Throws kInvalidArgument for an
  /// answer of another shape or values that are not finite.
  virtual void decode(const Tensor& answer, const Positions& coarse, const RigidTransform& alignment,
                      Positions& fine) const = 0;

  // What training needs beyond that.

  /// 1 where a place of the input or the answer holds a value of its own, 0 where it is padding.
  virtual const std::vector<std::uint8_t>& input_mask() const = 0;
  virtual const std::vector<std::uint8_t>& answer_mask() const = 0;
  /// decode() without the base, as a linear map: reads of the answer's first three channels, after turned by
  /// answer_axes() where that gives any. Corrections that decode() makes of the result by further channels are not in
  /// it; there are none where the answer is a target().
  virtual const VertexReads& reads() const = 0;
  /// The axes in which the answer's vectors are given: (3 x 3, h, w), three unit vectors at each place of the *input*,
  /// in the alignment's axes; enlarged bilinearly they belong to the places of the answer. Without a shape: the
  /// alignment's own axes.
  virtual void answer_axes(const Positions& coarse, const RigidTransform& alignment, Tensor& axes) const = 0;
  /// decode() of an answer of zeros, in the alignment's axes: what reads() adds to. (V_fine x 3).
  virtual void base(const Positions& coarse, const RigidTransform& alignment, Positions& fine) const = 0;

  /// Whether normalised values fit numbers of 11 significant bits: details do, positions in a room do not.
  virtual bool fits_half() const = 0;

  /// How much it remembers, in vertices and texels: what its memory is proportional to.
  virtual std::size_t size() const = 0;
};

/// fine: nullptr, and the fine mesh is made by spec.subdivision; or a fine mesh with material coordinates in the same
/// space. Throws kInvalidArgument (unusable topology or material coordinates, a spec out of range, a kind that needs
/// to know where the fine mesh comes from), kResourceExhausted (larger than the spec allows).
std::unique_ptr<const Representation> make_representation(const Topology& coarse, const RepresentationSpec& spec,
                                                          const Topology* fine = nullptr);

}  // namespace pleat::conversion
