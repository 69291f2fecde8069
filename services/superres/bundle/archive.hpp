// A bundle's file is a zip archive with a checksum for every record, which LibTorch's reader does not look at.
#pragma once

#include <string>

namespace pleat::superres {

/// Reads every record of the archive against its checksum. Throws kDataLoss, naming the record, where a bit is not what
/// was written; for a truncated or unreadable archive too. O(bytes): 1 ms for a shipped bundle.
void check_archive(const std::string& path);

}  // namespace pleat::superres
