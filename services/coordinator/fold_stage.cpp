#include "services/coordinator/fold_stage.hpp"

namespace pleat::coordinator {
namespace {

/// Their motion is in the coarse frames.
template <typename Handles>
void add_handles(const Handles& handles, v1::FoldOpen* open) {
  for (const v1::Handle& handle : handles) {
    v1::Handle& added = *open->add_handles();
    *added.mutable_vertices() = handle.vertices();
    added.set_start_s(handle.start_s());
    if (handle.has_end_s()) added.set_end_s(handle.end_s());
  }
}

}  // namespace

void FoldRpc::absorb(PipelineFrame& frame, v1::FoldedFrame& answer) {
  add_times(frame, *answer.mutable_stage_times());
  frame.fold.Swap(answer.mutable_report());
  auto memory = std::make_shared<Memory>();
  memory->sequence = frame.sequence;
  memory->state.Swap(answer.mutable_state());
  frame.fine.Clear();
  *frame.fine.mutable_positions() = memory->state.positions();
  frame.fold_memory = std::move(memory);
}

void FoldRpc::take_back(PipelineFrame& frame) {
  v1::FoldFrame& request = *sent<Request>(frame).mutable_frame();
  frame.coarse.Swap(request.mutable_coarse());
  frame.coarse.set_index(frame.index);
  frame.obstacles.Swap(request.mutable_obstacles());
}

void FoldRpc::prepare(PipelineFrame& frame) {
  auto work = std::make_shared<Request>();
  v1::FoldFrame& request = *work->mutable_frame();
  request.mutable_coarse()->Swap(&frame.coarse);
  request.mutable_coarse()->set_index(frame.sequence);
  request.mutable_obstacles()->Swap(&frame.obstacles);
  request.mutable_start()->Swap(frame.fine.mutable_positions());
  frame.work = std::move(work);
}

std::shared_ptr<const google::protobuf::Message> FoldRpc::resumed(
    std::shared_ptr<const google::protobuf::Message> request, const Memory& memory) {
  const auto& first = static_cast<const Request&>(*request);
  if (memory.sequence + 1 != first.frame().coarse().index()) return request;
  auto with_state = std::make_shared<Request>(first);
  *with_state->mutable_frame()->mutable_state() = memory.state;
  return with_state;
}

v1::FoldOpen fold_open_of(const v1::Scene& scene) {
  v1::FoldOpen open;
  v1::ClothMaterial& material = *open.mutable_material();
  if (scene.has_material_json()) material.set_json(scene.material_json());
  if (scene.has_isotropic()) *material.mutable_isotropic() = scene.isotropic();
  if (scene.has_material_options()) *material.mutable_options() = scene.material_options();
  add_handles(scene.handles(), &open);
  open.set_frame_time_s(scene.frame_time_s());
  *open.mutable_gravity() = scene.gravity();
  if (scene.has_wind()) *open.mutable_wind() = scene.wind();
  if (scene.contact().has_thickness()) open.set_thickness_m(static_cast<float>(scene.contact().thickness()));
  return open;
}

v1::FoldOpen fold_open_of(const v1::EnhanceOpen& enhance) {
  v1::FoldOpen open;
  *open.mutable_material() = enhance.material();
  add_handles(enhance.handles(), &open);
  open.set_frame_time_s(enhance.frame_time_s());
  *open.mutable_gravity() = enhance.gravity();
  if (enhance.has_wind()) *open.mutable_wind() = enhance.wind();
  return open;
}

}  // namespace pleat::coordinator
