#include "common/mesh/assimp_nodes.hpp"

#include <string>

#include "common/base/error.hpp"
#include "common/base/text_file.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;
using Eigen::Affine3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::uintmax_t kMaxFileBytes = 512U << 20;

Vector3d to_vector(const aiVector3D& v) { return {v.x, v.y, v.z}; }
Quaterniond to_quaternion(const aiQuaternion& q) { return {q.w, q.x, q.y, q.z}; }

Vector3d vector_at(const aiVectorKey* keys, unsigned count, double ticks, const Vector3d& otherwise) {
  if (count == 0) return otherwise;
  const aiVectorKey *before = nullptr, *after = nullptr;
  const double fraction = find_keys(keys, count, ticks, before, after);
  return (1 - fraction) * to_vector(before->mValue) + fraction * to_vector(after->mValue);
}

}  // namespace

const aiScene& read_scene(Assimp::Importer& importer, const fs::path& path, unsigned flags) {
  std::error_code failed;
  if (!fs::is_regular_file(path, failed)) throw_not_found(path.string() + ": no such file");
  refuse_placeholder(path);
  if (fs::file_size(path, failed) > kMaxFileBytes)
    throw Error(ErrorCode::kResourceExhausted, path.string() + ": larger than 512 MiB");
  const aiScene* scene = importer.ReadFile(path.string(), flags);
  if (scene == nullptr || scene->mRootNode == nullptr) {
    std::string why = importer.GetErrorString();
    std::replace(why.begin(), why.end(), '\n', ' ');
    throw_invalid_argument(path.string() + ": can't be read: " + why);
  }
  return *scene;
}

Affine3d to_affine(const aiMatrix4x4& m) {
  Affine3d result = Affine3d::Identity();
  result.matrix().topRows<3>() << m.a1, m.a2, m.a3, m.a4, m.b1, m.b2, m.b3, m.b4, m.c1, m.c2, m.c3, m.c4;
  return result;
}

Affine3d transform_at(const aiNodeAnim& channel, double ticks) {
  Affine3d local = Affine3d::Identity();
  local.translate(vector_at(channel.mPositionKeys, channel.mNumPositionKeys, ticks, Vector3d::Zero()));
  if (channel.mNumRotationKeys > 0) {
    const aiQuatKey *before = nullptr, *after = nullptr;
    const double fraction = find_keys(channel.mRotationKeys, channel.mNumRotationKeys, ticks, before, after);
    local.rotate(to_quaternion(before->mValue).normalized().slerp(fraction, to_quaternion(after->mValue).normalized()));
  }
  local.scale(vector_at(channel.mScalingKeys, channel.mNumScalingKeys, ticks, Vector3d::Ones()));
  return local;
}

}  // namespace pleat
