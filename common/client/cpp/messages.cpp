#include "common/client/cpp/messages.hpp"

#include <google/protobuf/repeated_field.h>

#include "common/base/checks.hpp"
#include "common/rpc/status.hpp"

namespace pleat::client {
namespace {

template <typename Scalar>
void assign(const std::vector<Scalar>& values, google::protobuf::RepeatedField<Scalar>* field) {
  field->Assign(values.begin(), values.end());
}

template <typename Scalar>
std::vector<Scalar> vector_of(const google::protobuf::RepeatedField<Scalar>& field) {
  return {field.begin(), field.end()};
}

/// (V x 3); `vertices` 0 accepts any.
std::vector<float> positions_of(const google::protobuf::RepeatedField<float>& field, std::size_t vertices,
                                const std::string& name) {
  std::vector<float> values = vector_of(field);
  check_rows(values.size(), 3, name);
  if (vertices > 0 && values.size() != 3 * vertices) {
    throw_invalid_argument(name + ": " + std::to_string(values.size()) + " values, " + std::to_string(3 * vertices) +
                           " needed for " + std::to_string(vertices) + " vertices");
  }
  check_finite(values, name);
  return values;
}

ObstacleFrame obstacle_of(const v1::ObstacleFrame& message) {
  const std::string name = "obstacle '" + message.name() + "'";
  ObstacleFrame obstacle;
  obstacle.name = message.name();
  if (message.center_size() == 3) std::copy_n(message.center().begin(), 3, obstacle.center.begin());
  obstacle.radius = message.radius();
  obstacle.positions = positions_of(message.positions(), 0, name + ".positions");
  obstacle.capsule_ends = positions_of(message.capsule_ends(), 0, name + ".capsule_ends");
  obstacle.capsule_radii = vector_of(message.capsule_radii());
  return obstacle;
}

void to_message(const ObstacleFrame& obstacle, v1::ObstacleFrame* message) {
  message->Clear();
  message->set_name(obstacle.name);
  if (obstacle.radius > 0) {
    message->mutable_center()->Assign(obstacle.center.begin(), obstacle.center.end());
    message->set_radius(obstacle.radius);
  }
  assign(obstacle.positions, message->mutable_positions());
  assign(obstacle.capsule_ends, message->mutable_capsule_ends());
  assign(obstacle.capsule_radii, message->mutable_capsule_radii());
}

}  // namespace

void to_message(const Mesh& mesh, v1::Topology* message) {
  assign(mesh.positions, message->mutable_rest_positions());
  assign(mesh.faces, message->mutable_faces());
  assign(mesh.uv, message->mutable_uv());
  assign(mesh.uv_faces, message->mutable_uv_faces());
}

void to_message(const ObstacleShape& shape, v1::ObstacleShape* message) {
  message->set_name(shape.name);
  assign(shape.faces, message->mutable_faces());
  message->set_capsules(shape.capsules);
}

void to_message(const CoarseFrame& frame, v1::EnhanceFrame* message) {
  v1::Frame* coarse = message->mutable_coarse();
  coarse->set_index(frame.index);
  coarse->set_time_s(frame.time_s);
  assign(frame.positions, coarse->mutable_positions());
  assign(frame.velocities, coarse->mutable_velocities());
  message->clear_obstacles();
  for (const ObstacleFrame& obstacle : frame.obstacles) to_message(obstacle, message->add_obstacles());
}

Mesh from_message(const v1::Topology& message, const std::string& field) {
  Mesh mesh;
  mesh.positions = positions_of(message.rest_positions(), 0, field + ".rest_positions");
  mesh.faces = vector_of(message.faces());
  mesh.uv = vector_of(message.uv());
  mesh.uv_faces = vector_of(message.uv_faces());
  check_rows(mesh.faces.size(), 3, field + ".faces");
  check_indices(mesh.faces, mesh.vertex_count(), field + ".faces");
  check_rows(mesh.uv.size(), 2, field + ".uv");
  check_finite(mesh.uv, field + ".uv");
  if (!mesh.uv_faces.empty() && mesh.uv_faces.size() != mesh.faces.size())
    throw_invalid_argument(field + ".uv_faces: not as many as faces");
  check_indices(mesh.uv_faces, mesh.uv.size() / 2, field + ".uv_faces");
  return mesh;
}

ObstacleShape from_message(const v1::ObstacleShape& message) {
  return {message.name(), vector_of(message.faces()), message.capsules()};
}

EnhancedFrame from_message(const v1::EnhancedFrame& message, std::size_t vertices) {
  EnhancedFrame frame;
  frame.index = message.fine().index();
  frame.time_s = message.fine().time_s();
  frame.positions = positions_of(message.fine().positions(), vertices, "frame.fine");
  const v1::RefinementReport& report = message.report();
  frame.report = {report.self_intersections_before(), report.self_intersections_after(), report.penetrations_before(),
                  report.penetrations_after(),        report.vertices_moved(),           report.largest_move_m(),
                  report.input_intersects()};
  if (message.has_fold()) {
    const v1::FoldReport& fold = message.fold();
    frame.fold = FoldReport{fold.steps(), fold.layer_contacts(), fold.obstacle_contacts(), fold.restarted()};
  }
  for (const v1::StageTime& time : message.stage_times()) frame.stage_times.push_back({time.stage(), time.ms()});
  frame.coarse = positions_of(message.coarse().positions(), 0, "frame.coarse");
  for (const v1::ObstacleFrame& obstacle : message.obstacles()) frame.obstacles.push_back(obstacle_of(obstacle));
  return frame;
}

EnhancedFrame from_message(const v1::FrameError& message) {
  EnhancedFrame frame;
  frame.index = message.index();
  const auto status = static_cast<grpc::StatusCode>(message.code());
  frame.error.emplace(status == grpc::StatusCode::OK ? ErrorCode::kInternal : rpc::to_error_code(status),
                      "frame " + std::to_string(message.index()) + ": " + message.message());
  return frame;
}

}  // namespace pleat::client
