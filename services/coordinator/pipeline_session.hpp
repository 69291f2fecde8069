// What the stages of a session agree on, and where that comes from: the request, the bundle, conversion.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/frame/detail.hpp"
#include "common/mesh/smooth_upsampling.hpp"
#include "common/mesh/subdivision.hpp"
#include "pleat/v1/conversion.pb.h"
#include "pleat/v1/scene.pb.h"
#include "pleat/v1/superres.pb.h"
#include "services/coordinator/pipeline_frame.hpp"
#include "services/coordinator/remote_stage.hpp"

namespace pleat::coordinator {

/// One address or several (replicas) per service.
struct ServiceAddresses {
  std::vector<std::string> simulation, conversion, superres, refinement, fold;
};

/// "a,b" -> {a, b}. Throws kInvalidArgument, naming the service, if none is left.
std::vector<std::string> split_addresses(const std::string& service, const std::string& list);

/// What the stages of one session agree on.
struct PipelineSession {
  v1::Topology coarse;
  std::optional<v1::Topology> network_coarse;  ///< coarse_for_network(): what conversion and the network are told
  v1::Detail detail = v1::DETAIL_NETWORK;      ///< checked
  v1::FoldOpen fold;          ///< for the fold step; mesh, obstacles, clearance and window go in from here
  std::size_t fold_turn = 0;  ///< which of several fold services is asked first
  std::shared_ptr<const FoldMemory> fold_memory;        ///< of the frame before first_sequence, where there is one
  v1::ModelDescription model;                           ///< empty without a network
  std::shared_ptr<const NetworkMemory> network_memory;  ///< as fold_memory, of a network that remembers
  v1::Representation representation;  ///< of the model, or with another subdivision that was asked for; without a
                                      ///< network the subdivision alone
  v1::ConversionOpened conversion;    ///< what conversion says of it: describe_conversion(); empty without a network
  std::shared_ptr<const SmoothUpsampling> upsampling;  ///< makes the fine mesh where nothing else does: DETAIL_NONE
  std::vector<v1::Frame> earlier;  ///< the frames before first_sequence that its window needs, the oldest first
  google::protobuf::RepeatedPtrField<v1::ObstacleShape> obstacles;
  std::optional<float> clearance_m;
  bool skip_refinement = false;
  std::uint32_t window = 4;          ///< frames in flight per stage and replica
  std::uint64_t first_sequence = 0;  ///< of the first frame
};

/// Before anything is made of a mesh: throws kResourceExhausted if `rounds` subdivisions of it have more than
/// `max_vertices` vertices (each multiplies them by four), and kInvalidArgument for more than kMaxSubdivisionRounds.
/// `what` goes before the message. Returns how many vertices that is at most.
std::int64_t admit(std::int64_t coarse_vertices, int rounds, std::int64_t max_vertices, const std::string& what);

/// Asks the super-resolution service what a bundle is, until it answers or the outage is too long. `name` empty: the
/// service's default. `cancelled` is asked between attempts. Errors: kNotFound, kUnavailable (naming the address), ...
v1::ModelDescription describe_model(const ServiceAddresses& addresses, const LinkOptions& link, const std::string& name,
                                    const std::function<bool()>& cancelled);

/// The coarse mesh in the place and direction in which the bundle knows it, for a mesh that was only moved or turned:
/// rest positions are what conversion aligns frames to, and nothing else, so that the frames stay as they are. Nothing
/// where it is the bundle's own mesh, or the bundle serves any. Throws kFailedPrecondition, with both hashes, for
/// another mesh.
std::optional<v1::Topology> coarse_for_network(const v1::ModelDescription& model, const Topology& coarse);

/// What a job's frames are for the network, or without one how its fine mesh comes from the coarse one: as the bundle
/// says, unless the scene does; the coarse mesh itself with DETAIL_COARSE.
v1::Representation representation_of(const v1::Scene& scene, v1::Detail detail, const v1::ModelDescription& model);

/// What stands in for a bundle's description where there is none: where the fold step runs, and in what precision.
v1::ModelDescription without_model();

/// Asks the conversion service for what a session will get, as describe_model() asks for the bundle.
v1::ConversionOpened describe_conversion(const ServiceAddresses& addresses, const LinkOptions& link,
                                         const PipelineSession& session, const std::function<bool()>& cancelled);

/// Whether the session's network goes on from what its last frame left.
inline bool network_remembers(const PipelineSession& session) { return session.model.state_values() > 0; }

/// What conversion is set up with.
v1::ConversionSetup conversion_setup(const PipelineSession& session);
/// Throws kInternal unless a stage's fine mesh is the session's; an empty hash says nothing.
void check_fine_hash(const std::string& hash, const std::string& expected);

/// The fine mesh of a session, and how it comes from the coarse one. Throws kInternal unless it is the one that
/// conversion has described.
/// meanwhile: done while the mesh is made, for example to ask conversion, which makes the same one for itself.
Subdivision subdivision_of(const PipelineSession& session, const Topology& coarse,
                           const std::function<void()>& meanwhile = {});

/// Throws kFailedPrecondition, saying what differs, if frames of the bundle that describes itself as `now` must not
/// follow those of `before`. Where it runs (device, precision) may change.
void require_same_bundle(const v1::ModelDescription& before, const v1::ModelDescription& now);

}  // namespace pleat::coordinator
