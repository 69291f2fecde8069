// Triangle meshes as plain values: the types that every room shares.
// Units are metres, Y is up, faces are counter-clockwise, arrays are row-major.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace pleat {

using Positions = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;  ///< (V x 3) metres, or m/s for velocities
using Faces = Eigen::Matrix<std::uint32_t, Eigen::Dynamic, 3, Eigen::RowMajor>;  ///< (F x 3) vertex indices
using Uv = Eigen::Matrix<float, Eigen::Dynamic, 2, Eigen::RowMajor>;  ///< (U x 2) material coordinates, metres
using Edges =
    Eigen::Matrix<std::uint32_t, Eigen::Dynamic, 2, Eigen::RowMajor>;  ///< (E x 2) vertex indices, first < second

/// What stays constant in a session: rest shape and connectivity. A seam vertex has several material coordinates,
/// therefore the material coordinates have faces of their own, in the same face order.
struct Topology {
  Positions rest_positions;  ///< (V x 3)
  Faces faces;               ///< (F x 3) into rest_positions
  Uv uv;                     ///< (U x 2); empty if the mesh has no material coordinates
  Faces uv_faces;            ///< (F x 3) into uv; empty with uv

  Eigen::Index vertex_count() const { return rest_positions.rows(); }
  Eigen::Index face_count() const { return faces.rows(); }
};

/// Area-weighted unit vertex normals ([MFSR-S] eq. 1). A vertex without area gets (0,1,0). O(V + F).
/// positions: (V x 3). Returns (V x 3).
Positions vertex_normals(const Positions& positions, const Faces& faces);
/// The same into memory that is reused.
void vertex_normals(const Positions& positions, const Faces& faces, Positions& normals);

/// Throws kInvalidArgument unless the topology is usable: finite values, indices in range, no face with a repeated
/// vertex, at most two faces on an edge and consistently oriented, uv_faces of the same size as faces (or both empty).
/// `name` is named in the message. O(F log F).
void validate_topology(const Topology& topology, const std::string& name);

/// Throws kInvalidArgument if the material coordinates are absent, or a face has (almost) no area in them, or faces of
/// one mesh have both orientations (folded). The face is named. Needed for simulation and conversion.
void validate_material_coordinates(const Topology& topology, const std::string& name);

/// 64-bit FNV-1a over sizes, faces, uv_faces, rest positions and uv (bit patterns), as 16 hexadecimal digits.
/// Equal hashes mean that maps, factorisations and bundles made for one mesh serve the other.
std::string topology_hash(const Topology& topology);

}  // namespace pleat
