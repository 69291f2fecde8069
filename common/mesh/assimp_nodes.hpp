// Scenes as assimp reads them: the file, and where its nodes are. In builds with assimp only.
#pragma once

#include <assimp/scene.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <assimp/Importer.hpp>
#include <filesystem>

namespace pleat {

/// The scene, which belongs to the importer. flags: aiPostProcessSteps. Throws kNotFound, kInvalidArgument (assimp
/// can't read it), kResourceExhausted (above 512 MiB); the file is named.
const aiScene& read_scene(Assimp::Importer& importer, const std::filesystem::path& path, unsigned flags);

Eigen::Affine3d to_affine(const aiMatrix4x4& matrix);

/// A node's transform below its parent as a channel of an animation has it, linear between keys. ticks: of the
/// animation.
Eigen::Affine3d transform_at(const aiNodeAnim& channel, double ticks);

/// Keys around a time, and how far between them it is: 0 is at `before`. `keys` ascend in mTime.
template <typename Key>
double find_keys(const Key* keys, unsigned count, double ticks, const Key*& before, const Key*& after) {
  const Key* next = std::upper_bound(keys, keys + count, ticks, [](double t, const Key& key) { return t < key.mTime; });
  before = next == keys ? keys : next - 1;
  after = next == keys + count ? keys + count - 1 : next;
  const double span = after->mTime - before->mTime;
  return span > 0 ? (ticks - before->mTime) / span : 0;
}

/// Whether they are not all one.
template <typename Key>
bool keys_change(const Key* keys, unsigned count) {
  return std::any_of(keys, keys + count, [&](const Key& key) { return !(key.mValue == keys[0].mValue); });
}

}  // namespace pleat
