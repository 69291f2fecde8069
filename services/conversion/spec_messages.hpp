// Messages of representations -> what this room makes of them.
#pragma once

#include <cstdint>

#include "pleat/v1/common.pb.h"
#include "services/conversion/representation.hpp"

namespace pleat::conversion {

/// max_texels: larger fine images are refused when they are made. Throws kInvalidArgument for a kind that this service
/// does not know, and for numbers out of range.
RepresentationSpec spec_from(const v1::Representation& message, std::int64_t max_texels);

/// channels: the count expected. Throws kInvalidArgument beginning with `field`.
ChannelRanges ranges_from(const v1::ChannelRanges& message, std::size_t channels, const std::string& field);

}  // namespace pleat::conversion
