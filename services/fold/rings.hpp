// The neighbours of each vertex of a mesh, in one array.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::fold {

class Rings {
 public:
  enum Border { kAll, kAlongBorders };  ///< of a vertex on a border: all neighbours, or those on the border alone

  Rings() = default;
  explicit Rings(const Topology& mesh, Border border = kAll);

  /// In the order of the mesh's edges.
  std::span<const std::uint32_t> of(std::uint32_t vertex) const {
    return std::span(neighbours_).subspan(begin_[vertex], begin_[vertex + 1] - begin_[vertex]);
  }

 private:
  std::vector<std::uint32_t> begin_, neighbours_;
};

}  // namespace pleat::fold
