#include "services/simulation/body/character_file.hpp"

#include <assimp/config.h>
#include <assimp/postprocess.h>

#include <algorithm>
#include <array>
#include <assimp/Importer.hpp>
#include <cmath>
#include <cstdio>
#include <map>
#include <tuple>

#include "common/base/error.hpp"
#include "common/base/limits.hpp"
#include "services/simulation/body/acclaim.hpp"
#include "services/simulation/body/assimp_scene.hpp"

namespace pleat::body {
namespace {

namespace fs = std::filesystem;
using Eigen::Affine3d;
using Eigen::Vector3d;

constexpr double kSmallest = 0.3, kTallest = 4.0;  // of a body, metres
constexpr double kSameMatrix = 1e-3;               // relative
constexpr double kScaled = 0.02;                   // a scale that an animation changes by more is worth a line
constexpr float kSameWeight = 1e-3F;

std::string lower_extension(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

std::string number(double value) {
  std::array<char, 40> text{};
  std::snprintf(text.data(), text.size(), "%.3g", value);
  return text.data();
}

/// Vertices of several meshes that become one where place and weights agree.
class Welder {
 public:
  std::uint32_t add(const Vector3d& place, std::vector<std::pair<float, int>>& influences) {
    std::sort(influences.begin(), influences.end(), std::greater<>());
    influences.resize(kInfluences);
    float sum = 0;
    for (const auto& [weight, joint] : influences) sum += weight;
    for (auto& [weight, joint] : influences) weight /= sum;
    const Eigen::Vector3f x = place.cast<float>();
    auto& here = by_place_[{x.x(), x.y(), x.z()}];
    for (const std::uint32_t other : here)
      if (same(influences_[other], influences)) return other;
    here.push_back(static_cast<std::uint32_t>(places_.size()));
    places_.push_back(x);
    influences_.push_back(influences);
    return here.back();
  }

  void add_face(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (a != b && b != c && c != a) faces_.push_back({a, b, c});
  }

  SkinnedMesh finish() const {
    SkinnedMesh body;
    const auto vertices = static_cast<Eigen::Index>(places_.size());
    body.mesh.rest_positions.resize(vertices, 3);
    body.joints.resize(vertices, kInfluences);
    body.weights.resize(vertices, kInfluences);
    for (Eigen::Index v = 0; v < vertices; ++v) {
      const auto i = static_cast<std::size_t>(v);
      body.mesh.rest_positions.row(v) = places_[i].transpose();
      for (int k = 0; k < kInfluences; ++k) {
        const auto& [weight, joint] = influences_[i][static_cast<std::size_t>(k)];
        body.weights(v, k) = weight;
        body.joints(v, k) = static_cast<std::uint16_t>(joint);
      }
    }
    body.mesh.faces.resize(static_cast<Eigen::Index>(faces_.size()), 3);
    for (std::size_t f = 0; f < faces_.size(); ++f)
      for (std::size_t k = 0; k < 3; ++k)
        body.mesh.faces(static_cast<Eigen::Index>(f), static_cast<Eigen::Index>(k)) = faces_[f][k];
    return body;
  }

 private:
  using Influences = std::vector<std::pair<float, int>>;  // weight, joint; strongest first
  static bool same(const Influences& a, const Influences& b) {
    for (std::size_t k = 0; k < a.size(); ++k)
      if (std::abs(a[k].first - b[k].first) > kSameWeight || (a[k].first > kSameWeight && a[k].second != b[k].second))
        return false;
    return true;
  }

  std::vector<Eigen::Vector3f> places_;
  std::vector<Influences> influences_;
  std::vector<std::array<std::uint32_t, 3>> faces_;
  std::map<std::tuple<float, float, float>, std::vector<std::uint32_t>> by_place_;
};

class Reader {
 public:
  Reader(const aiScene& scene, const fs::path& path)
      : scene_(scene), source_(path.string()), extension_(lower_extension(path)), joints_(scene, source_) {}

  CharacterFile read() {
    bind_ = joints_.at_rest();
    find_meshes();
    if (joints_.size() == 0) throw_invalid_argument(source_ + ": no skeleton: neither skinned meshes nor an animation");
    find_units();
    make_skeleton();
    if (!meshes_.empty()) make_body();
    for (unsigned a = 0; a < scene_.mNumAnimations; ++a) add_motion(*scene_.mAnimations[a]);
    return std::move(result_);
  }

 private:
  struct SkinnedPart {
    const aiMesh* mesh = nullptr;
    Affine3d to_world = Affine3d::Identity();  // file units, at the bind pose
  };

  Affine3d bone_at_bind(const aiBone& bone, const Affine3d& to_world) const {
    return to_world * to_affine(bone.mOffsetMatrix).inverse();
  }

  /// Where the mesh is in the world at the bind pose: where all bones say so as the nodes stand; else at its node.
  Affine3d mesh_to_world(const aiMesh& mesh, const Affine3d& node) const {
    Affine3d first = Affine3d::Identity();
    for (unsigned b = 0; b < mesh.mNumBones; ++b) {
      const int joint = joints_.find(mesh.mBones[b]->mName.C_Str());
      const Affine3d here = bind_[static_cast<std::size_t>(joint)] * to_affine(mesh.mBones[b]->mOffsetMatrix);
      if (b == 0) first = here;
      if (!here.matrix().isApprox(first.matrix(), kSameMatrix)) return node;
    }
    return first;
  }

  void find_meshes() {
    std::vector<std::pair<const aiNode*, Affine3d>> nodes = {{scene_.mRootNode, Affine3d::Identity()}};
    std::string unskinned;
    while (!nodes.empty()) {
      const auto [node, above] = nodes.back();
      nodes.pop_back();
      const Affine3d world = above * to_affine(node->mTransformation);
      for (unsigned m = 0; m < node->mNumMeshes; ++m) {
        const aiMesh& mesh = *scene_.mMeshes[node->mMeshes[m]];
        if (mesh.mNumFaces == 0 || (mesh.mPrimitiveTypes & aiPrimitiveType_TRIANGLE) == 0) continue;
        if (mesh.mNumBones > 0) {
          meshes_.push_back({&mesh, mesh_to_world(mesh, world)});
        } else {
          unskinned = mesh.mName.length > 0 ? mesh.mName.C_Str() : node->mName.C_Str();
        }
      }
      for (unsigned c = 0; c < node->mNumChildren; ++c) nodes.emplace_back(node->mChildren[c], world);
    }
    if (unskinned.empty()) return;
    if (meshes_.empty())
      throw_invalid_argument(source_ + ": mesh '" + unskinned + "' follows no skeleton: it has no skinning weights");
    result_.notes.push_back("mesh '" + unskinned + "' has no skinning weights and is left out");
  }

  /// to_metres_: from the file's world to metres with Y up.
  void find_units() {
    std::vector<bool> bound(joints_.size());
    for (const SkinnedPart& part : meshes_) {
      for (unsigned b = 0; b < part.mesh->mNumBones; ++b) {
        const auto joint = static_cast<std::size_t>(joints_.find(part.mesh->mBones[b]->mName.C_Str()));
        if (!bound[joint]) bind_[joint] = bone_at_bind(*part.mesh->mBones[b], part.to_world);
        bound[joint] = true;
      }
    }
    double unit = 1;
    int head = -1, hips = -1;
    for (std::size_t j = 0; j < joints_.size(); ++j) {
      const std::string name = canonical_name(joints_.name(j));
      if (name == "head" && head < 0) head = static_cast<int>(j);
      if (name == "hips" && hips < 0) hips = static_cast<int>(j);
    }
    Eigen::Quaterniond upright = Eigen::Quaterniond::Identity();
    if (head >= 0 && hips >= 0) {
      const Vector3d up =
          bind_[static_cast<std::size_t>(head)].translation() - bind_[static_cast<std::size_t>(hips)].translation();
      if (up.z() > std::abs(up.x()) && up.z() > std::abs(up.y())) {
        upright = Eigen::Quaterniond(Eigen::AngleAxisd(-EIGEN_PI / 2, Vector3d::UnitX()));
        result_.notes.emplace_back("Z is up: turned");
      }
    }
    to_metres_ = Affine3d(upright) * Eigen::Scaling(unit);
    if (meshes_.empty()) return;
    const double height = measured_height();
    if (!(height > 0) || !std::isfinite(height))
      throw_invalid_argument(source_ + ": the mesh has no extent or is not finite");
    for (const auto& [scale, name] : {std::pair{1.0, "metres"}, {0.01, "centimetres"}, {100.0, "hundreds of metres"}}) {
      if (height * scale < kSmallest || height * scale > kTallest) continue;
      to_metres_ = Eigen::Scaling(scale) * to_metres_;
      if (scale != 1) result_.notes.push_back("a body " + number(height) + " units tall is read as " + name);
      return;
    }
    throw_invalid_argument(source_ + ": a body " + number(height) + " m tall is neither in metres nor in centimetres");
  }

  double measured_height() const {
    double lowest = std::numeric_limits<double>::infinity(), highest = -lowest;
    for (const SkinnedPart& part : meshes_) {
      for (unsigned v = 0; v < part.mesh->mNumVertices; ++v) {
        const double y = world_place(part, v).y();
        lowest = std::min(lowest, y);
        highest = std::max(highest, y);
      }
    }
    return highest - lowest;
  }

  Vector3d world_place(const SkinnedPart& part, unsigned vertex) const {
    const aiVector3D& v = part.mesh->mVertices[vertex];
    return to_metres_ * part.to_world * Vector3d(v.x, v.y, v.z);
  }

  void make_skeleton() {
    std::vector<RigidTransform> world;
    for (std::size_t j = 0; j < joints_.size(); ++j) {
      world.push_back(to_rigid(to_metres_ * bind_[j]));
      const int parent = joints_.parent(j);
      const RigidTransform local = parent < 0 ? world[j] : world[static_cast<std::size_t>(parent)].inverse() * world[j];
      skeleton_.joints.push_back({joints_.name(j), parent, local.translation, local.rotation.normalized()});
    }
    validate_skeleton(skeleton_, source_);
  }

  void make_body() {
    Welder welder;
    for (const SkinnedPart& part : meshes_) {
      std::vector<Influences> influences(part.mesh->mNumVertices);
      for (unsigned b = 0; b < part.mesh->mNumBones; ++b) {
        const aiBone& bone = *part.mesh->mBones[b];
        const int joint = joints_.find(bone.mName.C_Str());
        for (unsigned w = 0; w < bone.mNumWeights; ++w)
          if (bone.mWeights[w].mVertexId < influences.size() && bone.mWeights[w].mWeight > 0)
            influences[bone.mWeights[w].mVertexId].emplace_back(bone.mWeights[w].mWeight, joint);
      }
      std::vector<std::uint32_t> welded;
      for (unsigned v = 0; v < part.mesh->mNumVertices; ++v) {
        check_vertex(part, v, influences);
        welded.push_back(welder.add(world_place(part, v), influences[v]));
      }
      for (unsigned f = 0; f < part.mesh->mNumFaces; ++f) {
        const aiFace& face = part.mesh->mFaces[f];
        if (face.mNumIndices == 3)
          welder.add_face(welded[face.mIndices[0]], welded[face.mIndices[1]], welded[face.mIndices[2]]);
      }
    }
    result_.body = welder.finish();
    result_.body->skeleton = skeleton_;
    validate_skinned_mesh(*result_.body, source_);
  }

  using Influences = std::vector<std::pair<float, int>>;

  void check_vertex(const SkinnedPart& part, unsigned vertex, const std::vector<Influences>& influences) const {
    const std::string mesh = source_ + ": mesh '" + part.mesh->mName.C_Str() + "'";
    const std::string which = mesh + ": vertex " + std::to_string(vertex);
    if (!world_place(part, vertex).allFinite()) throw_invalid_argument(which + " is not finite");
    if (influences[vertex].empty()) {
      const auto without = std::count_if(influences.begin(), influences.end(), [](auto& row) { return row.empty(); });
      throw_invalid_argument(mesh + ": " + std::to_string(without) +
                             " vertices have no skinning weights, the first is vertex " + std::to_string(vertex));
    }
    float sum = 0;
    for (const auto& [weight, joint] : influences[vertex]) sum += weight;
    if (sum > 0.5F && sum < 1.5F) return;
    // assimp 5.2 copies integer weights of glTF as if they were floats.
    const bool gltf = extension_ == ".gltf" || extension_ == ".glb";
    throw_invalid_argument(which + ": its skinning weights sum to " + number(static_cast<double>(sum)) +
                           (gltf ? " (8- and 16-bit weights can't be read: export them as floats)" : ", not 1"));
  }

  void add_motion(const aiAnimation& animation) {
    const AnimationRange range = range_of(animation);
    const double count = std::floor((range.last - range.first) / range.step + 1e-6) + 1;
    if (!(count <= double{kMaxFrames}))
      throw Error(ErrorCode::kResourceExhausted, source_ + ": an animation of more than 1,000,000 frames");
    Motion motion{skeleton_, range.step / range.ticks_per_second, {}};
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
      const auto at = joints_.at(animation, range.first + static_cast<double>(k) * range.step);
      std::vector<RigidTransform> world;
      for (std::size_t j = 0; j < at.size(); ++j) {
        world.push_back(to_rigid(to_metres_ * at[j]));
        note_scale(at[j], j);
      }
      motion.frames.push_back(pose_from_world(skeleton_, world));
    }
    validate_motion(motion, source_);
    result_.motions.push_back(std::move(motion));
  }

  void note_scale(const Affine3d& at, std::size_t joint) {
    if (scale_noted_) return;
    const double ratio = std::cbrt(std::abs(at.linear().determinant() / bind_[joint].linear().determinant()));
    if (std::abs(ratio - 1) < kScaled) return;
    scale_noted_ = true;
    result_.notes.push_back("joint '" + joints_.name(joint) + "' changes its size in the animation: ignored");
  }

  const aiScene& scene_;
  std::string source_, extension_;
  AssimpJoints joints_;
  std::vector<SkinnedPart> meshes_;
  std::vector<Affine3d> bind_;  // of joints, in the file's world
  Affine3d to_metres_ = Affine3d::Identity();
  Skeleton skeleton_;
  CharacterFile result_;
  bool scale_noted_ = false;
};

fs::path skeleton_beside(const fs::path& amc) {
  fs::path same = amc;
  same.replace_extension(".asf");
  std::error_code ignored;
  if (fs::exists(same, ignored)) return same;
  std::vector<fs::path> found;
  const fs::path folder = amc.parent_path().empty() ? fs::path(".") : amc.parent_path();
  for (const auto& entry : fs::directory_iterator(folder, ignored))
    if (lower_extension(entry.path()) == ".asf") found.push_back(entry.path());
  if (found.size() != 1)
    throw_not_found(amc.string() + ": its skeleton " + same.string() + " does not exist (--asf names another)");
  return found.front();
}

}  // namespace

CharacterFile read_character_file(const fs::path& path) {
  Assimp::Importer importer;
  importer.SetPropertyBool(AI_CONFIG_IMPORT_NO_SKELETON_MESHES, true);
  importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, false);  // joints alone, no helpers between them
  return Reader(read_scene(importer, path, aiProcess_Triangulate), path).read();
}

Motion read_motion(const fs::path& path, std::vector<std::string>& notes, const fs::path& asf) {
  if (lower_extension(path) == ".amc") {
    notes.push_back("an AMC file does not say its rate: 120 frames a second");
    return read_amc(path, read_asf(asf.empty() ? skeleton_beside(path) : asf));
  }
  CharacterFile file = read_character_file(path);
  if (file.motions.empty()) throw_invalid_argument(path.string() + ": no animation");
  if (file.motions.size() > 1)
    notes.push_back("the first of " + std::to_string(file.motions.size()) + " animations is used");
  notes.insert(notes.end(), file.notes.begin(), file.notes.end());
  return std::move(file.motions.front());
}

}  // namespace pleat::body
