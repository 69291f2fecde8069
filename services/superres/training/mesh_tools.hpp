// Meshes around a training: the judge of answers, what losses on vertices read, and the directions of a flat sheet.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "services/conversion/representation.hpp"
#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// The coarse meshes of some frames, and of those that are validated the fine ones too.
class FrameMeshes final : public FrameGeometry {
 public:
  using SharedRepresentation = std::shared_ptr<const conversion::Representation>;

  explicit FrameMeshes(ChannelRanges output) : output_(std::move(output)) {}

  /// representation: of the sequence's mesh.
  void add(std::size_t sequence, std::size_t frame, SharedRepresentation representation, Positions coarse,
           Positions fine);

  void axes(std::size_t sequence, std::size_t frame, Tensor& axes) const override;
  void base(std::size_t sequence, std::size_t frame, Positions& positions) const override;

  struct Meshes {
    Positions coarse, fine;
    RigidTransform alignment;
    SharedRepresentation representation;
  };
  /// Throws kInternal for a frame that was not added.
  const Meshes& at(std::size_t sequence, std::size_t frame) const;
  const ChannelRanges& output() const { return output_; }

 private:
  ChannelRanges output_;
  std::map<std::pair<std::size_t, std::size_t>, Meshes> meshes_;
};

/// Judges by the meshes of the validation frames.
class FrameJudge final : public MeshJudge {
 public:
  explicit FrameJudge(std::shared_ptr<const FrameMeshes> meshes) : meshes_(std::move(meshes)) {}

  double squared_error(std::size_t sequence, std::size_t frame, std::span<const float> answer) override;
  double barycentric_squared_error(std::size_t sequence, std::size_t frame) override;
  std::vector<float> barycentric_answer(std::size_t sequence, std::size_t frame) override;

 private:
  const FrameMeshes::Meshes& validated(std::size_t sequence, std::size_t frame) const;

  std::shared_ptr<const FrameMeshes> meshes_;
};

MeshRead make_mesh_read(const conversion::Representation& representation);

/// What a network needs to know to convolve on the meshes of a representation of vertex features; null for another.
std::shared_ptr<const MeshPorts> make_mesh_ports(const conversion::Representation& representation);

/// u and v directions if the rest positions are an affine function of the material coordinates, and those are mirror
/// symmetric as a rectangle is; else empty.
std::vector<std::array<float, 3>> flat_sheet_axes(const Topology& mesh);

}  // namespace pleat::superres
