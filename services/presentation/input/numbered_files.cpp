#include "services/presentation/input/numbered_files.hpp"

#include <glob.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <optional>

#include "common/base/error.hpp"
#include "common/mesh/mesh_file.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;

bool is_digit(char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; }

/// A name as texts around runs of digits: "v2_c-01.obj" is {"v", "_c-", ".obj"} and {2, 1}.
struct Parts {
  std::vector<std::string> texts{""};
  std::vector<long long> numbers;
};

Parts take_apart(const std::string& name) {
  Parts parts;
  for (std::size_t i = 0; i < name.size();) {
    if (!is_digit(name[i])) {
      parts.texts.back() += name[i++];
      continue;
    }
    std::size_t end = i;
    while (end < name.size() && is_digit(name[end])) ++end;
    std::string& before = parts.texts.back();
    long long number = 0;
    if (std::from_chars(name.data() + i, name.data() + end, number).ec != std::errc{}) {
      before.append(name, i, end - i);  // no frame's number
      i = end;
      continue;
    }
    const bool negative =
        before.ends_with('-') && (i == 1 || std::isalnum(static_cast<unsigned char>(name[i - 2])) == 0);
    if (negative) before.pop_back();
    parts.numbers.push_back(negative ? -number : number);
    parts.texts.emplace_back();
    i = end;
  }
  return parts;
}

struct Frame {
  long long number = 0;
  fs::path file;
};

std::vector<fs::path> in_order(std::vector<Frame> frames, const std::string& source) {
  std::sort(frames.begin(), frames.end(), [](const Frame& a, const Frame& b) {
    return a.number != b.number ? a.number < b.number : a.file < b.file;
  });
  std::vector<fs::path> files;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (i > 0 && frames[i].number == frames[i - 1].number) {
      throw_invalid_argument(source + ": " + files.back().filename().string() + " and " +
                             frames[i].file.filename().string() + " are both frame " +
                             std::to_string(frames[i].number));
    }
    if (i > 0 && frames[i].number != frames[i - 1].number + 1) {
      throw_not_found(source + ": frame " + std::to_string(frames[i - 1].number + 1) + " is missing");
    }
    files.push_back(std::move(frames[i].file));
  }
  return files;
}

/// Finds the number in which the names differ.
std::vector<fs::path> by_number(const std::vector<fs::path>& files, const std::string& source) {
  if (files.size() == 1) return files;
  std::vector<Parts> parts;
  for (const fs::path& file : files) parts.push_back(take_apart(file.filename().string()));
  std::optional<std::size_t> place;
  for (std::size_t i = 1; i < files.size(); ++i) {
    const auto fail = [&] {
      throw_invalid_argument(source + ": the names " + files[0].filename().string() + " and " +
                             files[i].filename().string() +
                             " differ in more than a number; name the frames by a pattern such as cloth_%04d.obj");
    };
    if (parts[i].texts != parts[0].texts) fail();
    for (std::size_t k = 0; k < parts[i].numbers.size(); ++k) {
      if (parts[i].numbers[k] == parts[0].numbers[k]) continue;
      if (place && *place != k) fail();
      place = k;
    }
  }
  std::vector<Frame> frames;
  for (std::size_t i = 0; i < files.size(); ++i) frames.push_back({place ? parts[i].numbers[*place] : 0, files[i]});
  return in_order(std::move(frames), source);
}

std::vector<fs::path> files_of_folder(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder))
    if (entry.is_regular_file() && is_mesh_file(entry.path())) files.push_back(entry.path());
  if (files.empty()) throw_not_found(folder.string() + ": no .obj, .ply or other mesh file in this folder");
  std::sort(files.begin(), files.end());
  return files;
}

std::vector<fs::path> files_of_glob(const std::string& pattern) {
  glob_t found{};
  const int status = ::glob(pattern.c_str(), GLOB_TILDE, nullptr, &found);
  std::vector<fs::path> files(found.gl_pathv, found.gl_pathv + (status == 0 ? found.gl_pathc : 0));
  ::globfree(&found);
  if (files.empty()) throw_not_found(pattern + ": no file matches");
  return files;
}

/// The pattern is taken apart: it never reaches printf.
std::vector<fs::path> files_of_pattern(const std::string& source) {
  const auto percent = source.find('%');
  auto end = percent + 1;
  while (end < source.size() && is_digit(source[end])) ++end;
  if (end >= source.size() || source[end] != 'd' || source.find('%', end) != std::string::npos)
    throw_invalid_argument(source + ": a frame pattern needs exactly one %d, as in cloth_%04d.obj");
  const fs::path before = source.substr(0, percent);
  const std::string after = source.substr(end + 1), prefix = before.filename().string();
  const fs::path folder = before.parent_path().empty() ? fs::path(".") : before.parent_path();
  if (after.find('/') != std::string::npos)
    throw_invalid_argument(source + ": the frame number must be in the file's name, not in a folder's");
  if (!fs::is_directory(folder)) throw_not_found(folder.string() + ": no such folder");
  std::vector<Frame> frames;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (name.size() <= prefix.size() + after.size() || !name.starts_with(prefix) || !name.ends_with(after)) continue;
    const char *first = name.data() + prefix.size(), *last = name.data() + name.size() - after.size();
    long long number = 0;
    const auto parsed = std::from_chars(first, last, number);
    if (parsed.ec == std::errc{} && parsed.ptr == last) frames.push_back({number, entry.path()});
  }
  if (frames.empty()) throw_not_found(source + ": no file matches");
  return in_order(std::move(frames), source);
}

}  // namespace

std::vector<fs::path> numbered_files(const std::string& source) {
  std::error_code ignored;
  if (fs::is_directory(source, ignored)) return by_number(files_of_folder(source), source);
  if (source.find('%') != std::string::npos) return files_of_pattern(source);
  if (source.find_first_of("*?[") != std::string::npos) return by_number(files_of_glob(source), source);
  throw_not_found(source + ": no such file or folder");
}

std::vector<fs::path> numbered_files(const std::vector<std::string>& files) {
  std::vector<fs::path> paths;
  for (const std::string& file : files) {
    std::error_code ignored;
    if (!fs::is_regular_file(file, ignored)) throw_not_found(file + ": no such file");
    if (!is_mesh_file(file))
      throw_invalid_argument(file +
                             ": several files are frames of meshes, one each; caches and arrays are named alone");
    paths.emplace_back(file);
  }
  return by_number(paths, "the frames");
}

}  // namespace pleat::presentation
