#include "services/superres/bundle/metadata.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

constexpr const char* kFormat = "pleat.bundle";
constexpr int kLargestImageSide = 8192, kMostChannels = 4096;
constexpr const char* kLayouts[] = {"LAYOUT_PUBLISHED", "LAYOUT_DETAIL", "LAYOUT_POSITIONS"};
constexpr const char* kBases[] = {"BASE_VERTICES", "BASE_TEXELS"};
constexpr const char* kUnits[] = {"UNITS_METRES", "UNITS_COARSE_EDGES"};
constexpr const char* kRotations[] = {"ROTATION_LOGARITHM", "ROTATION_QUATERNION"};
constexpr const char* kAnswers[] = {"ANSWER_GRADIENTS", "ANSWER_FEATURES", "ANSWER_FEATURES_ALONE"};
constexpr std::int64_t kMostRemembered = 4 << 20;  ///< numbers: they travel with every frame
constexpr const char* kRules[] = {"SUBDIVISION_RULE_MIDPOINT", "SUBDIVISION_RULE_LOOP"};

/// An object of the document, and how errors name it.
class Object {
 public:
  Object(const json& value, std::string where) : value_(value), where_(std::move(where)) {
    if (!value_.is_object()) throw_invalid_argument(where_ + " must be an object");
  }

  bool has(const char* key) const { return value_.contains(key); }

  template <typename T>
  T get(const char* key) const {
    const auto it = value_.find(key);
    if (it == value_.end()) throw_invalid_argument(where_ + " has no key '" + key + "'");
    try {
      return it->get<T>();
    } catch (const json::exception&) {
      throw_invalid_argument(where_ + ": key '" + std::string(key) + "' has the wrong type");
    }
  }
  template <typename T>
  T get(const char* key, T fallback) const {
    return has(key) ? get<T>(key) : fallback;
  }
  int integer(const char* key, int fallback, int low, int high) const {
    const auto value = get<std::int64_t>(key, fallback);
    if (value < low || value > high) {
      throw_invalid_argument(where_ + ": " + key + " = " + std::to_string(value) + " is outside " +
                             std::to_string(low) + " to " + std::to_string(high));
    }
    return static_cast<int>(value);
  }
  /// The place of a word in a list; the first one if it is not given.
  template <typename Enum, std::size_t N>
  Enum choice(const char* key, const char* const (&words)[N]) const {
    const auto word = get<std::string>(key, words[0]);
    const auto found = std::find(std::begin(words), std::end(words), word);
    if (found == std::end(words)) throw_invalid_argument(where_ + ": " + key + " is '" + word + "', which is unknown");
    return static_cast<Enum>(found - std::begin(words));
  }
  Object object(const char* key) const { return {get<json>(key), where_ + ": '" + key + "'"}; }
  ChannelRanges ranges(const char* key) const {
    const Object object = this->object(key);
    ChannelRanges ranges{object.get<std::vector<float>>("offset"), object.get<std::vector<float>>("scale"),
                         object.get<float>("limit", 0)};
    if (ranges.empty() || ranges.channels() > kMostChannels) throw_invalid_argument(object.where_ + " has no channels");
    check_ranges(ranges, ranges.channels(), object.where_);
    return ranges;
  }

 private:
  json value_;
  std::string where_;
};

json ranges_json(const ChannelRanges& ranges) {
  return {{"offset", ranges.offset}, {"scale", ranges.scale}, {"limit", ranges.limit}};
}

json document_of(const conversion::VertexFeatureSpec& features) {
  return {{"rotation", kRotations[static_cast<std::size_t>(features.rotation)]},
          {"fixed_axes", features.fixed_axes},
          {"passes", features.passes},
          {"anchor_weight", features.anchor_weight},
          {"answer", kAnswers[static_cast<std::size_t>(features.answer)]},
          {"obstacles", features.obstacles}};
}

json document_of(const conversion::GeometryImageSpec& image) {
  return {{"layout", kLayouts[static_cast<std::size_t>(image.layout)]},
          {"base", kBases[static_cast<std::size_t>(image.base)]},
          {"units", kUnits[static_cast<std::size_t>(image.units)]},
          {"width", image.image.coarse_width},
          {"height", image.image.coarse_height},
          {"scale", image.image.scale}};
}

json document_of(const Metadata& m) {
  const bool image = std::holds_alternative<conversion::GeometryImageSpec>(m.representation.kind);
  return {{image ? "geometry_image" : "vertex_features",
           std::visit([](const auto& kind) { return document_of(kind); }, m.representation.kind)},
          {"subdivision_rounds", m.representation.subdivision.rounds},
          {"subdivision_rule", kRules[static_cast<std::size_t>(m.representation.subdivision.rule)]},
          {"window", m.representation.window},
          {"window_stride", m.representation.window_stride},
          {"input", ranges_json(m.input)},
          {"output", ranges_json(m.output)}};
}

conversion::VertexFeatureSpec read_features(const Object& features) {
  conversion::VertexFeatureSpec spec;
  spec.rotation = features.choice<conversion::RotationCode>("rotation", kRotations);
  spec.fixed_axes = features.get<bool>("fixed_axes", false);
  spec.passes = features.integer("passes", conversion::kDefaultPasses, 0, conversion::kMostPasses);
  spec.anchor_weight = features.get<double>("anchor_weight", conversion::kDefaultAnchorWeight);
  spec.answer = features.choice<conversion::AnswerKind>("answer", kAnswers);
  spec.obstacles = features.get<bool>("obstacles", false);
  return spec;
}

conversion::GeometryImageSpec read_image(const Object& object) {
  const Object image = object.object("geometry_image");
  conversion::GeometryImageSpec spec;
  spec.layout = image.choice<conversion::ImageLayout>("layout", kLayouts);
  spec.base = image.choice<conversion::DetailBase>("base", kBases);
  spec.units = image.choice<conversion::DetailUnits>("units", kUnits);
  spec.image.coarse_width = image.integer("width", 0, 0, kLargestImageSide);
  spec.image.coarse_height = image.integer("height", 0, 0, kLargestImageSide);
  spec.image.scale = image.integer("scale", conversion::kDefaultScale, 1, conversion::kMostScale);
  return spec;
}

void read_representation(const Object& object, Metadata& m) {
  if (object.has("vertex_features")) {
    m.representation.kind = read_features(object.object("vertex_features"));
  } else {
    m.representation.kind = read_image(object);
  }
  m.representation.subdivision.rounds =
      object.integer("subdivision_rounds", kDefaultSubdivisionRounds, 0, kMaxSubdivisionRounds);
  m.representation.subdivision.rule = object.choice<SubdivisionRule>("subdivision_rule", kRules);
  m.representation.window = object.integer("window", 1, 1, conversion::kMaxWindow);
  m.representation.window_stride = object.integer("window_stride", 1, 1, conversion::kMaxWindow);
  m.input = object.ranges("input");
  m.output = object.ranges("output");
}

}  // namespace

void forget_mesh(Metadata& metadata) {
  metadata.topology_hash.clear();
  metadata.rest_positions.clear();
  metadata.input_size = {};
  auto& image = std::get<conversion::GeometryImageSpec>(metadata.representation.kind).image;
  image.coarse_width = image.coarse_height = 0;
}

Ports ports_of(const Metadata& metadata) {
  const conversion::AnswerForm form = conversion::answer_form(metadata.representation);
  Ports ports;
  ports.inputs = metadata.representation.window * static_cast<int>(metadata.input.channels()) + metadata.constants;
  ports.outputs = static_cast<int>(metadata.output.channels());
  ports.window = metadata.representation.window;
  ports.scale = form.scale;
  ports.detail = form.detail;
  ports.constants = metadata.constants;
  ports.block = form.block;
  return ports;
}

std::string representation_json(const Metadata& metadata) { return document_of(metadata).dump(); }

std::string to_json(const Metadata& metadata) {
  json architecture = json::parse(metadata.architecture.options);
  architecture["kind"] = metadata.architecture.kind;
  json document;
  document["format"] = kFormat;
  document["version"] = kBundleVersion;
  document["name"] = metadata.name;
  document["architecture"] = std::move(architecture);
  document["parameters"] = metadata.parameters;
  document["representation"] = document_of(metadata);
  document["constants"] = metadata.constants;
  if (metadata.input_size[0] > 0) document["input_size"] = metadata.input_size;
  if (memory_values(metadata) > 0) document["memory"] = metadata.memory;
  document["topology_hash"] = metadata.topology_hash;
  if (!metadata.rest_positions.empty()) document["rest_positions"] = metadata.rest_positions;
  document["velocity"] = metadata.velocity;
  document["float32_parameters"] = metadata.float32_parameters;
  document["training"] = json::parse(metadata.training);
  document["metrics"] = metadata.metrics;
  document["git_revision"] = metadata.git_revision;
  return document.dump(2);
}

Metadata metadata_from_json(const std::string& text, const std::string& source) {
  const json parsed = json::parse(text, nullptr, false);
  if (parsed.is_discarded()) throw_data_loss(source + ": pleat.json is no JSON");
  const Object document(parsed, source + ": pleat.json");
  if (document.get<std::string>("format") != kFormat) {
    throw_invalid_argument(source + ": pleat.json: format is not '" + kFormat + "'");
  }
  const int version = document.get<int>("version");
  if (version == 1) {
    throw_invalid_argument(source + ": bundle version 1, this program reads version 2; re-export it: pleat-train " +
                           "--re-export " + source + " --out NEW.pt");
  }
  if (version != kBundleVersion) {
    throw_invalid_argument(source + ": bundle version " + std::to_string(version) + ", this program reads version " +
                           std::to_string(kBundleVersion));
  }
  Metadata m;
  m.name = document.get<std::string>("name");
  json architecture = document.get<json>("architecture");
  m.architecture.kind = document.object("architecture").get<std::string>("kind");
  architecture.erase("kind");
  m.architecture.options = architecture.dump();
  m.parameters = document.get<std::int64_t>("parameters", 0);
  read_representation(document.object("representation"), m);
  m.constants = document.integer("constants", 0, 0, kMostChannels);
  m.input_size = document.get<std::array<int, 2>>("input_size", {});
  for (const int extent : m.input_size) {
    if (extent < 0 || extent > kLargestImageSide * kLargestImageSide) {
      throw_invalid_argument(source + ": pleat.json: input_size is none");
    }
  }
  m.memory = document.get<std::array<int, 3>>("memory", {});
  std::int64_t remembered = 1;
  for (const int extent : m.memory) {
    remembered = extent < 0 || remembered > kMostRemembered ? kMostRemembered + 1 : remembered * extent;
  }
  if (remembered > kMostRemembered) {
    throw_invalid_argument(source + ": pleat.json: memory has no size, or more than " +
                           std::to_string(kMostRemembered) + " numbers");
  }
  if (is_registered(m.architecture.kind)) {
    m.architecture = complete(m.architecture);
    if (describe(m.architecture, ports_of(m)).outputs() != static_cast<int>(m.output.channels())) {
      throw_invalid_argument(source + ": pleat.json: the network answers with other channels than 'output' has");
    }
  }
  m.topology_hash = document.get<std::string>("topology_hash");
  m.rest_positions = document.get<std::vector<float>>("rest_positions", {});
  if (m.rest_positions.size() % 3 != 0) {
    throw_invalid_argument(source + ": pleat.json: rest_positions are not three a vertex");
  }
  m.velocity = document.get<std::string>("velocity");
  if (m.velocity != "backward") {
    throw_invalid_argument(source + ": pleat.json: velocity must be 'backward', is '" + m.velocity + "'");
  }
  m.float32_parameters = document.get<std::vector<std::string>>("float32_parameters", {});
  m.training = document.get<json>("training", json::object()).dump();
  m.metrics = document.get<std::map<std::string, double>>("metrics", {});
  m.git_revision = document.get<std::string>("git_revision", "");
  return m;
}

}  // namespace pleat::superres
