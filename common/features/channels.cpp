#include "common/features/channels.hpp"

namespace pleat {

const std::vector<std::string>& frame_channel_names() {
  static const std::vector<std::string> names{"displacement_x", "displacement_y", "displacement_z",
                                              "normal_x",       "normal_y",       "normal_z",
                                              "velocity_x",     "velocity_y",     "velocity_z"};
  return names;
}

}  // namespace pleat
