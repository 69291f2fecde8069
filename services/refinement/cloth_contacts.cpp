#include "services/refinement/cloth_contacts.hpp"

#include <algorithm>
#include <cmath>

#include "services/refinement/for_ranges.hpp"

namespace pleat::refinement {
namespace {

using Vec3 = Eigen::Vector3d;

constexpr std::size_t kPatchesPerRange = 32;

enum Side : std::uint8_t { kUnknown, kOutside, kInside };

std::uint32_t root_of(std::vector<std::uint32_t>& parent, std::uint32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

Box bounds_of(const Capsule& capsule) {
  Box box;
  box.extend(capsule.a, capsule.radius);
  box.extend(capsule.b, capsule.radius);
  return box;
}

bool outside(const Box& box, const Positions& positions, std::uint32_t v) {
  for (int k = 0; k < 3; ++k) {
    if (positions(v, k) < box.lower[k] || positions(v, k) > box.upper[k]) return true;
  }
  return false;
}

}  // namespace

ClothContacts::ClothContacts(const Faces& faces, Eigen::Index vertex_count, ThreadPool* pool)
    : faces_(faces), pool_(pool), stamps_(static_cast<std::size_t>(vertex_count), 0) {}

void ClothContacts::begin_collecting() {
  if (++stamp_ != 0) return;
  std::fill(stamps_.begin(), stamps_.end(), 0u);
  stamp_ = 1;
}

void ClothContacts::collect(std::uint32_t vertex, std::vector<std::uint32_t>& out) {
  if (stamps_[vertex] == stamp_) return;
  stamps_[vertex] = stamp_;
  out.push_back(vertex);
}

void ClothContacts::prepare_packs(std::size_t patches) {
  const std::size_t ranges = (patches + kPatchesPerRange - 1) / kPatchesPerRange;
  if (packs_.size() < ranges) packs_.resize(ranges);
}

bool ClothContacts::is_inside(MeshScan& scan, std::uint32_t vertex) const {
  return scan.side[root_of(scan.parent, vertex)] == kInside;
}

void ClothContacts::list_patch_vertices(const SelfIntersectionFinder& finder) {
  std::vector<std::uint32_t> others;
  for (std::uint32_t patch = 0; patch < finder.patch_count(); ++patch) {
    begin_collecting();
    others.clear();
    PatchVertices list{};
    list.begin = static_cast<std::uint32_t>(patch_vertices_.size());
    const auto [first, last] = finder.patch_faces(patch);
    for (std::uint32_t f = first; f < last; ++f) {
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t v = faces_(f, k);
        collect(v, finder.patches_at(v).front() == patch ? patch_vertices_ : others);
      }
    }
    list.own_end = static_cast<std::uint32_t>(patch_vertices_.size());
    patch_vertices_.insert(patch_vertices_.end(), others.begin(), others.end());
    list.end = static_cast<std::uint32_t>(patch_vertices_.size());
    patch_lists_.push_back(list);
  }
}

void ClothContacts::update(const Positions& positions, const ObstacleField& field,
                           const SelfIntersectionFinder& finder) {
  if (patch_lists_.empty()) list_patch_vertices(finder);
  scans_.resize(field.parts().size());
  for (std::size_t i = 0; i < scans_.size(); ++i) {
    const ObstacleField::Part& part = field.parts()[i];
    if (!part.present || part.mesh == nullptr) continue;
    std::vector<std::uint32_t>& patches = scans_[i].patches;
    patches.clear();
    finder.query_patches(part.mesh->bounds(), [&](std::uint32_t patch) { patches.push_back(patch); });
    std::sort(patches.begin(), patches.end());
    scan(positions, *part.mesh, finder, scans_[i]);
  }
}

// Of scan.patches: which faces meet the surface, and on which side of it the others are.
void ClothContacts::scan(const Positions& positions, const MeshObstacle& mesh, const SelfIntersectionFinder& finder,
                         MeshScan& scan) {
  scan.crosses.resize(static_cast<std::size_t>(faces_.rows()));
  scan.cut.resize(scan.patches.size());
  scan.parent.resize(stamps_.size());
  scan.side.resize(stamps_.size());
  prepare_packs(scan.patches.size());
  const auto cross = [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint32_t>& packs = packs_[begin / kPatchesPerRange];
    for (std::size_t i = begin; i < end; ++i) {
      const auto [first, last] = finder.patch_faces(scan.patches[i]);
      packs.clear();
      mesh.find_packs(finder.patch_box(scan.patches[i]), packs);
      std::uint8_t any = 0;
      for (std::uint32_t f = first; f < last; ++f) {
        scan.crosses[f] = !packs.empty() && mesh.intersects({positions.row(faces_(f, 0)), positions.row(faces_(f, 1)),
                                                             positions.row(faces_(f, 2))},
                                                            packs);
        any |= scan.crosses[f];
      }
      scan.cut[i] = any;
    }
  };
  for_ranges(pool_, scan.patches.size(), kPatchesPerRange, cross);

  begin_collecting();
  scan.vertices.clear();
  for (const std::uint32_t patch : scan.patches) {
    for (const std::uint32_t v : vertices_of(patch)) collect(v, scan.vertices);
  }
  for (const std::uint32_t v : scan.vertices) {
    scan.parent[v] = v;
    scan.side[v] = kUnknown;
  }
  for (std::size_t i = 0; i < scan.patches.size(); ++i) {
    if (scan.cut[i] == 0) {
      // As all its faces would: a patch is one piece.
      const std::span<const std::uint32_t> all = vertices_of(scan.patches[i]);
      const std::uint32_t a = root_of(scan.parent, all.front());
      for (const std::uint32_t v : all.subspan(1)) scan.parent[root_of(scan.parent, v)] = a;
      continue;
    }
    const auto [first, last] = finder.patch_faces(scan.patches[i]);
    for (std::uint32_t f = first; f < last; ++f) {
      if (scan.crosses[f] != 0) continue;
      const std::uint32_t a = root_of(scan.parent, faces_(f, 0));
      for (int k = 1; k < 3; ++k) scan.parent[root_of(scan.parent, faces_(f, k))] = a;
    }
  }
  for (const std::uint32_t v : scan.vertices) {
    if (outside(mesh.bounds(), positions, v)) scan.side[root_of(scan.parent, v)] = kOutside;
  }
  scan.any_inside = false;
  for (const std::uint32_t v : scan.vertices) {
    std::uint8_t& side = scan.side[root_of(scan.parent, v)];
    if (side != kUnknown) continue;
    const auto contact = mesh.contact(positions.row(v).cast<double>(), kPenetrationTolerance);
    if (contact && std::abs(contact->distance) <= kPenetrationTolerance) continue;  // the next one may know
    side = contact ? kInside : kOutside;
    scan.any_inside |= side == kInside;
  }
}

void ClothContacts::find_contacts(const Positions& positions, const ObstacleField& field,
                                  const SelfIntersectionFinder& finder, double reach, std::vector<VertexContact>& out) {
  out.clear();
  boxes_.clear();
  field.append_bounds(reach, boxes_);
  patches_.clear();
  for (const Box& box : boxes_) finder.query_patches(box, [&](std::uint32_t patch) { patches_.push_back(patch); });
  std::sort(patches_.begin(), patches_.end());
  patches_.erase(std::unique(patches_.begin(), patches_.end()), patches_.end());
  found_.resize(stamps_.size());
  is_found_.assign(stamps_.size(), 0);
  const auto consider = [&](std::uint32_t v, const ObstacleContact& contact) {
    if (contact.distance > reach || (is_found_[v] != 0 && contact.distance >= found_[v].distance)) return;
    found_[v] = contact;
    is_found_[v] = 1;
  };
  prepare_packs(patches_.size());
  const auto search = [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint32_t>& packs = packs_[begin / kPatchesPerRange];
    for (std::size_t i = begin; i < end; ++i) {
      const std::span<const std::uint32_t> own = own_vertices_of(patches_[i]);
      const Box around = widened(finder.patch_box(patches_[i]), reach);
      for (const ObstacleField::Part& obstacle : field.parts()) {
        if (!obstacle.present) continue;
        if (obstacle.mesh == nullptr) {
          for (const std::uint32_t v : own) {
            const Vec3 p = positions.row(v).cast<double>();
            for (const Capsule& capsule : obstacle.capsules) consider(v, capsule_contact(capsule, p));
          }
          continue;
        }
        packs.clear();
        obstacle.mesh->find_packs(around, packs);
        if (packs.empty()) continue;
        for (const std::uint32_t v : own) {
          const auto near = obstacle.mesh->contact_near(positions.row(v).cast<double>(), reach, packs);
          if (near) consider(v, *near);
        }
      }
    }
  };
  for_ranges(pool_, patches_.size(), kPatchesPerRange, search);
  // Deep inside a mesh, few if any: the nearest face is searched without bound.
  for (std::size_t part = 0; part < field.parts().size(); ++part) {
    const ObstacleField::Part& obstacle = field.parts()[part];
    if (!obstacle.present || obstacle.mesh == nullptr || !scans_[part].any_inside) continue;
    MeshScan& scan = scans_[part];
    for (const std::uint32_t v : scan.vertices) {
      if (outside(obstacle.mesh->bounds(), positions, v) || !is_inside(scan, v)) continue;
      const auto deep = obstacle.mesh->contact(positions.row(v).cast<double>(), 0);
      if (deep) consider(v, *deep);
    }
  }
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(stamps_.size()); ++v) {
    if (is_found_[v] != 0) out.push_back({v, found_[v]});
  }
}

void ClothContacts::append_penetrations(MeshScan& scan, const SelfIntersectionFinder& finder,
                                        std::vector<std::uint32_t>& out) const {
  for (const std::uint32_t patch : scan.patches) {
    const auto [first, last] = finder.patch_faces(patch);
    for (std::uint32_t f = first; f < last; ++f) {
      if (scan.crosses[f] != 0 || (scan.any_inside && is_inside(scan, faces_(f, 0)))) out.push_back(f);
    }
  }
}

void ClothContacts::find_penetrations(const Positions& positions, const ObstacleField& field,
                                      const SelfIntersectionFinder& finder, std::vector<std::uint32_t>& out) {
  out.clear();
  for (std::size_t part = 0; part < field.parts().size(); ++part) {
    const ObstacleField::Part& obstacle = field.parts()[part];
    if (!obstacle.present) continue;
    if (obstacle.mesh != nullptr) {
      append_penetrations(scans_[part], finder, out);
      continue;
    }
    for (const Capsule& capsule : obstacle.capsules) {
      finder.query(bounds_of(capsule), [&](std::uint32_t f) {
        if (reaches_in(capsule, positions, faces_, f)) out.push_back(f);
      });
    }
  }
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
}

void ClothContacts::find_penetrations_again(const Positions& positions, const ObstacleField& field,
                                            const SelfIntersectionFinder& finder,
                                            std::span<const std::uint32_t> moved_patches,
                                            std::vector<std::uint32_t>& faces) {
  is_moved_.resize(finder.patch_count(), 0);
  for (const std::uint32_t p : moved_patches) is_moved_[p] = 1;
  std::erase_if(faces, [&](std::uint32_t f) { return is_moved_[finder.patch_of(f)] != 0; });
  for (const std::uint32_t p : moved_patches) is_moved_[p] = 0;
  for (const ObstacleField::Part& part : field.parts()) {
    if (!part.present) continue;
    if (part.mesh != nullptr) {
      again_.patches.clear();
      for (const std::uint32_t p : moved_patches) {
        if (part.mesh->bounds().overlaps(finder.patch_box(p))) again_.patches.push_back(p);
      }
      scan(positions, *part.mesh, finder, again_);
      append_penetrations(again_, finder, faces);
      continue;
    }
    for (const Capsule& capsule : part.capsules) {
      const Box bounds = bounds_of(capsule);
      for (const std::uint32_t p : moved_patches) {
        if (!bounds.overlaps(finder.patch_box(p))) continue;
        const auto [first, last] = finder.patch_faces(p);
        for (std::uint32_t f = first; f < last; ++f) {
          if (reaches_in(capsule, positions, faces_, f)) faces.push_back(f);
        }
      }
    }
  }
  std::sort(faces.begin(), faces.end());
  faces.erase(std::unique(faces.begin(), faces.end()), faces.end());
}

}  // namespace pleat::refinement
