// Fuzzing with protobuf messages: an input is a sequence of them, and mutations change fields instead of bytes, so that
// most inputs get past the parser and into the code behind it.
#pragma once

#include <google/protobuf/message.h>
#include <google/protobuf/stubs/logging.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "common/base/error.hpp"

namespace pleat::fuzz {

inline constexpr std::size_t kMaxMessages = 6;

/// An input: messages one after the other, each with its length before it (4 bytes, little-endian). What is cut off or
/// can't be parsed ends the sequence.
template <typename Request>
std::vector<Request> read_messages(const std::uint8_t* data, std::size_t size) {
  // Protobuf reports strings that are not UTF-8 on stderr.
  [[maybe_unused]] static auto* const reporter = google::protobuf::SetLogHandler(nullptr);
  std::vector<Request> messages;
  while (size >= 4 && messages.size() < kMaxMessages) {
    std::uint32_t length = 0;
    for (unsigned i = 0; i < 4; ++i) length |= static_cast<std::uint32_t>(data[i]) << (8 * i);
    if (length > size - 4) break;
    Request message;
    if (!message.ParseFromArray(data + 4, static_cast<int>(length))) break;
    messages.push_back(std::move(message));
    data += 4 + length;
    size -= 4 + length;
  }
  return messages;
}

template <typename Request>
std::string write_messages(const std::vector<Request>& messages) {
  std::string out;
  for (const Request& message : messages) {
    const std::string bytes = message.SerializeAsString();
    for (unsigned i = 0; i < 4; ++i) out.push_back(static_cast<char>((bytes.size() >> (8 * i)) & 0xff));
    out += bytes;
  }
  return out;
}

/// Changes one field of a message, somewhere in its depth.
class FieldMutator {
 public:
  explicit FieldMutator(unsigned seed) : random_(seed) {}

  void mutate(google::protobuf::Message& message) {
    places_.clear();
    collect(message, 0);
    if (places_.empty()) return;
    const auto [owner, field] = places_[below(places_.size())];
    change(*owner, *field);
  }

  std::size_t below(std::size_t limit) { return std::uniform_int_distribution<std::size_t>(0, limit - 1)(random_); }

 private:
  using Message = google::protobuf::Message;
  using Field = google::protobuf::FieldDescriptor;
  static constexpr int kMaxDepth = 6, kMaxElements = 4000;

  void collect(Message& message, int depth) {
    const auto* reflection = message.GetReflection();
    for (int i = 0; i < message.GetDescriptor()->field_count(); ++i) {
      const Field* field = message.GetDescriptor()->field(i);
      places_.emplace_back(&message, field);
      if (field->cpp_type() != Field::CPPTYPE_MESSAGE || depth == kMaxDepth) continue;
      if (field->is_repeated()) {
        for (int k = 0; k < reflection->FieldSize(message, field); ++k) {
          collect(*reflection->MutableRepeatedMessage(&message, field, k), depth + 1);
        }
      } else if (reflection->HasField(message, field)) {
        collect(*reflection->MutableMessage(&message, field), depth + 1);
      }
    }
  }

  double number(double old) {
    static constexpr double kSpecial[] = {0,     -0.0,  1,    -1,   0.5,  2,     1e-3,  1e-6,
                                          1e-30, 1e-40, 1e10, 1e30, 3e38, -3e38, 1e300, 4294967295.0};
    switch (below(6)) {
      case 0:
        return kSpecial[below(std::size(kSpecial))];
      case 1:
        return below(2) == 0 ? std::numeric_limits<double>::quiet_NaN() : std::numeric_limits<double>::infinity();
      case 2:
        return -old;
      case 3:
        return old * (1 + 1e-7 * static_cast<double>(below(5)));
      default:
        return old + std::normal_distribution<double>(0, below(2) == 0 ? 0.01 : 1)(random_);
    }
  }

  std::uint64_t whole(std::uint64_t old) {
    switch (below(5)) {
      case 0:
        return below(70);
      case 1:
        return old + 1;
      case 2:
        return old - 1;
      case 3:
        return below(2) == 0 ? 0xffffffffu : 1u << below(32);
      default:
        return old ^ (1ull << below(32));
    }
  }

  // Bytes are mostly something packed (numbers, a check-point), whose reader wants to be reached.
  std::string text(const Field& field, std::string old) {
    if (field.type() != Field::TYPE_BYTES || old.empty() || below(8) == 0) return std::string(below(20), 'a');
    if (below(6) == 0) {
      old.resize(below(old.size()));
    } else {
      for (std::size_t i = 1 + below(4); i > 0; --i) old[below(old.size())] ^= static_cast<char>(1 << below(8));
    }
    return old;
  }

  void change(Message& owner, const Field& field) {
    if (below(12) == 0) {
      owner.GetReflection()->ClearField(&owner, &field);
    } else if (field.is_repeated()) {
      change_repeated(owner, field);
    } else {
      change_one(owner, field);
    }
  }

  void change_one(Message& owner, const Field& field) {
    const auto* r = owner.GetReflection();
    switch (field.cpp_type()) {
      case Field::CPPTYPE_FLOAT:
        return r->SetFloat(&owner, &field, static_cast<float>(number(static_cast<double>(r->GetFloat(owner, &field)))));
      case Field::CPPTYPE_DOUBLE:
        return r->SetDouble(&owner, &field, number(r->GetDouble(owner, &field)));
      case Field::CPPTYPE_UINT32:
        return r->SetUInt32(&owner, &field, static_cast<std::uint32_t>(whole(r->GetUInt32(owner, &field))));
      case Field::CPPTYPE_UINT64:
        return r->SetUInt64(&owner, &field, whole(r->GetUInt64(owner, &field)));
      case Field::CPPTYPE_BOOL:
        return r->SetBool(&owner, &field, !r->GetBool(owner, &field));
      case Field::CPPTYPE_ENUM:
        return r->SetEnumValue(&owner, &field, static_cast<int>(below(5)));
      case Field::CPPTYPE_STRING:
        return r->SetString(&owner, &field, text(field, r->GetString(owner, &field)));
      case Field::CPPTYPE_MESSAGE:
        r->MutableMessage(&owner, &field);
        return;
      default:
        return;
    }
  }

  void change_repeated(Message& owner, const Field& field) {
    const auto* r = owner.GetReflection();
    const int size = r->FieldSize(owner, &field);
    const std::size_t action = below(10);
    if (size > 1 && action == 0) {
      r->SwapElements(&owner, &field, static_cast<int>(below(static_cast<std::size_t>(size))),
                      static_cast<int>(below(static_cast<std::size_t>(size))));
    } else if (size > 0 && action == 1) {
      for (std::size_t i = 1 + below(3); i > 0 && r->FieldSize(owner, &field) > 0; --i) r->RemoveLast(&owner, &field);
    } else if (size < kMaxElements && (size == 0 || action == 2)) {
      add(owner, field);
    } else if (size > 0) {
      // One element, or a run of them.
      const int first = static_cast<int>(below(static_cast<std::size_t>(size)));
      const int last = std::min<int>(size, first + (action > 7 ? static_cast<int>(1 + below(40)) : 1));
      for (int i = first; i < last; ++i) change_element(owner, field, i);
    }
  }

  void add(Message& owner, const Field& field) {
    const auto* r = owner.GetReflection();
    switch (field.cpp_type()) {
      case Field::CPPTYPE_FLOAT:
        return r->AddFloat(&owner, &field, static_cast<float>(number(0)));
      case Field::CPPTYPE_UINT32:
        return r->AddUInt32(&owner, &field, static_cast<std::uint32_t>(whole(0)));
      case Field::CPPTYPE_STRING:
        return r->AddString(&owner, &field, "a");
      case Field::CPPTYPE_MESSAGE:
        r->AddMessage(&owner, &field);
        return;
      default:
        return;
    }
  }

  void change_element(Message& owner, const Field& field, int i) {
    const auto* r = owner.GetReflection();
    switch (field.cpp_type()) {
      case Field::CPPTYPE_FLOAT:
        return r->SetRepeatedFloat(
            &owner, &field, i, static_cast<float>(number(static_cast<double>(r->GetRepeatedFloat(owner, &field, i)))));
      case Field::CPPTYPE_UINT32:
        return r->SetRepeatedUInt32(&owner, &field, i,
                                    static_cast<std::uint32_t>(whole(r->GetRepeatedUInt32(owner, &field, i))));
      default:
        return;
    }
  }

  std::mt19937 random_;
  std::vector<std::pair<Message*, const Field*>> places_;
};

/// One mutation of an input; empty if it does not fit into max_size.
template <typename Request>
std::string mutated(const std::uint8_t* data, std::size_t size, std::size_t max_size, unsigned seed) {
  std::vector<Request> messages = read_messages<Request>(data, size);
  if (messages.empty()) messages.emplace_back();
  FieldMutator mutator(seed);
  const std::size_t chosen = mutator.below(messages.size());
  switch (mutator.below(16)) {
    case 0:
      if (messages.size() < kMaxMessages) messages.push_back(messages[chosen]);
      break;
    case 1:
      if (messages.size() > 1) messages.erase(messages.begin() + static_cast<std::ptrdiff_t>(chosen));
      break;
    default:
      for (std::size_t i = 1 + mutator.below(3); i > 0; --i) mutator.mutate(messages[chosen]);
  }
  const std::string bytes = write_messages(messages);
  return bytes.size() <= max_size ? bytes : std::string();
}

/// A session as a service runs it: serve(open, for_frames) opens it with the first message and calls
/// for_frames(process), which calls process(message) or process(frame) for the others. An Error is an answer: to `open`
/// it ends the session, to a frame it does not.
template <typename Request, typename Serve>
void run_session(const std::vector<Request>& messages, const Serve& serve) {
  if (messages.empty()) return;
  const auto for_frames = [&](const auto& process) {
    for (std::size_t i = 1; i < messages.size(); ++i) {
      try {
        if constexpr (std::is_invocable_v<decltype(process), const Request&>) {
          process(messages[i]);
        } else {
          process(messages[i].frame());
        }
      } catch (const Error&) {
      }
    }
  };
  try {
    serve(messages[0].open(), for_frames);
  } catch (const Error&) {
  }
}

}  // namespace pleat::fuzz

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size);

/// The two functions that libFuzzer calls, for inputs of this request type, handled by run(messages).
#define PLEAT_MESSAGE_FUZZER(Request, run)                                                                    \
  extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {                         \
    run(pleat::fuzz::read_messages<Request>(data, size));                                                     \
    return 0;                                                                                                 \
  }                                                                                                           \
  extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,  \
                                                 unsigned seed) {                                             \
    const std::string bytes = seed % 8 == 0 ? "" : pleat::fuzz::mutated<Request>(data, size, max_size, seed); \
    if (bytes.empty()) return LLVMFuzzerMutate(data, size, max_size);                                         \
    std::memcpy(data, bytes.data(), bytes.size());                                                            \
    return bytes.size();                                                                                      \
  }
