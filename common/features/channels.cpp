#include "common/features/channels.hpp"

#include <algorithm>

namespace pleat {

const std::vector<std::string>& frame_channel_names() {
  static const std::vector<std::string> names{"displacement_x", "displacement_y", "displacement_z",
                                              "normal_x",       "normal_y",       "normal_z",
                                              "velocity_x",     "velocity_y",     "velocity_z"};
  return names;
}

int find_frame_channels(const std::vector<std::string>& names, int first) {
  const auto found = std::find(names.begin(), names.end(), frame_channel_names().at(static_cast<std::size_t>(first)));
  return found == names.end() ? -1 : static_cast<int>(found - names.begin());
}

}  // namespace pleat
