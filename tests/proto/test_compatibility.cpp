#include <google/protobuf/descriptor.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <functional>

#include "pleat/v1/coordinator.pb.h"
#include "pleat/v1/fold.pb.h"
#include "pleat/v1/refinement.pb.h"
#include "pleat/v1/simulation.pb.h"
#include "pleat/v1/superres.pb.h"
#include "tests/proto/schema_comparison.hpp"

namespace pleat::testing {
namespace {

using google::protobuf::DescriptorProto;
using google::protobuf::FieldDescriptorProto;
using google::protobuf::FileDescriptorProto;
using google::protobuf::FileDescriptorSet;

std::string committed_path() {
  const char* source = std::getenv("PLEAT_SOURCE_DIR");
  return std::string(source != nullptr ? source : ".") + "/proto/pleat/v1/descriptor.binpb";
}

FileDescriptorSet committed() {
  std::ifstream in(committed_path(), std::ios::binary);
  FileDescriptorSet set;
  EXPECT_TRUE(set.ParseFromIstream(&in)) << committed_path();
  return set;
}

/// What this build was compiled with.
FileDescriptorSet current() {
  FileDescriptorSet set;
  for (const auto* file :
       {v1::Topology::descriptor()->file(), v1::Scene::descriptor()->file(), v1::SimulateOpen::descriptor()->file(),
        v1::ConversionSetup::descriptor()->file(), v1::UpscaleOpen::descriptor()->file(),
        v1::FoldOpen::descriptor()->file(), v1::RefineOpen::descriptor()->file(), v1::Job::descriptor()->file()}) {
    file->CopyTo(set.add_file());
    file->CopyJsonNameTo(&set.mutable_file()->at(set.file_size() - 1));
  }
  return set;
}

DescriptorProto* message(FileDescriptorSet& set, const std::string& name) {
  for (auto& file : *set.mutable_file()) {
    for (auto& candidate : *file.mutable_message_type()) {
      if (candidate.name() == name) return &candidate;
    }
  }
  return nullptr;
}

FieldDescriptorProto* field(FileDescriptorSet& set, const std::string& message_name, const std::string& name) {
  DescriptorProto* owner = message(set, message_name);
  for (auto& candidate : *owner->mutable_field()) {
    if (candidate.name() == name) return &candidate;
  }
  return nullptr;
}

TEST(ProtoCompatibility, TheSchemaKeepsWhatClientsWereBuiltWith) {
  const auto breaks = breaking_changes(committed(), current());
  for (const std::string& line : breaks) ADD_FAILURE() << line;
}

TEST(ProtoCompatibility, TheCommittedDescriptorIsWhole) {
  EXPECT_GE(committed().file_size(), 8) << "renew it with `make proto-descriptor`";
  EXPECT_TRUE(breaking_changes(committed(), committed()).empty());
}

TEST(ProtoCompatibility, AddingIsAllowed) {
  FileDescriptorSet newer = current();
  FieldDescriptorProto* added = message(newer, "Frame")->add_field();
  added->set_name("brand_new");
  added->set_number(99);
  added->set_type(FieldDescriptorProto::TYPE_FLOAT);
  newer.mutable_file(0)->add_message_type()->set_name("BrandNew");
  EXPECT_TRUE(breaking_changes(current(), newer).empty());
}

/// A change that must be found, and the words that must name it.
struct Break {
  std::string name;
  std::function<void(FileDescriptorSet&)> apply;
  std::string expected;
};

class ProtoBreak : public ::testing::TestWithParam<Break> {};

TEST_P(ProtoBreak, IsFoundAndNamed) {
  FileDescriptorSet newer = current();
  GetParam().apply(newer);
  const auto breaks = breaking_changes(current(), newer);
  ASSERT_FALSE(breaks.empty());
  EXPECT_TRUE(std::any_of(breaks.begin(), breaks.end(), [&](const std::string& line) {
    return line.find(GetParam().expected) != std::string::npos;
  })) << breaks.front();
}

FileDescriptorProto* file_with_service(FileDescriptorSet& set, const std::string& name) {
  for (auto& file : *set.mutable_file()) {
    if (file.service_size() > 0 && file.service(0).name() == name) return &file;
  }
  return nullptr;
}

INSTANTIATE_TEST_SUITE_P(
    All, ProtoBreak,
    ::testing::Values(
        Break{"FieldRemoved", [](auto& set) { message(set, "Frame")->mutable_field()->DeleteSubrange(2, 1); },
              "pleat.v1.Frame.positions was removed"},
        Break{"FieldRenamed", [](auto& set) { field(set, "Frame", "time_s")->set_name("time"); },
              "pleat.v1.Frame.time_s was removed or renamed"},
        Break{"NumberChanged", [](auto& set) { field(set, "Frame", "time_s")->set_number(12); },
              "pleat.v1.Frame.time_s changed its number from 2 to 12"},
        Break{"TypeChanged",
              [](auto& set) { field(set, "Frame", "time_s")->set_type(FieldDescriptorProto::TYPE_FLOAT); },
              "pleat.v1.Frame.time_s changed its type from 'TYPE_DOUBLE' to 'TYPE_FLOAT'"},
        Break{"MessageTypeChanged",
              [](auto& set) { field(set, "MeshFrame", "fine")->set_type_name(".pleat.v1.Tensor"); },
              "pleat.v1.MeshFrame.fine changed its message or enum"},
        Break{"LabelChanged",
              [](auto& set) { field(set, "Frame", "positions")->set_label(FieldDescriptorProto::LABEL_OPTIONAL); },
              "pleat.v1.Frame.positions changed its label"},
        Break{"PresenceChanged", [](auto& set) { field(set, "RefineOpen", "clearance_m")->set_proto3_optional(false); },
              "pleat.v1.RefineOpen.clearance_m changed its presence"},
        Break{"LeftItsOneof", [](auto& set) { field(set, "RefineRequest", "frame")->clear_oneof_index(); },
              "pleat.v1.RefineRequest.frame changed its oneof"},
        Break{"JsonNameChanged", [](auto& set) { field(set, "Scene", "frame_time_s")->set_json_name("dt"); },
              "pleat.v1.Scene.frame_time_s changed its JSON name"},
        Break{"EnumValueRenumbered",
              [](auto& set) { message(set, "Job")->mutable_enum_type(0)->mutable_value(4)->set_number(40); },
              "pleat.v1.Job.State.STATE_DONE changed its number"},
        Break{"EnumValueRemoved",
              [](auto& set) { message(set, "Job")->mutable_enum_type(0)->mutable_value()->RemoveLast(); },
              "pleat.v1.Job.State.STATE_CANCELLED was removed"},
        Break{"MessageRemoved", [](auto& set) { message(set, "FrameError")->set_name("Failure"); },
              "pleat.v1.FrameError was removed or renamed"},
        Break{"MethodRemoved",
              [](auto& set) {
                file_with_service(set, "Coordinator")->mutable_service(0)->mutable_method()->RemoveLast();
              },
              "pleat.v1.Coordinator.Enhance was removed"},
        Break{
            "MethodNoLongerStreams",
            [](auto& set) {
              file_with_service(set, "Refinement")->mutable_service(0)->mutable_method(0)->set_client_streaming(false);
            },
            "pleat.v1.Refinement.Refine changed its client streaming"},
        Break{"ServiceRemoved", [](auto& set) { file_with_service(set, "Conversion")->clear_service(); },
              "pleat.v1.Conversion was removed"}),
    [](const auto& test) { return test.param.name; });

TEST(ProtoCompatibility, ReservedThingsStayUnused) {
  FileDescriptorSet older = current();
  auto* range = message(older, "Frame")->add_reserved_range();
  range->set_start(9);
  range->set_end(10);
  message(older, "Frame")->add_reserved_name("old_name");
  FileDescriptorSet newer = current();
  for (const auto& [name, number] : {std::pair{"revived", 9}, std::pair{"old_name", 20}}) {
    FieldDescriptorProto* added = message(newer, "Frame")->add_field();
    added->set_name(name);
    added->set_number(number);
    added->set_type(FieldDescriptorProto::TYPE_FLOAT);
  }
  EXPECT_EQ(breaking_changes(older, newer).size(), 2U);
}

}  // namespace
}  // namespace pleat::testing
