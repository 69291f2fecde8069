#include "tests/proto/schema_comparison.hpp"

#include <map>

namespace pleat::testing {
namespace {

using google::protobuf::DescriptorProto;
using google::protobuf::EnumDescriptorProto;
using google::protobuf::FieldDescriptorProto;
using google::protobuf::FileDescriptorSet;
using google::protobuf::MethodDescriptorProto;
using google::protobuf::ServiceDescriptorProto;

/// All definitions of a set by their full names.
struct Schema {
  std::map<std::string, const DescriptorProto*> messages;
  std::map<std::string, const EnumDescriptorProto*> enums;
  std::map<std::string, const ServiceDescriptorProto*> services;

  explicit Schema(const FileDescriptorSet& set) {
    for (const auto& file : set.file()) {
      const std::string package = file.package() + ".";
      for (const auto& message : file.message_type()) add(package, message);
      for (const auto& definition : file.enum_type()) enums[package + definition.name()] = &definition;
      for (const auto& service : file.service()) services[package + service.name()] = &service;
    }
  }

 private:
  void add(const std::string& scope, const DescriptorProto& message) {
    const std::string name = scope + message.name();
    messages[name] = &message;
    for (const auto& nested : message.nested_type()) add(name + ".", nested);
    for (const auto& definition : message.enum_type()) enums[name + "." + definition.name()] = &definition;
  }
};

template <typename Items>
auto find_named(const Items& items, const std::string& name) -> decltype(&*items.begin()) {
  for (const auto& item : items) {
    if (item.name() == name) return &item;
  }
  return nullptr;
}

std::string oneof_of(const DescriptorProto& message, const FieldDescriptorProto& field) {
  return field.has_oneof_index() && !field.proto3_optional() ? message.oneof_decl(field.oneof_index()).name() : "";
}

class Comparison {
 public:
  std::vector<std::string> breaks;

  void compare(const DescriptorProto& older, const DescriptorProto& newer, const std::string& name) {
    for (const auto& old_field : older.field()) {
      const std::string field_name = name + "." + old_field.name();
      const FieldDescriptorProto* field = find_named(newer.field(), old_field.name());
      if (field == nullptr) {
        report(field_name, "was removed or renamed");
        continue;
      }
      check(field_name, "number", old_field.number(), field->number());
      check(field_name, "type", FieldDescriptorProto::Type_Name(old_field.type()),
            FieldDescriptorProto::Type_Name(field->type()));
      check(field_name, "message or enum", old_field.type_name(), field->type_name());
      check(field_name, "label", FieldDescriptorProto::Label_Name(old_field.label()),
            FieldDescriptorProto::Label_Name(field->label()));
      check(field_name, "presence", old_field.proto3_optional(), field->proto3_optional());
      check(field_name, "oneof", oneof_of(older, old_field), oneof_of(newer, *field));
      check(field_name, "JSON name", old_field.json_name(), field->json_name());
    }
    for (const auto& range : older.reserved_range()) {
      for (const auto& field : newer.field()) {
        if (field.number() >= range.start() && field.number() < range.end()) {
          report(name + "." + field.name(), "uses the reserved number " + std::to_string(field.number()));
        }
      }
    }
    for (const auto& reserved : older.reserved_name()) {
      if (find_named(newer.field(), reserved) != nullptr) report(name + "." + reserved, "uses a reserved name");
    }
  }

  void compare(const EnumDescriptorProto& older, const EnumDescriptorProto& newer, const std::string& name) {
    for (const auto& old_value : older.value()) {
      const auto* value = find_named(newer.value(), old_value.name());
      if (value == nullptr) {
        report(name + "." + old_value.name(), "was removed or renamed");
      } else {
        check(name + "." + old_value.name(), "number", old_value.number(), value->number());
      }
    }
  }

  void compare(const ServiceDescriptorProto& older, const ServiceDescriptorProto& newer, const std::string& name) {
    for (const auto& old_method : older.method()) {
      const std::string method_name = name + "." + old_method.name();
      const MethodDescriptorProto* method = find_named(newer.method(), old_method.name());
      if (method == nullptr) {
        report(method_name, "was removed or renamed");
        continue;
      }
      check(method_name, "request", old_method.input_type(), method->input_type());
      check(method_name, "response", old_method.output_type(), method->output_type());
      check(method_name, "client streaming", old_method.client_streaming(), method->client_streaming());
      check(method_name, "server streaming", old_method.server_streaming(), method->server_streaming());
    }
  }

  template <typename Definitions>
  void compare_all(const Definitions& older, const Definitions& newer) {
    for (const auto& [name, definition] : older) {
      const auto found = newer.find(name);
      if (found == newer.end()) {
        report(name, "was removed or renamed");
      } else {
        compare(*definition, *found->second, name);
      }
    }
  }

 private:
  void report(const std::string& name, const std::string& what) { breaks.push_back(name + " " + what); }

  static std::string text(const std::string& value) { return "'" + value + "'"; }
  static std::string text(bool value) { return value ? "yes" : "no"; }
  static std::string text(int value) { return std::to_string(value); }

  template <typename Value>
  void check(const std::string& name, const std::string& property, const Value& older, const Value& newer) {
    if (older != newer) report(name, "changed its " + property + " from " + text(older) + " to " + text(newer));
  }
};

}  // namespace

std::vector<std::string> breaking_changes(const FileDescriptorSet& older, const FileDescriptorSet& newer) {
  const Schema before(older), after(newer);
  Comparison comparison;
  comparison.compare_all(before.messages, after.messages);
  comparison.compare_all(before.enums, after.enums);
  comparison.compare_all(before.services, after.services);
  return comparison.breaks;
}

}  // namespace pleat::testing
