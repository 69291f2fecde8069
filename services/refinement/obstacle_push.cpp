#include "services/refinement/obstacle_push.hpp"

#include <algorithm>
#include <cmath>

namespace pleat::refinement {
namespace {

// Weight of standing still against bending: displacements fade over about four edges.
constexpr double kStandStill = 1e-3;
// Moves below this share of the clearance are projected: no wrinkle suffers from them.
constexpr double kProjectedShare = 0.1;
// Where the solution has faded to this, metres, the cloth stays as it is.
constexpr float kFaded = 1e-5f;
// The solver stops spreading it somewhat later.
constexpr float kUnread = 0.3f * kFaded;
constexpr int kProjections = 5;
constexpr int kFaceSweeps = 12;

// Float positions may miss the clearance by a rounding.
bool too_near(const VertexContact& c, double clearance) {
  return c.contact.distance < clearance - kPenetrationTolerance;
}

Eigen::Vector3d required_move(const VertexContact& c, double clearance) {
  return (clearance - c.contact.distance) * c.contact.normal;
}

}  // namespace

void ObstaclePush::prepare() {
  if (!solver_) solver_.emplace(faces_, vertex_count_, kStandStill);
}

// One smooth displacement of all vertices towards what contacts_ require.
bool ObstaclePush::solve(Positions& positions, double clearance) {
  prepare();
  solver_->begin();
  for (const VertexContact& c : contacts_) solver_->add_load(c.vertex, required_move(c, clearance).cast<float>());
  solver_->solve();
  // The length of the step that comes nearest to all required moves.
  double along = 0, squared = 0;
  for (const VertexContact& c : contacts_) {
    const Eigen::Vector3d u = solver_->displacement(c.vertex).cast<double>();
    along += u.dot(required_move(c, clearance));
    squared += u.squaredNorm();
  }
  if (!(along > 0 && squared > 0)) return false;
  const auto scale = static_cast<float>(along / squared);
  solver_->spread(kUnread / scale);
  for (std::uint32_t v = 0; v < static_cast<std::uint32_t>(vertex_count_); ++v) {
    const Eigen::Vector3f move = scale * solver_->displacement(v);
    if (move.squaredNorm() > kFaded * kFaded) positions.row(v) += move.transpose();
  }
  return true;
}

// Moves what contacts_ require at once, and again where that leads into another obstacle.
bool ObstaclePush::project(Positions& positions, const ObstacleField& field, double clearance) {
  const bool any = !contacts_.empty();
  for (int i = 0; i < kProjections && !contacts_.empty(); ++i) {
    still_.clear();
    for (const VertexContact& c : contacts_) {
      positions.row(c.vertex) += required_move(c, clearance).cast<float>().transpose();
      const auto contact = field.contact(positions.row(c.vertex).cast<double>(), clearance);
      if (contact && too_near({c.vertex, *contact}, clearance)) still_.push_back({c.vertex, *contact});
    }
    contacts_.swap(still_);
  }
  return any;
}

bool ObstaclePush::apply(Positions& positions, ObstacleField& field, SelfIntersectionFinder& finder,
                         ClothContacts& contacts, double clearance) {
  if (field.empty()) return false;
  const auto find_contacts = [&] {
    contacts.find_contacts(positions, field, finder, clearance, contacts_);
    std::erase_if(contacts_, [&](const VertexContact& c) { return !too_near(c, clearance); });
  };
  const auto update = [&] {
    finder.update(positions);
    contacts.update(positions, field, finder);
  };
  bool moved = false;
  find_contacts();
  const auto worth_a_solve = [&](const VertexContact& c) {
    return clearance - c.contact.distance > kProjectedShare * clearance;
  };
  for (int round = 0; round < rounds_ && std::any_of(contacts_.begin(), contacts_.end(), worth_a_solve); ++round) {
    if (!solve(positions, clearance)) break;
    moved = true;
    update();
    find_contacts();
  }
  if (project(positions, field, clearance)) {
    moved = true;
    update();
  }
  for (int sweep = 0; sweep < kFaceSweeps; ++sweep) {
    contacts.find_penetrations(positions, field, finder, penetrating_);
    bool pushed = false;
    for (const std::uint32_t f : penetrating_) {
      pushed = field.push_face_out(positions, faces_, f, clearance) || pushed;
    }
    if (!pushed) break;
    moved = true;
    update();
  }
  return moved;
}

}  // namespace pleat::refinement
