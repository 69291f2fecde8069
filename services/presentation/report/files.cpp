#include "services/presentation/report/files.hpp"

#include <fstream>
#include <system_error>

#include "common/base/error.hpp"

namespace pleat::presentation {

void write_file_atomically(const std::filesystem::path& path, std::string_view content) {
  std::error_code failure;
  if (path.has_parent_path()) std::filesystem::create_directories(path.parent_path(), failure);
  std::filesystem::path temporary = path;
  temporary += ".tmp";
  {
    std::ofstream file(temporary, std::ios::binary);
    if (!file) throw_invalid_argument("can't write " + path.string());
    file.write(content.data(), static_cast<std::streamsize>(content.size()));
    file.close();
    if (!file) {
      std::filesystem::remove(temporary, failure);
      throw Error(ErrorCode::kResourceExhausted, "could not write all of " + path.string() + " (disk full?)");
    }
  }
  std::filesystem::rename(temporary, path, failure);
  if (failure) throw_invalid_argument("can't replace " + path.string() + ": " + failure.message());
}

}  // namespace pleat::presentation
