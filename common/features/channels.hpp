// What a frame of cloth looks like to a network: nine features a vertex, in this order everywhere.
#pragma once

#include <string>
#include <vector>

namespace pleat {

/// Displacement from the rest positions (m), unit normal, velocity (m/s), three each, all in the axes of the rigid
/// alignment with the rest mesh.
inline constexpr int kFrameChannels = 9;
inline constexpr int kDisplacementChannel = 0, kNormalChannel = 3, kVelocityChannel = 6;

/// "displacement_x" ... "velocity_z": (9).
const std::vector<std::string>& frame_channel_names();

/// Where the three channels that begin as frame_channel_names()[first] do are among `names`; -1: nowhere.
int find_frame_channels(const std::vector<std::string>& names, int first);

}  // namespace pleat
