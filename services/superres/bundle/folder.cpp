#include "services/superres/bundle/folder.hpp"

#include <caffe2/serialize/inline_container.h>

#include <algorithm>
#include <filesystem>

#include "common/base/error.hpp"

namespace pleat::superres {

namespace fs = std::filesystem;

namespace {

const std::string kRecord = "extra/pleat.json";

}  // namespace

std::vector<std::string> list_bundles(const std::string& folder) {
  std::error_code error;
  fs::directory_iterator files(folder, error);
  if (error) throw_not_found(folder + ": no folder of model bundles: " + error.message());
  std::vector<std::string> names;
  for (const auto& file : files) {
    if (file.path().extension() == ".pt" && file.is_regular_file(error)) names.push_back(file.path().stem().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

std::string bundle_path(const std::string& folder, const std::string& name) {
  const std::string file = name.size() > 3 && name.ends_with(".pt") ? name : name + ".pt";
  if (name.empty() || name.find_first_of(std::string("/\\\0", 3)) != std::string::npos || name.find("..") == 0) {
    throw_invalid_argument("model bundle '" + name + "': only names of files in " + folder + " are allowed");
  }
  std::error_code error;
  const fs::path root = fs::canonical(folder, error);
  if (error) throw_not_found(folder + ": no folder of model bundles: " + error.message());
  const fs::path path = fs::canonical(root / file, error);
  if (error || !fs::is_regular_file(path))
    throw_not_found("model bundle '" + name + "': no file " + folder + "/" + file);
  if (path.parent_path() != root) {
    throw_invalid_argument("model bundle '" + name + "' leads outside " + folder);
  }
  return path.string();
}

bool is_bundle(const std::string& path) {
  try {
    return caffe2::serialize::PyTorchStreamReader(path).hasRecord(kRecord);
  } catch (const std::exception&) {
    return false;
  }
}

Metadata read_metadata(const std::string& path) {
  std::string text;
  try {
    caffe2::serialize::PyTorchStreamReader archive(path);
    if (!archive.hasRecord("constants.pkl") || !archive.hasRecord("data.pkl")) {
      throw_data_loss(path + ": no readable TorchScript archive");
    }
    if (!archive.hasRecord(kRecord)) {
      throw_invalid_argument(path + ": a TorchScript file without pleat.json is no model bundle");
    }
    const auto [data, size] = archive.getRecord(kRecord);
    text.assign(static_cast<const char*>(data.get()), size);
  } catch (const Error&) {
    throw;
  } catch (const std::exception& error) {
    const std::string cause = error.what();
    throw_data_loss(path + ": no readable TorchScript archive (truncated?): " + cause.substr(0, cause.find('\n')));
  }
  return metadata_from_json(text, path);
}

Metadata read_metadata(const std::string& folder, const std::string& name) {
  return read_metadata(bundle_path(folder, name));
}

}  // namespace pleat::superres
