#include "services/superres/training/config.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common/base/error.hpp"
#include "services/conversion/representation.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

/// One visit lists every key of a section once; reading and writing share it.
template <typename Visitor, typename Config>
void visit(Visitor& v, Config& c) {
  v.value("name", c.name);
  v.value("dataset", c.dataset);
  v.value("output", c.output);
  v.value("seed", c.seed);
  v.architecture("architecture", c.architecture);
  v.choice("representation", c.representation, {"geometry_image", "vertex_features"});
  v.section("vertex_features", [&] {
    v.choice("rotation", c.vertex_features.rotation, {"logarithm", "quaternion"});
    v.choice("axes", c.vertex_features.axes, {"heading", "fixed"});
    v.range("passes", c.vertex_features.passes, 0, conversion::kMostPasses);
    v.range("anchor_weight", c.vertex_features.anchor_weight, 1e-6, 1e6);
    v.choice("answer", c.vertex_features.answer, {"gradients", "features", "features_alone"});
    v.value("obstacles", c.vertex_features.obstacles);
    v.choice("normalization", c.vertex_features.normalization, {"channel", "group", "range"});
  });
  v.choice("serves", c.serves, {"mesh", "any"});
  v.section("images", [&] {
    v.choice("layout", c.images.layout, {"published", "detail", "positions"});
    v.choice("base", c.images.base, {"vertices", "texels"});
    v.choice("units", c.images.units, {"metres", "coarse_edges"});
    v.range("scale", c.images.scale, 1, conversion::kMostScale);
    v.range("coarse_width", c.images.coarse_width, 0, 2048);
    v.range("coarse_height", c.images.coarse_height, 0, 2048);
    v.range("texels_per_fine_vertex", c.images.texels_per_fine_vertex, 0.5, 100);
    v.choice("method", c.images.method, {"fitted", "sampled"});
    v.range("lambda", c.images.lambda, 1e-12, 1e3);
  });
  v.section("losses", [&] {
    v.range("displacement", c.losses.displacement, 0, 1e6);
    v.range("normal", c.losses.normal, 0, 1e6);
    v.range("velocity", c.losses.velocity, 0, 1e6);
    v.range("kinematic", c.losses.kinematic, 0, 1e6);
    v.range("vertices", c.losses.vertices, 0, 1e6);
    v.range("vertex_normals", c.losses.vertex_normals, 0, 1e6);
    v.range("edges", c.losses.edges, 0, 1e6);
    v.range("wrinkles", c.losses.wrinkles, 0, 1e6);
    v.range("codes", c.losses.codes, 0, 1e6);
    v.range("frames", c.losses.frames, 1, 16);
    v.choice("target", c.losses.target, {"synthesized", "ground_truth"});
    v.choice("alignment", c.losses.alignment, {"exact", "shared"});
    v.choice("scaling", c.losses.scaling, {"none", "deviation"});
  });
  v.section("history", [&] {
    v.range("frames", c.history.frames, 1, 256);
    v.range("share", c.history.share, 0, 1);
    v.range("lead", c.history.lead, 0, 4096);
    v.range("starts", c.history.starts, 0, 1);
    v.range("noise", c.history.noise, 0, 10);
  });
  v.section("autoencoders", [&] {
    v.range("epochs", c.autoencoders.epochs, 0, 1000000);
    v.range("largest", c.autoencoders.largest, 0, 1e6);
  });
  v.section("optimizer", [&] {
    v.range("learning_rate", c.optimizer.learning_rate, 0, 10);
    v.range("beta1", c.optimizer.beta1, 0, 0.99999);
    v.range("beta2", c.optimizer.beta2, 0, 0.9999999);
    v.range("epsilon", c.optimizer.epsilon, 1e-20, 1);
    v.range("clip", c.optimizer.clip, 0, 1e12);
    v.range("average", c.optimizer.average, 0, 0.999999);
  });
  v.section("schedule", [&] {
    v.choice("kind", c.schedule.kind, {"step", "cosine", "constant"});
    v.range("step_epochs", c.schedule.step_epochs, 1, 1000000);
    v.range("fixed_after", c.schedule.fixed_after, 0, 1000000);
    v.choice("progress", c.schedule.progress, {"epochs", "minutes"});
    v.range("final_factor", c.schedule.final_factor, 0, 1);
    v.range("warm_up_steps", c.schedule.warm_up_steps, 0, 1000000);
  });
  v.section("validation", [&] {
    v.value("split", c.validation.split);
    v.value("sequences", c.validation.sequences);
    v.range("every_frames", c.validation.every_frames, 1, 1000000);
    v.range("every_epochs", c.validation.every_epochs, 1, 1000000);
  });
  v.range("window", c.window, 1, conversion::kMaxWindow);
  v.range("window_stride", c.window_stride, 1, conversion::kMaxWindow);
  v.range("epochs", c.epochs, 1, 1000000);
  v.range("batch", c.batch, 1, 4096);
  v.range("micro_batch", c.micro_batch, 0, 4096);
  v.range("patch", c.patch, 0, 8192);
  v.range("every_frames", c.every_frames, 1, 1000000);
  v.range("steps_per_epoch", c.steps_per_epoch, 0, 100000000);
  v.value("mirror", c.mirror);
  v.choice("precision", c.precision, {"float32", "bfloat16"});
  v.choice("kernels", c.kernels, {"own", "libtorch"});
  v.choice("device", c.device, {"auto", "cpu", "cuda"});
  v.choice("cache", c.cache, {"uint16", "float32"});
  v.value("cache_folder", c.cache_folder);
  v.range("cache_limit_mb", c.cache_limit_mb, 1, 100000000);
  v.value("strict", c.strict);
  v.range("threads", c.threads, 0, 4096);
  v.range("max_minutes", c.max_minutes, 0, 1e7);
  v.choice("clock", c.clock, {"wall", "processor"});
  v.range("checkpoint_minutes", c.checkpoint_minutes, 0, 1e6);
  v.value("initial", c.initial);
}

class Reader {
 public:
  Reader(json document, std::string source) : current_(std::move(document)), source_(std::move(source)) {}

  template <typename T>
  void value(const char* key, T& target) {
    const auto it = current_.find(key);
    if (it == current_.end()) return;
    const bool number_ok = !std::is_same_v<T, std::uint64_t> || it->is_number_unsigned();
    const bool integer_ok = !(std::is_same_v<T, int>) || it->is_number_integer();
    const bool bool_ok = std::is_same_v<T, bool> == it->is_boolean();
    try {
      if (!number_ok || !integer_ok || !bool_ok) throw std::invalid_argument(key);
      target = it->get<T>();
    } catch (const std::exception&) {
      throw_invalid_argument(source_ + ": key '" + prefix_ + key + "' has the wrong type");
    }
    current_.erase(key);
  }

  template <typename T>
  void range(const char* key, T& target, double low, double high) {
    value(key, target);
    if (!(static_cast<double>(target) >= low && static_cast<double>(target) <= high)) {
      std::ostringstream message;
      message << source_ << ": key '" << prefix_ << key << "' = " << target << " is outside " << low << " to " << high;
      throw_invalid_argument(message.str());
    }
  }

  void choice(const char* key, std::string& target, std::initializer_list<const char*> choices) {
    value(key, target);
    std::string list;
    for (const char* choice : choices) {
      if (target == choice) return;
      list += (list.empty() ? "" : ", ") + std::string(choice);
    }
    throw_invalid_argument(source_ + ": key '" + prefix_ + key + "' = '" + target + "' is none of " + list);
  }

  void section(const char* key, const std::function<void()>& body) {
    json inner = json::object();
    if (const auto it = current_.find(key); it != current_.end()) {
      if (!it->is_object()) throw_invalid_argument(source_ + ": key '" + std::string(key) + "' must be an object");
      inner = *it;
      current_.erase(key);
    }
    std::swap(current_, inner);
    prefix_ = std::string(key) + ".";
    body();
    finish();
    prefix_.clear();
    std::swap(current_, inner);
  }

  /// Every kind of network has options of its own, which the registry knows.
  void architecture(const char* key, Architecture& target) {
    const auto it = current_.find(key);
    if (it == current_.end()) {
      target = complete(target);
      return;
    }
    if (!it->is_object()) throw_invalid_argument(source_ + ": key '" + std::string(key) + "' must be an object");
    json options = *it;
    current_.erase(key);
    if (const auto kind = options.find("kind"); kind != options.end()) {
      if (!kind->is_string()) throw_invalid_argument(source_ + ": key 'architecture.kind' has the wrong type");
      target.kind = kind->get<std::string>();
      options.erase("kind");
    }
    target.options = options.dump();
    try {
      target = complete(target);
    } catch (const Error& error) {
      throw_invalid_argument(source_ + ": " + error.what());
    }
  }

  void finish() const {
    if (!current_.empty()) {
      throw_invalid_argument(source_ + ": unknown key '" + prefix_ + current_.begin().key() + "'");
    }
  }

 private:
  json current_;
  std::string source_, prefix_;
};

class Writer {
 public:
  template <typename T>
  void value(const char* key, const T& source) {
    (*current_)[key] = source;
  }
  template <typename T>
  void range(const char* key, const T& source, double, double) {
    value(key, source);
  }
  void choice(const char* key, const std::string& source, std::initializer_list<const char*>) { value(key, source); }
  void architecture(const char* key, const Architecture& source) {
    json options = json::parse(source.options);
    options["kind"] = source.kind;
    value(key, options);
  }
  void section(const char* key, const std::function<void()>& body) {
    current_ = &document[key];
    body();
    current_ = &document;
  }
  json document = json::object();

 private:
  json* current_ = &document;
};

/// Whether its networks read their own last answers (docs/training.md).
bool remembers(const Architecture& architecture) {
  const json options = json::parse(architecture.options, nullptr, false);
  return architecture.kind == "published" || (options.is_object() && options.value("history", json(0)) != json(0));
}

}  // namespace

void check_remembering(const TrainConfig& config, const std::string& where) {
  if (config.every_frames == 1 && config.patch == 0 && !config.mirror && config.losses.kinematic <= 0) return;
  throw_invalid_argument(where +
                         "key 'architecture': a network that remembers needs 'every_frames' = 1, 'patch' = 0, no "
                         "'mirror' and 'losses.kinematic' = 0");
}

TrainConfig train_config_from_json(const std::string& text, const std::string& source) {
  json document;
  try {
    document = json::parse(text);
  } catch (const json::parse_error& error) {
    throw_invalid_argument(source + ": no JSON, at byte " + std::to_string(error.byte));
  }
  if (!document.is_object()) throw_invalid_argument(source + ": must be a JSON object");
  TrainConfig config;
  Reader reader(std::move(document), source);
  visit(reader, config);
  reader.finish();
  for (const auto& [key, value] :
       {std::pair{"name", config.name}, std::pair{"dataset", config.dataset}, std::pair{"output", config.output}}) {
    if (value.empty()) throw_invalid_argument(source + ": key '" + std::string(key) + "' is missing");
  }
  if (config.name.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-") !=
      std::string::npos) {
    throw_invalid_argument(source + ": key 'name' may hold letters, digits, '_' and '-' only");
  }
  if (config.schedule.kind == "cosine" && config.schedule.progress == "minutes" && config.max_minutes <= 0) {
    throw_invalid_argument(source + ": key 'schedule.progress' = 'minutes' needs 'max_minutes'");
  }
  if ((config.images.coarse_width == 0) != (config.images.coarse_height == 0)) {
    throw_invalid_argument(source + ": keys 'images.coarse_width' and 'images.coarse_height' go together");
  }
  if (config.serves == "any" && (config.representation != "geometry_image" || config.images.layout != "detail" ||
                                 config.images.units != "coarse_edges" || config.images.coarse_width != 0)) {
    throw_invalid_argument(source + ": key 'serves' = 'any' needs 'images.layout' = 'detail', 'images.units' = " +
                           "'coarse_edges' and no size of the image");
  }
  if (!config.published_images() && config.losses.kinematic > 0) {
    throw_invalid_argument(source + ": key 'losses.kinematic' needs velocities, 'images.layout' = 'published'");
  }
  if (config.representation == "vertex_features" && (config.patch != 0 || config.mirror)) {
    throw_invalid_argument(source + ": key 'representation' = 'vertex_features' needs 'patch' = 0 and no 'mirror'");
  }
  if (config.representation == "vertex_features" && config.vertex_features.answer == "features_alone" &&
      config.losses.needs_vertices()) {
    throw_invalid_argument(source +
                           ": keys 'losses.vertices', '.vertex_normals', '.edges' and '.wrinkles' need offsets, " +
                           "'vertex_features.answer' is 'features_alone'");
  }
  if (config.mirror && config.images.layout == "positions") {
    throw_invalid_argument(source + ": key 'mirror': places have no mirror image, 'images.layout' is 'positions'");
  }
  if (remembers(config.architecture)) check_remembering(config, source + ": ");
  if (config.autoencoders.epochs >= config.epochs) {
    throw_invalid_argument(source + ": key 'autoencoders.epochs' leaves none of the " + std::to_string(config.epochs) +
                           " 'epochs' for the rest");
  }
  if (config.losses.needs_vertices() && config.patch != 0) {
    throw_invalid_argument(source +
                           ": keys 'losses.vertices', '.vertex_normals', '.edges' and '.wrinkles' need whole images, " +
                           "'patch' = 0");
  }
  if (config.every_frames > 1 && config.losses.kinematic > 0) {
    throw_invalid_argument(source + ": key 'losses.kinematic' needs consecutive frames, 'every_frames' = 1");
  }
  return config;
}

namespace {

constexpr int kMostBases = 8;

json read_document(const std::filesystem::path& path, int depth) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  if (!file) throw_not_found(path.string() + ": can't be read");
  json document;
  try {
    document = json::parse(text.str());
  } catch (const json::parse_error& error) {
    throw_invalid_argument(path.string() + ": no JSON, at byte " + std::to_string(error.byte));
  }
  if (!document.is_object()) throw_invalid_argument(path.string() + ": must be a JSON object");
  const auto base = document.find("base");
  if (base == document.end()) return document;
  if (!base->is_string() || depth >= kMostBases) {
    throw_invalid_argument(path.string() + ": key 'base' must name a file, and files may not go round in a circle");
  }
  json whole = read_document(path.parent_path() / base->get<std::string>(), depth + 1);
  document.erase("base");
  whole.merge_patch(document);
  return whole;
}

void apply_change(json& document, const std::string& change) {
  const auto equals = change.find('=');
  if (equals == std::string::npos || equals == 0) {
    throw_invalid_argument("--set " + change + ": must be key=value or section.key=value");
  }
  const std::string key = change.substr(0, equals), text = change.substr(equals + 1);
  json value = json::parse(text, nullptr, false);
  if (value.is_discarded()) value = text;
  const auto dot = key.find('.');
  if (dot == std::string::npos) {
    document[key] = std::move(value);
  } else {
    document[key.substr(0, dot)][key.substr(dot + 1)] = std::move(value);
  }
}

}  // namespace

TrainConfig read_train_config(const std::string& path, const std::vector<std::string>& changes) {
  json document = read_document(path, 0);
  for (const std::string& change : changes) apply_change(document, change);
  return train_config_from_json(document.dump(), path);
}

std::string to_json(const TrainConfig& config) {
  Writer writer;
  visit(writer, config);
  return writer.document.dump(2);
}

std::string first_difference(const std::string& a, const std::string& b) {
  const json defaults = json::parse(to_json(TrainConfig{}));
  const auto whole = [&](const std::string& text) {
    json result = defaults;
    result.merge_patch(json::parse(text));
    return result.flatten();
  };
  const json left = whole(a), right = whole(b);
  static const char* const kFree[] = {"/output",         "/epochs",  "/threads", "/max_minutes",  "/checkpoint_minutes",
                                      "/cache_limit_mb", "/initial", "/dataset", "/cache_folder", "/strict",
                                      "/micro_batch"};
  // Check-points from before say nothing of their data.
  const bool data_known = json::parse(a).contains("data") && json::parse(b).contains("data");
  const auto free = [&](const std::string& key) {
    if (!data_known && key.rfind("/data/", 0) == 0) return true;
    return std::any_of(std::begin(kFree), std::end(kFree), [&](const char* k) { return key == k; });
  };
  for (const auto& [key, value] : left.items()) {
    if (!free(key) && (!right.contains(key) || right[key] != value)) return key.substr(1);
  }
  for (const auto& [key, value] : right.items()) {
    if (!free(key) && !left.contains(key)) return key.substr(1);
  }
  return "";
}

}  // namespace pleat::superres
