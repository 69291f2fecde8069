// The networks that can be trained here. A new one is a folder beside this file and a line in registry.cpp.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "services/superres/networks/description.hpp"

namespace pleat::superres {

/// Which network, and its sizes.
struct Architecture {
  /// One of network_kinds(), or the author's own word for a module made elsewhere.
  std::string kind = "mfsr";
  std::string options = "{}";  ///< JSON object; its keys are the kind's own (docs/superres.md)
};

/// The meshes behind the places, for networks that convolve on them.
struct MeshPorts {
  int corners = 0;                      ///< a place of the input has so many, their channels one after the other
  int features = 0;                     ///< the first channels of each: rotation and stretch of its one-ring
  PlaceMap coarse, coarse_ring;         ///< coarse vertices: corners that hold them; their neighbours
  PlaceMap fine, fine_ring, fine_read;  ///< fine vertices of an answer: where they are read; their neighbours; and the
                                        ///< vertex at each place of an answer
};

/// What a network is put between. All of it follows from the representation.
struct Ports {
  int inputs = 1;       ///< channels of what it reads: those of every frame of the window, then the constant ones
  int outputs = 1;      ///< channels of its answer
  int scale = 1;        ///< its answer is that many times as high and wide
  bool detail = false;  ///< the answer is added to an upsampled mesh: without training it is zero
  int window = 1;       ///< frames that it reads at once
  int constants = 0;    ///< of the inputs
  int block = 0;        ///< values of the scale^2 of a place and channel that mean something, the first ones; 0: all
  /// Null where the meshes are not known: then a network that needs them is described by its ends alone.
  std::shared_ptr<const MeshPorts> mesh = {};
};

std::vector<std::string> network_kinds();
bool is_registered(const std::string& kind);

/// The architecture with every option in place. Throws kInvalidArgument for another kind, an unknown option, or a value
/// out of range.
Architecture complete(const Architecture& architecture);

/// The network's layers. Throws as complete().
Description describe(const Architecture& architecture, const Ports& ports);

}  // namespace pleat::superres
