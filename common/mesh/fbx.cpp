#include "common/mesh/fbx.hpp"

#include <assimp/config.h>

#include <cmath>
#include <string_view>

#include "common/base/checks.hpp"
#include "common/base/error.hpp"
#include "common/base/hash.hpp"
#include "common/base/limits.hpp"
#include "common/mesh/assimp_nodes.hpp"

namespace pleat {
namespace {

using Eigen::Affine3d;

constexpr double kMetresPerCentimetre = 0.01;
constexpr double kTicksPerSecond = 25;  // where the file does not say, as assimp's documentation has it

class FbxMesh final : public AnimatedMesh {
 public:
  explicit FbxMesh(const std::filesystem::path& path) : name_(path.string()) {
    importer_.SetPropertyBool(AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, false);
    importer_.SetPropertyBool(AI_CONFIG_IMPORT_NO_SKELETON_MESHES, true);
    const aiScene& scene = read_scene(importer_, path, 0);
    to_metres_ = axes_and_unit(scene);
    const aiAnimation* animation = scene.mNumAnimations > 0 ? scene.mAnimations[0] : nullptr;
    if (animation != nullptr && animation->mTicksPerSecond > 0) ticks_per_second_ = animation->mTicksPerSecond;
    nodes_.push_back({scene.mRootNode, -1, nullptr});
    for (std::size_t n = 0; n < nodes_.size(); ++n) {
      const aiNode& node = *nodes_[n].node;
      nodes_[n].channel = moving_channel(animation, node);
      for (unsigned m = 0; m < node.mNumMeshes; ++m) add_part(n, *scene.mMeshes[node.mMeshes[m]], animation);
      for (unsigned c = 0; c < node.mNumChildren; ++c)
        nodes_.push_back({node.mChildren[c], static_cast<int>(n), nullptr});
    }
    if (parts_.empty()) fail("no mesh in it");
    times_ = detail::even_times(key_times(), name_);
    make_mesh();
    const Positions first = positions(0);
    mesh_.positions.assign(first.data(), first.data() + first.size());
  }

  const PolygonMesh& mesh() const override { return mesh_; }
  std::size_t frame_count() const override { return times_.count; }
  double frame_time_s() const override { return times_.step / ticks_per_second_; }

  Positions positions(std::size_t frame) const override {
    if (frame >= times_.count) fail("no frame " + std::to_string(frame) + " of " + std::to_string(times_.count));
    const double ticks = times_.first + static_cast<double>(frame) * times_.step;
    std::vector<Affine3d> world(nodes_.size());
    for (std::size_t n = 0; n < nodes_.size(); ++n) {
      const Node& node = nodes_[n];
      world[n] = (node.parent < 0 ? to_metres_ : world[static_cast<std::size_t>(node.parent)]) *
                 (node.channel != nullptr ? transform_at(*node.channel, ticks) : to_affine(node.node->mTransformation));
    }
    Positions points(static_cast<Eigen::Index>(points_), 3);
    Eigen::Index row = 0;
    for (const Part& part : parts_) {
      const std::vector<double> weights = weights_at(part, ticks);
      for (unsigned v = 0; v < part.mesh->mNumVertices; ++v) {
        const Eigen::Vector3d base = to_vector(part.mesh->mVertices[v]);
        Eigen::Vector3d place = base;
        for (std::size_t k = 0; k < weights.size(); ++k)
          if (weights[k] != 0) place += weights[k] * (to_vector(part.mesh->mAnimMeshes[k]->mVertices[v]) - base);
        points.row(row++) = (world[part.node] * place).cast<float>().transpose();
      }
    }
    Positions out(static_cast<Eigen::Index>(first_point_.size()), 3);
    for (std::size_t v = 0; v < first_point_.size(); ++v)
      out.row(static_cast<Eigen::Index>(v)) = points.row(static_cast<Eigen::Index>(first_point_[v]));
    if (!all_finite(out)) fail("frame " + std::to_string(frame) + " is not finite");
    return out;
  }

 private:
  struct Node {
    const aiNode* node = nullptr;
    int parent = -1;                      // an earlier one
    const aiNodeAnim* channel = nullptr;  // where it moves
  };
  struct Part {
    std::size_t node = 0;
    const aiMesh* mesh = nullptr;
    const aiMeshMorphAnim* morph = nullptr;
  };

  [[noreturn]] void fail(const std::string& message) const { throw_invalid_argument(name_ + ": " + message); }
  static Eigen::Vector3d to_vector(const aiVector3D& v) { return {v.x, v.y, v.z}; }

  /// From the file's axes and unit (in centimetres) to metres with Y up.
  Affine3d axes_and_unit(const aiScene& scene) const {
    Eigen::Matrix3d turn = Eigen::Matrix3d::Zero();
    float unit = 1;
    if (scene.mMetaData != nullptr) {
      const char* names[] = {"CoordAxis", "UpAxis", "FrontAxis"};
      for (int row = 0; row < 3; ++row) {
        int axis = row, sign = 1;
        scene.mMetaData->Get(names[row], axis);
        scene.mMetaData->Get(names[row] + std::string("Sign"), sign);
        if (axis >= 0 && axis < 3) turn(row, axis) = sign < 0 ? -1 : 1;
      }
      scene.mMetaData->Get("UnitScaleFactor", unit);
    }
    if (std::abs(turn.determinant()) < 0.5) turn.setIdentity();
    if (!(unit > 0) || !std::isfinite(unit)) fail("its unit is not above 0");
    Affine3d transform = Affine3d::Identity();
    transform.linear() = kMetresPerCentimetre * static_cast<double>(unit) * turn;
    return transform;
  }

  /// Exporters bake every node: only what changes moves.
  static const aiNodeAnim* moving_channel(const aiAnimation* animation, const aiNode& node) {
    for (unsigned c = 0; animation != nullptr && c < animation->mNumChannels; ++c) {
      const aiNodeAnim& channel = *animation->mChannels[c];
      if (channel.mNodeName == node.mName) return &channel;
    }
    return nullptr;
  }
  static std::vector<double> changes(const aiNodeAnim& channel) {
    std::vector<double> times;
    const auto add = [&](const auto* keys, unsigned count) {
      if (!keys_change(keys, count)) return;
      for (unsigned k = 0; k < count; ++k) times.push_back(keys[k].mTime);
    };
    add(channel.mPositionKeys, channel.mNumPositionKeys);
    add(channel.mRotationKeys, channel.mNumRotationKeys);
    add(channel.mScalingKeys, channel.mNumScalingKeys);
    return times;
  }

  void add_part(std::size_t node, const aiMesh& mesh, const aiAnimation* animation) {
    const std::string what = "mesh '" + std::string(mesh.mName.C_Str()) + "'";
    if (mesh.mNumFaces == 0 || (mesh.mPrimitiveTypes & (aiPrimitiveType_TRIANGLE | aiPrimitiveType_POLYGON)) == 0)
      return;
    if (mesh.mNumBones > 0) fail(what + " is moved by a skeleton; name the file as a `body`, or bake its frames");
    Part part{node, &mesh, nullptr};
    for (unsigned k = 0; k < mesh.mNumAnimMeshes; ++k) {
      if (mesh.mAnimMeshes[k]->mNumVertices != mesh.mNumVertices || !mesh.mAnimMeshes[k]->HasPositions())
        fail(what + ": a blend shape has another number of vertices");
    }
    const std::string channel = std::string(nodes_[node].node->mName.C_Str()) + "*";
    for (unsigned c = 0; animation != nullptr && c < animation->mNumMorphMeshChannels && part.morph == nullptr; ++c) {
      const aiMeshMorphAnim* morph = animation->mMorphMeshChannels[c];
      if (std::string_view(morph->mName.C_Str()).starts_with(channel) && morph->mNumKeys > 0) part.morph = morph;
    }
    points_ += mesh.mNumVertices;
    if (points_ > 4 * kMaxFaces) throw Error(ErrorCode::kResourceExhausted, name_ + ": too many faces");
    parts_.push_back(part);
  }

  std::vector<double> key_times() const {
    std::vector<double> times;
    for (const Part& part : parts_) {
      for (unsigned k = 0; part.morph != nullptr && k < part.morph->mNumKeys; ++k)
        times.push_back(part.morph->mKeys[k].mTime);
      for (int n = static_cast<int>(part.node); n >= 0; n = nodes_[static_cast<std::size_t>(n)].parent) {
        const aiNodeAnim* channel = nodes_[static_cast<std::size_t>(n)].channel;
        if (channel == nullptr) continue;
        const std::vector<double> moves = changes(*channel);
        times.insert(times.end(), moves.begin(), moves.end());
      }
    }
    return times;
  }

  static std::vector<double> weights_at(const Part& part, double ticks) {
    if (part.morph == nullptr) return {};
    std::vector<double> weights(part.mesh->mNumAnimMeshes, 0);
    const aiMeshMorphKey *before = nullptr, *after = nullptr;
    const double fraction = find_keys(part.morph->mKeys, part.morph->mNumKeys, ticks, before, after);
    for (const auto& [key, share] : {std::pair{before, 1 - fraction}, std::pair{after, fraction}}) {
      for (unsigned i = 0; i < key->mNumValuesAndWeights; ++i)
        if (key->mValues[i] < weights.size()) weights[key->mValues[i]] += share * key->mWeights[i];
    }
    return weights;
  }

  void make_mesh() {
    detail::PointWelder welder;
    for (const Part& part : parts_) {
      for (unsigned v = 0; v < part.mesh->mNumVertices; ++v) {
        Hash motion;
        for (unsigned k = 0; part.morph != nullptr && k < part.mesh->mNumAnimMeshes; ++k) {
          const aiVector3D place = part.mesh->mAnimMeshes[k]->mVertices[v] + aiVector3D(0, 0, 0);  // -0 is 0
          motion.add({reinterpret_cast<const char*>(&place), sizeof place});
        }
        const aiVector3D& place = part.mesh->mVertices[v];
        const float values[] = {place.x, place.y, place.z};
        welder.add(values, static_cast<std::uint32_t>(part.node), motion.value());
      }
    }
    first_point_ = welder.first_point();
    if (first_point_.size() > kMaxVertices)
      throw Error(ErrorCode::kResourceExhausted, name_ + ": more than " + std::to_string(kMaxVertices) + " vertices");
    std::size_t point = 0;
    for (const Part& part : parts_) {
      std::vector<std::uint32_t> sizes, vertices;
      std::vector<float> uv;
      for (unsigned f = 0; f < part.mesh->mNumFaces; ++f) {
        const aiFace& face = part.mesh->mFaces[f];
        if (face.mNumIndices < 3) continue;  // points and lines
        sizes.push_back(face.mNumIndices);
        for (unsigned k = 0; k < face.mNumIndices; ++k) {
          const unsigned corner = face.mIndices[k];
          if (corner >= part.mesh->mNumVertices) fail("a face names a vertex that is not there");
          vertices.push_back(welder.vertex()[point + corner]);
          if (!part.mesh->HasTextureCoords(0)) continue;
          uv.push_back(part.mesh->mTextureCoords[0][corner].x);
          uv.push_back(part.mesh->mTextureCoords[0][corner].y);
        }
      }
      append_faces(mesh_,
                   {.file = name_,
                    .mesh = "mesh '" + std::string(part.mesh->mName.C_Str()) + "'",
                    .sizes = sizes,
                    .vertices = vertices,
                    .vertex_count = first_point_.size(),
                    .uv = uv,
                    .clockwise = mirrored(part.node)},
                   0);
      point += part.mesh->mNumVertices;
    }
  }

  bool mirrored(std::size_t node) const {
    double sign = to_metres_.linear().determinant();
    for (int n = static_cast<int>(node); n >= 0; n = nodes_[static_cast<std::size_t>(n)].parent)
      sign *= to_affine(nodes_[static_cast<std::size_t>(n)].node->mTransformation).linear().determinant() < 0 ? -1 : 1;
    return sign < 0;
  }

  std::string name_;
  Assimp::Importer importer_;
  Affine3d to_metres_ = Affine3d::Identity();
  double ticks_per_second_ = kTicksPerSecond;
  std::vector<Node> nodes_;
  std::vector<Part> parts_;
  std::size_t points_ = 0;
  detail::FrameTimes times_;
  std::vector<std::size_t> first_point_;  // of each vertex
  PolygonMesh mesh_;
};

}  // namespace

std::unique_ptr<AnimatedMesh> open_fbx(const std::filesystem::path& path) { return std::make_unique<FbxMesh>(path); }

}  // namespace pleat
