#include "services/coordinator/pipeline_session.hpp"

#include <google/protobuf/util/message_differencer.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <future>
#include <thread>

#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "common/frame/rigid_alignment.hpp"
#include "common/mesh/mesh.hpp"
#include "pleat/v1/conversion.grpc.pb.h"
#include "pleat/v1/superres.grpc.pb.h"

namespace pleat::coordinator {
namespace {

/// Of a mesh's extent: what is left of a rigid motion by numbers that are written with six digits.
constexpr float kSamePlace = 1e-4F;

/// Calls one of the addresses after the other until one answers, or the outage is too long.
template <typename Response, typename Call>
Response ask(const std::string& service, const std::vector<std::string>& addresses, const LinkOptions& link,
             const std::function<bool()>& cancelled, const Call& call) {
  Outage outage(link.give_up);
  Backoff backoff(std::chrono::milliseconds(50), std::chrono::milliseconds(400));
  for (std::size_t attempt = 0;; ++attempt) {
    const std::vector<std::string> replicas = replicas_behind(link.replicas, addresses);
    const std::string& address = replicas[attempt % replicas.size()];
    Response response;
    grpc::ClientContext context;
    add_origin(context, link);
    context.set_deadline(std::chrono::system_clock::now() + std::min(link.open_timeout, link.give_up));
    const grpc::Status status = call(link.connect(address), &context, &response);
    if (status.ok()) return response;
    const Error error = rpc::to_error(status, service + " at " + address);
    if (!may_pass(error.code())) throw error;
    if (outage.too_long()) throw outage.gave_up(error);
    if (cancelled()) throw Error(ErrorCode::kCancelled, "cancelled");
    std::this_thread::sleep_for(backoff.next());
  }
}

/// What a bundle has another one of; empty if both make the same frames.
std::string difference(const v1::ModelDescription& before, const v1::ModelDescription& now) {
  using google::protobuf::util::MessageDifferencer;
  if (!MessageDifferencer::Equals(now.representation(), before.representation())) return "representation";
  if (now.topology_hash() != before.topology_hash()) return "mesh";
  if (now.architecture() != before.architecture() || now.parameters() != before.parameters()) return "architecture";
  if (now.metadata_json() != before.metadata_json() || now.git_revision() != before.git_revision()) return "training";
  return {};
}

}  // namespace

v1::ConversionSetup conversion_setup(const PipelineSession& session) {
  v1::ConversionSetup setup;
  *setup.mutable_coarse() = session.network_coarse.value_or(session.coarse);
  *setup.mutable_representation() = session.representation;
  return setup;
}

void check_fine_hash(const std::string& hash, const std::string& expected) {
  if (!hash.empty() && hash != expected) {
    throw_internal("subdivides the coarse mesh in another way: " + hash + ", expected " + expected);
  }
}

std::vector<std::string> split_addresses(const std::string& service, const std::string& list) {
  std::vector<std::string> addresses;
  std::size_t begin = 0;
  while (begin <= list.size()) {
    const std::size_t end = std::min(list.find(',', begin), list.size());
    if (end > begin) addresses.push_back(list.substr(begin, end - begin));
    begin = end + 1;
  }
  if (addresses.empty()) throw_invalid_argument("--" + service + ": no address");
  return addresses;
}

std::int64_t admit(std::int64_t coarse_vertices, int rounds, std::int64_t max_vertices, const std::string& what) {
  if (rounds > kMaxSubdivisionRounds) {
    throw_invalid_argument(what + ": " + std::to_string(rounds) + " subdivisions, at most " +
                           std::to_string(kMaxSubdivisionRounds));
  }
  const double fine = static_cast<double>(coarse_vertices) * std::pow(4.0, rounds);
  if (fine <= static_cast<double>(max_vertices)) return static_cast<std::int64_t>(fine);
  throw Error(ErrorCode::kResourceExhausted,
              what + ": " + std::to_string(coarse_vertices) + " vertices, subdivided " + std::to_string(rounds) +
                  " times about " + std::to_string(static_cast<std::int64_t>(fine)) +
                  ", more than this coordinator's limit of " + std::to_string(max_vertices));
}

v1::ModelDescription describe_model(const ServiceAddresses& addresses, const LinkOptions& link, const std::string& name,
                                    const std::function<bool()>& cancelled) {
  v1::ModelDescription model = ask<v1::ModelDescription>(
      "superres", addresses.superres, link, cancelled, [&](const auto& channel, auto* context, auto* response) {
        v1::DescribeModelRequest request;
        request.set_model(name);
        return v1::SuperResolution::NewStub(channel)->DescribeModel(context, request, response);
      });
  if (!model.has_representation()) throw_internal("superres: bundle " + model.model() + " without a representation");
  return model;
}

std::optional<v1::Topology> coarse_for_network(const v1::ModelDescription& model, const Topology& coarse) {
  const std::string hash = topology_hash(coarse), &known_hash = model.topology_hash();
  if (known_hash.empty() || known_hash == hash) return std::nullopt;
  std::string elsewhere;
  if (const auto& rest = model.rest_positions(); rest.size() == coarse.rest_positions.size() && !rest.empty()) {
    Topology known = coarse;
    known.rest_positions = Eigen::Map<const Positions>(rest.data(), coarse.vertex_count(), 3);
    if (topology_hash(known) == known_hash) {
      const RigidTransform motion = kabsch(coarse.rest_positions, known.rest_positions);
      const Positions moved =
          (coarse.rest_positions * motion.rotation.transpose()).rowwise() + motion.translation.transpose();
      const float off = (moved - known.rest_positions).rowwise().norm().maxCoeff();
      const float extent =
          (known.rest_positions.colwise().maxCoeff() - known.rest_positions.colwise().minCoeff()).norm();
      if (off <= kSamePlace * extent) return to_message(known);
      elsewhere = "; at rest it has another shape, by up to " + std::to_string(off * 1e3F) + " mm";
    }
  }
  throw Error(ErrorCode::kFailedPrecondition, "bundle " + model.model() + " was trained for another mesh (" +
                                                  known_hash + ", this one is " + hash + elsewhere + ")");
}

v1::Representation representation_of(const v1::Scene& scene, v1::Detail detail, const v1::ModelDescription& model) {
  v1::Representation representation = model.representation();
  if (scene.has_subdivision_rounds()) representation.set_subdivision_rounds(scene.subdivision_rounds());
  // A scene cannot ask for the middle where a bundle has Loop's rule: that is what it says when it says nothing.
  if (scene.subdivision_rule() != v1::SUBDIVISION_RULE_MIDPOINT) {
    representation.set_subdivision_rule(scene.subdivision_rule());
  }
  if (detail == v1::DETAIL_COARSE) representation.set_subdivision_rounds(0);
  return representation;
}

v1::ModelDescription without_model() {
  v1::ModelDescription description;
  description.set_device("cpu");
  description.set_precision("float32");
  return description;
}

v1::ConversionOpened describe_conversion(const ServiceAddresses& addresses, const LinkOptions& link,
                                         const PipelineSession& session, const std::function<bool()>& cancelled) {
  const v1::ConversionSetup setup = conversion_setup(session);
  return ask<v1::ConversionOpened>("conversion", addresses.conversion, link, cancelled,
                                   [&](const auto& channel, auto* context, auto* response) {
                                     return v1::Conversion::NewStub(channel)->Describe(context, setup, response);
                                   });
}

Subdivision subdivision_of(const PipelineSession& session, const Topology& coarse,
                           const std::function<void()>& meanwhile) {
  auto made =
      std::async([&coarse, spec = subdivision_from(session.representation)] { return subdivide(coarse, spec); });
  if (meanwhile) meanwhile();
  Subdivision subdivision = made.get();
  const std::string& described = session.conversion.fine().hash();
  if (!session.network_coarse || described.empty()) {
    check_fine_hash(described, topology_hash(subdivision.fine));
  } else {
    const Topology known = from_message(*session.network_coarse, "the bundle's coarse mesh");
    check_fine_hash(described, topology_hash(subdivide(known, subdivision_from(session.representation)).fine));
  }
  return subdivision;
}

void require_same_bundle(const v1::ModelDescription& before, const v1::ModelDescription& now) {
  const std::string other = difference(before, now);
  if (other.empty()) return;
  throw Error(ErrorCode::kFailedPrecondition,
              "bundle " + before.model() + " was replaced meanwhile by one with another " + other + "; begin anew");
}

}  // namespace pleat::coordinator
