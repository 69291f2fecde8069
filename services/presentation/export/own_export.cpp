#include "services/presentation/export/own_export.hpp"

#include <algorithm>
#include <fstream>

#include "common/base/hash.hpp"
#include "common/base/own_file.hpp"
#include "common/mesh/obj.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

constexpr const char* kCacheComment = "# cache ";
// The last one: of versions before the marks.
constexpr std::string_view kMarks[] = {kObjMark,
                                       kPlyMark,
                                       kUsdMark,
                                       kImageMark,
                                       "_ai_Description=written by Pleat",
                                       "\"generator\":\"written by Pleat\"",
                                       "comment metres, Y up\nelement vertex"};

/// The lines "# cache NAME HASH" at the begin of an OBJ of ours.
std::vector<std::string> read_cache_comments(const fs::path& obj) {
  std::vector<std::string> lines;
  if (!has_mark(obj, kMarks)) return lines;
  std::ifstream file(obj);
  std::string line;
  while (std::getline(file, line) && line.starts_with("#")) {
    if (line.starts_with(kCacheComment)) lines.push_back(line);
  }
  return lines;
}

std::string hash_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  Hash hash;
  std::string block(std::size_t{1} << 16, '\0');
  while (file.read(block.data(), static_cast<std::streamsize>(block.size())) || file.gcount() > 0) {
    hash.add(std::string_view(block).substr(0, static_cast<std::size_t>(file.gcount())));
  }
  return hash.hex();
}

/// The begin of the comment on a cache; its hash follows.
std::string comment_begin(const fs::path& cache) { return kCacheComment + cache.filename().string() + " "; }

bool is_own_cache(const fs::path& cache) {
  std::error_code ignored;
  if (!fs::is_regular_file(fs::symlink_status(cache, ignored))) return false;
  fs::path obj = cache;
  obj.replace_extension(".obj");
  const std::vector<std::string> lines = read_cache_comments(obj);
  return !lines.empty() && std::ranges::find(lines, comment_begin(cache) + hash_of(cache)) != lines.end();
}

}  // namespace

std::string cache_comments(const fs::path& obj, const fs::path& cache) {
  std::string text = comment_begin(cache) + hash_of(cache) + "\n";
  for (const std::string& line : read_cache_comments(obj)) {
    if (!line.starts_with(comment_begin(cache))) text.append(line).append("\n");
  }
  return text;
}

void require_own_exports(const std::vector<fs::path>& files) {
  for (const fs::path& file : files) {
    const bool cache = file.extension() == ".pc2" || file.extension() == ".mdd";
    require_absent_or(cache ? is_own_cache(file) : has_mark(file, kMarks), file);
  }
}

}  // namespace pleat::presentation
