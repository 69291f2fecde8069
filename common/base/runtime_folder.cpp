#include "common/base/runtime_folder.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>

#include "common/base/error.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kLongestPath = 70;  // a socket's whole path has room for 107 characters

}  // namespace

fs::path runtime_folder() {
  const char* runtime = std::getenv("XDG_RUNTIME_DIR");
  if (runtime != nullptr && *runtime == '/' && std::strlen(runtime) < kLongestPath) return fs::path(runtime) / "pleat";
  return "/tmp/pleat-" + std::to_string(::geteuid());
}

std::string default_address(const std::string& service) {
  return "unix:" + (runtime_folder() / (service + ".sock")).string();
}

void check_runtime_folder(const fs::path& socket, bool make) {
  const fs::path folder = runtime_folder();
  if (socket.parent_path().lexically_normal() != folder.lexically_normal()) return;
  const auto refuse = [&](const std::string& cause) {
    throw Error(ErrorCode::kFailedPrecondition,
                folder.string() + ": " + cause + "; remove it, or name a socket elsewhere with --listen");
  };
  if (make && ::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) {
    refuse(std::string("can't be made: ") + std::strerror(errno));
  }
  struct stat status {};
  if (::lstat(folder.c_str(), &status) != 0) return;  // nothing to connect to
  if (!S_ISDIR(status.st_mode)) refuse("is no folder");
  if (status.st_uid != ::geteuid()) refuse("belongs to another user");
  if ((status.st_mode & 077) != 0) refuse("is open to other users");
}

}  // namespace pleat
