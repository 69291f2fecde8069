#include "services/presentation/export/output_file.hpp"

#include <system_error>
#include <utility>

#include "common/base/error.hpp"

namespace pleat::presentation {

OutputFile::OutputFile(std::filesystem::path path) : path_(std::move(path)), temporary_(path_) {
  temporary_ += ".tmp";
  file_.open(temporary_, std::ios::binary | std::ios::trunc);
  if (!file_) throw_invalid_argument(path_.string() + ": can't be opened for writing");
}

OutputFile::~OutputFile() {
  if (committed_) return;
  file_.close();
  std::error_code ignored;
  std::filesystem::remove(temporary_, ignored);
}

void OutputFile::text(std::string_view characters) {
  file_.write(characters.data(), static_cast<std::streamsize>(characters.size()));
}

void OutputFile::commit() {
  file_.close();
  if (!file_) throw Error(ErrorCode::kResourceExhausted, path_.string() + ": writing failed (disk full?)");
  std::error_code failure;
  std::filesystem::rename(temporary_, path_, failure);
  if (failure) throw_invalid_argument(path_.string() + ": can't be replaced: " + failure.message());
  committed_ = true;
}

}  // namespace pleat::presentation
