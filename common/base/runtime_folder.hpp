// The folder of this user's sockets.
#pragma once

#include <filesystem>
#include <string>

namespace pleat {

/// $XDG_RUNTIME_DIR/pleat, or /tmp/pleat-UID without one.
std::filesystem::path runtime_folder();

/// The address of a service that is given none: "unix:RUNTIME_FOLDER/NAME.sock".
std::string default_address(const std::string& service);

/// Does nothing for sockets elsewhere. Throws kFailedPrecondition, naming the folder, if `socket` lies in the run-time
/// folder and that is a link, somebody else's, or open to others: who owns the folder owns the services. With `make` it
/// is made, mode 0700, if it is not there.
void check_runtime_folder(const std::filesystem::path& socket, bool make);

}  // namespace pleat
