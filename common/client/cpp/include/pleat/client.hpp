// The client of Pleat as an installation has it: #include <pleat/client.hpp>.
#pragma once

#include "common/client/cpp/client.hpp"
