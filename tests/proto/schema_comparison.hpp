// What clients of an older schema would trip over in a newer one.
#pragma once

#include <google/protobuf/descriptor.pb.h>

#include <string>
#include <vector>

namespace pleat::testing {

/// Every breaking difference, one line each, with the full name of what broke. Within a version only adding is allowed:
/// messages, fields, enum values, services and methods of `older` must be in `newer` with the same number, type, label,
/// presence, JSON name, oneof and streaming; numbers and names of reserved or removed things stay unused.
std::vector<std::string> breaking_changes(const google::protobuf::FileDescriptorSet& older,
                                          const google::protobuf::FileDescriptorSet& newer);

}  // namespace pleat::testing
