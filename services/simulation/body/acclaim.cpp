#include "services/simulation/body/acclaim.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <map>
#include <numbers>
#include <sstream>
#include <utility>

#include "common/base/error.hpp"
#include "common/base/limits.hpp"

namespace pleat::body {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kMetresPerInch = 0.0254;
constexpr std::size_t kMaxBones = 1'000;

/// A file by lines of words, with the line's number for messages. '#' starts a comment.
class Words {
 public:
  Words(std::istream& stream, std::string name) : stream_(stream), name_(std::move(name)) {}

  /// The next line that has words; false at the end.
  bool next() {
    std::string line;
    while (std::getline(stream_, line)) {
      ++line_;
      std::istringstream text(line.substr(0, line.find('#')));
      words_.clear();
      for (std::string word; text >> word;) words_.push_back(word);
      if (!words_.empty()) return true;
    }
    words_.clear();
    return false;
  }

  const std::vector<std::string>& words() const { return words_; }
  const std::string& key() const { return words_.front(); }

  [[noreturn]] void fail(const std::string& message) const {
    throw_invalid_argument(name_ + " line " + std::to_string(line_) + ": " + message);
  }

  const std::string& word(std::size_t index) const {
    if (index >= words_.size()) fail("'" + key() + "' needs " + std::to_string(index) + " values");
    return words_[index];
  }

  double number(std::size_t index) const {
    const std::string& text = word(index);
    double value = 0;
    const char* begin = text.data() + (text.starts_with('+') ? 1 : 0);
    const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value))
      fail("'" + text + "' is not a finite number");
    return value;
  }

  Vector3d vector(std::size_t index) const { return {number(index), number(index + 1), number(index + 2)}; }

 private:
  std::istream& stream_;
  std::string name_;
  std::size_t line_ = 0;
  std::vector<std::string> words_;
};

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

Quaterniond about(char axis, double radians) {
  const int index = std::clamp(axis - 'x', 0, 2);
  return Quaterniond(AngleAxisd(radians, Vector3d::Unit(index)));
}

/// Turns about the axes named by `order` ("XYZ": about x first), in this order about the fixed axes.
Quaterniond turned(const std::string& order, const Vector3d& radians) {
  Quaterniond turn = Quaterniond::Identity();
  for (int k = 0; k < 3; ++k) turn = about(lower(order)[static_cast<std::size_t>(k)], radians[k]) * turn;
  return turn;
}

class AsfReader {
 public:
  AsfReader(std::istream& stream, const std::string& name) : words_(stream, name), name_(name) {}

  AcclaimSkeleton read() {
    result_.bones.push_back({"root", Quaterniond::Identity(), {}});
    bones_["root"] = {Vector3d::Zero(), -1, 0};
    bool more = words_.next();
    while (more) {
      const std::string section = lower(words_.key());
      if (section == ":units") {
        more = read_units();
      } else if (section == ":root") {
        more = read_root();
      } else if (section == ":bonedata") {
        more = read_bones();
      } else if (section == ":hierarchy") {
        more = read_hierarchy();
      } else {
        while ((more = words_.next()) && words_.key()[0] != ':') {
        }
      }
    }
    return finish();
  }

 private:
  struct Bone {
    Vector3d end = Vector3d::Zero();  // from its start, units
    int parent = -1;
    std::size_t index = 0;
  };

  bool read_units() {
    bool more = false;
    while ((more = words_.next()) && words_.key()[0] != ':') {
      const std::string key = lower(words_.key());
      if (key == "length") result_.metres_per_unit = kMetresPerInch / words_.number(1);
      if (key == "angle") result_.degrees = lower(words_.word(1)).starts_with("deg");
    }
    if (!(result_.metres_per_unit > 0) || !std::isfinite(result_.metres_per_unit))
      words_.fail("the unit of length must be positive");
    return more;
  }

  double radians(double angle) const { return result_.degrees ? angle * std::numbers::pi / 180 : angle; }

  std::string axis_order(const std::string& text) const {
    std::string sorted = lower(text);
    std::sort(sorted.begin(), sorted.end());
    if (sorted != "xyz") words_.fail("'" + text + "' is no order of x, y and z");
    return text;
  }

  bool read_root() {
    bool more = false;
    AcclaimBone& root = result_.bones.front();
    std::string order = "XYZ";
    Vector3d angles = Vector3d::Zero();
    while ((more = words_.next()) && words_.key()[0] != ':') {
      const std::string key = lower(words_.key());
      if (key == "order") {
        for (std::size_t k = 1; k < words_.words().size(); ++k) root.freedoms.push_back(lower(words_.word(k)));
      } else if (key == "axis") {
        order = axis_order(words_.word(1));
      } else if (key == "orientation") {
        const Vector3d values = words_.vector(1);
        for (int k = 0; k < 3; ++k) angles[k] = radians(values[k]);
      }
    }
    root.axes = turned(order, angles);
    return more;
  }

  bool read_bones() {
    bool more = false;
    while ((more = words_.next()) && words_.key()[0] != ':') {
      if (lower(words_.key()) != "begin") words_.fail("expected 'begin', found '" + words_.key() + "'");
      read_bone();
    }
    return more;
  }

  void read_bone() {
    AcclaimBone bone;
    Vector3d direction = Vector3d::Zero();
    double length = 0;
    while (true) {
      if (!words_.next()) words_.fail("the bone '" + bone.name + "' has no end");
      const std::string key = lower(words_.key());
      if (key == "end") break;
      if (key == "name") bone.name = words_.word(1);
      if (key == "direction") direction = words_.vector(1);
      if (key == "length") length = words_.number(1);
      if (key == "axis") {
        const Vector3d angles = words_.vector(1);
        bone.axes =
            turned(axis_order(words_.word(4)), Vector3d(radians(angles[0]), radians(angles[1]), radians(angles[2])));
      }
      if (key == "dof")
        for (std::size_t k = 1; k < words_.words().size(); ++k) bone.freedoms.push_back(lower(words_.word(k)));
    }
    if (bone.name.empty()) words_.fail("a bone without a name");
    if (!(length > 0)) words_.fail("the bone '" + bone.name + "' has zero length");
    if (!(direction.norm() > 0)) words_.fail("the bone '" + bone.name + "' has no direction");
    if (result_.bones.size() >= kMaxBones) words_.fail("more than " + std::to_string(kMaxBones) + " bones");
    const Bone place{direction.normalized() * length, -1, result_.bones.size()};
    if (!bones_.emplace(bone.name, place).second) words_.fail("the bone '" + bone.name + "' exists twice");
    result_.bones.push_back(std::move(bone));
  }

  bool read_hierarchy() {
    bool more = false;
    while ((more = words_.next()) && words_.key()[0] != ':') {
      const std::string key = lower(words_.key());
      if (key == "begin" || key == "end") continue;
      const auto parent = bones_.find(words_.key());
      if (parent == bones_.end()) words_.fail("there is no bone '" + words_.key() + "'");
      for (std::size_t k = 1; k < words_.words().size(); ++k) {
        const auto child = bones_.find(words_.word(k));
        if (child == bones_.end()) words_.fail("there is no bone '" + words_.word(k) + "'");
        if (child->second.parent >= 0 || child->second.index == 0)
          words_.fail("the bone '" + words_.word(k) + "' has two parents");
        child->second.parent = static_cast<int>(parent->second.index);
      }
    }
    return more;
  }

  /// Joints in an order with parents first.
  AcclaimSkeleton finish() {
    std::vector<AcclaimBone> bones;
    std::vector<int> place(result_.bones.size(), -1);
    const auto add = [&](std::size_t index, int parent) {
      const AcclaimBone& bone = result_.bones[index];
      Joint joint{bone.name, parent, Vector3d::Zero(), Quaterniond::Identity()};
      if (parent >= 0)
        joint.translation = result_.metres_per_unit * bones_[bones[static_cast<std::size_t>(parent)].name].end;
      place[index] = static_cast<int>(bones.size());
      bones.push_back(bone);
      result_.skeleton.joints.push_back(std::move(joint));
    };
    add(0, -1);
    for (bool added = true; added;) {
      added = false;
      for (std::size_t index = 1; index < result_.bones.size(); ++index) {
        const int parent = bones_[result_.bones[index].name].parent;
        if (place[index] >= 0 || parent < 0 || place[static_cast<std::size_t>(parent)] < 0) continue;
        add(index, place[static_cast<std::size_t>(parent)]);
        added = true;
      }
    }
    for (std::size_t index = 0; index < place.size(); ++index)
      if (place[index] < 0)
        throw_invalid_argument(name_ + ": the bone '" + result_.bones[index].name + "' does not hang on the root");
    result_.bones = std::move(bones);
    validate_skeleton(result_.skeleton, name_);
    return std::move(result_);
  }

  Words words_;
  std::string name_;
  AcclaimSkeleton result_;
  std::map<std::string, Bone> bones_;
};

/// One line of a frame: the values of a bone's freedoms.
void read_values(const Words& words, const AcclaimSkeleton& skeleton, std::size_t joint, Pose& pose) {
  const AcclaimBone& bone = skeleton.bones[joint];
  if (words.words().size() != bone.freedoms.size() + 1)
    words.fail("'" + bone.name + "' has " + std::to_string(words.words().size() - 1) + " values, the skeleton " +
               std::to_string(bone.freedoms.size()) + " freedoms");
  Quaterniond turn = Quaterniond::Identity();
  Vector3d move = Vector3d::Zero();
  for (std::size_t k = 0; k < bone.freedoms.size(); ++k) {
    const std::string& freedom = bone.freedoms[k];
    const double value = words.number(k + 1);
    if (freedom.size() == 2 && freedom[0] == 'r') {
      turn = about(freedom[1], skeleton.degrees ? value * std::numbers::pi / 180 : value) * turn;
    } else if (freedom.size() == 2 && freedom[0] == 't') {
      move[std::clamp(freedom[1] - 'x', 0, 2)] = value * skeleton.metres_per_unit;
    }
  }
  // The root's axes turn the figure; the other bones' are only what their angles are measured in.
  pose.rotations[joint] = joint == 0 ? turn * bone.axes : bone.axes * turn * bone.axes.conjugate();
  pose.translations[joint] = skeleton.skeleton.joints[joint].translation + move;
}

std::ifstream open_file(const std::filesystem::path& path) {
  std::ifstream stream(path);
  std::error_code ignored;
  if (!stream || std::filesystem::is_directory(path, ignored)) throw_not_found(path.string() + ": can't be read");
  return stream;
}

}  // namespace

AcclaimSkeleton read_asf(const std::filesystem::path& path) {
  std::ifstream stream = open_file(path);
  return read_asf(stream, path.string());
}

AcclaimSkeleton read_asf(std::istream& stream, const std::string& name) { return AsfReader(stream, name).read(); }

Motion read_amc(const std::filesystem::path& path, const AcclaimSkeleton& skeleton, double frame_time_s) {
  std::ifstream stream = open_file(path);
  return read_amc(stream, path.string(), skeleton, frame_time_s);
}

Motion read_amc(std::istream& stream, const std::string& name, const AcclaimSkeleton& skeleton, double frame_time_s) {
  std::map<std::string, std::size_t> joints;
  for (std::size_t j = 0; j < skeleton.bones.size(); ++j) joints.emplace(skeleton.bones[j].name, j);
  Motion motion{skeleton.skeleton, frame_time_s, {}};
  Words words(stream, name);
  while (words.next()) {
    if (words.key()[0] == ':') continue;
    const bool number = words.words().size() == 1 && words.key().find_first_not_of("0123456789") == std::string::npos;
    if (number) {
      if (motion.frames.size() >= kMaxFrames) words.fail("more than " + std::to_string(kMaxFrames) + " frames");
      motion.frames.push_back(rest_pose(skeleton.skeleton));
      continue;
    }
    const auto joint = joints.find(words.key());
    if (joint == joints.end()) words.fail("the skeleton has no bone '" + words.key() + "'");
    if (motion.frames.empty()) words.fail("values before the first frame's number");
    read_values(words, skeleton, joint->second, motion.frames.back());
  }
  validate_motion(motion, name);
  return motion;
}

}  // namespace pleat::body
