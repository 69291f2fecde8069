#include "common/base/text_file.hpp"

#include <fstream>

#include "common/base/error.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHead = 512;
constexpr std::string_view kPlaceholders[][2] = {{"version https://git-lfs", "Git LFS"},
                                                 {"version https://hawser", "Git LFS"},
                                                 {"/annex/objects/", "git-annex"},
                                                 {"../.git/annex/objects/", "git-annex"}};

void refuse_placeholder(std::string_view head, const std::string& name) {
  for (const auto& [begin, system] : kPlaceholders) {
    if (head.starts_with(begin)) {
      throw_invalid_argument(name + ": is a placeholder of " + std::string(system) + ", not the file");
    }
  }
}

}  // namespace

void check_text(std::string_view head, const std::string& name) {
  using namespace std::string_view_literals;
  refuse_placeholder(head, name);
  const bool wide = head.starts_with("\xFF\xFE\0\0"sv) || head.starts_with("\0\0\xFE\xFF"sv);
  const bool marked = head.starts_with("\xFF\xFE"sv) || head.starts_with("\xFE\xFF"sv);
  if (wide || marked) {
    throw_invalid_argument(name + ": is text in " + (wide ? "UTF-32" : "UTF-16") + "; save it as UTF-8");
  }
  const std::size_t zero = head.substr(0, kHead).find('\0');
  if (zero == std::string_view::npos) return;
  // Text of two bytes a character has a zero in every other one.
  const bool sixteen = zero < 2 && head.size() >= 4 && head[zero + 2] == '\0' && head[zero ^ 1] != '\0';
  throw_invalid_argument(name + (sixteen ? ": is text in UTF-16; save it as UTF-8" : ": has zero bytes: is no text"));
}

void refuse_placeholder(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  std::string head(kHead, '\0');
  stream.read(head.data(), static_cast<std::streamsize>(head.size()));
  head.resize(static_cast<std::size_t>(stream.gcount()));
  refuse_placeholder(head, path.string());
}

std::string read_text_file(const fs::path& path, std::size_t limit) {
  std::error_code failed;
  std::ifstream stream(path, std::ios::binary);
  if (!stream || fs::is_directory(path, failed)) throw_not_found(path.string() + ": can't be read");
  std::string text;
  std::string block(std::size_t{1} << 16, '\0');
  while (stream.read(block.data(), static_cast<std::streamsize>(block.size())) || stream.gcount() > 0) {
    text.append(block, 0, static_cast<std::size_t>(stream.gcount()));
    if (text.size() > limit) {
      throw Error(ErrorCode::kResourceExhausted, path.string() + ": more than " + std::to_string(limit) + " bytes");
    }
  }
  check_text(text, path.string());
  if (text.starts_with(kByteOrderMark)) text.erase(0, kByteOrderMark.size());
  return text;
}

}  // namespace pleat
