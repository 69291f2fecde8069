#include "common/base/version.hpp"

namespace pleat {

std::string version() { return PLEAT_VERSION; }

}  // namespace pleat
