#include "services/superres/bundle/archive.hpp"

#include <minizip/unzip.h>

#include <array>
#include <memory>
#include <vector>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

struct Close {
  void operator()(void* archive) const { unzClose(archive); }
};

void check_record(unzFile archive, const std::string& path) {
  std::array<char, 256> name{};
  unz_file_info64 info{};
  if (unzGetCurrentFileInfo64(archive, &info, name.data(), name.size() - 1, nullptr, 0, nullptr, 0) != UNZ_OK ||
      unzOpenCurrentFile(archive) != UNZ_OK) {
    throw_data_loss(path + ": no readable TorchScript archive");
  }
  std::vector<char> block(1 << 16);
  int read = 0;
  do {
    read = unzReadCurrentFile(archive, block.data(), static_cast<unsigned>(block.size()));
  } while (read > 0);
  if (unzCloseCurrentFile(archive) != UNZ_OK || read < 0) {
    throw_data_loss(path + ": its record " + name.data() + " is damaged (its checksum is another)");
  }
}

}  // namespace

void check_archive(const std::string& path) {
  const std::unique_ptr<void, Close> archive(unzOpen64(path.c_str()));
  if (!archive) throw_data_loss(path + ": no readable TorchScript archive (truncated?)");
  int next = unzGoToFirstFile(archive.get());
  for (; next == UNZ_OK; next = unzGoToNextFile(archive.get())) check_record(archive.get(), path);
  if (next != UNZ_END_OF_LIST_OF_FILE) throw_data_loss(path + ": no readable TorchScript archive (truncated?)");
}

}  // namespace pleat::superres
