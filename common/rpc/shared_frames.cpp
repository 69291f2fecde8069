#include "common/rpc/shared_frames.hpp"

#include <fcntl.h>
#include <linux/futex.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <bit>
#include <charconv>
#include <cstring>
#include <limits>
#include <optional>
#include <vector>

#include "common/rpc/channel.hpp"

namespace pleat::rpc {
namespace {

constexpr std::uint32_t kMaxSlots = 64;
constexpr std::size_t kSlotBytes = kMaxMessageBytes;
constexpr std::size_t kLayoutBytes = 4096;
constexpr int kSeals = F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL;

/// One more than the window: its frames, and a message that is none.
std::uint32_t slots_of(std::uint32_t window) { return std::min(window + 1, kMaxSlots); }

/// Pages that nobody has written to take no memory.
std::size_t bytes_of(std::uint32_t slots) { return kLayoutBytes + 2 * std::size_t{slots} * kSlotBytes; }

/// Whether this process may have a file of that size; to make one that is larger ends it.
bool may_be_as_large(std::size_t bytes) {
  rlimit limit{};
  return ::getrlimit(RLIMIT_FSIZE, &limit) == 0 && (limit.rlim_cur == RLIM_INFINITY || bytes <= limit.rlim_cur);
}

void* map(int descriptor, std::size_t bytes) {
  void* const memory = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_NORESERVE, descriptor, 0);
  if (memory == MAP_FAILED) return nullptr;
  ::madvise(memory, bytes, MADV_DONTDUMP);
  return memory;
}

std::string hexadecimal(const std::array<std::uint64_t, 2>& token) {
  std::string text;
  for (const std::uint64_t half : token) {
    for (int shift = 60; shift >= 0; shift -= 4) text += "0123456789abcdef"[half >> shift & 15];
  }
  return text;
}

struct Ticket {
  pid_t process = 0;
  int descriptor = -1;
  std::string_view token;
};

/// A thread that sleeps, for those who may wake it up: 0 for none, or its id and these marks.
using Place = std::atomic<std::uint64_t>;
constexpr std::uint64_t kMoving = 1, kMoved = 2;
constexpr int kMarkBits = 2;

/// Whether nothing more waited where this thread received last: it sleeps soon.
thread_local bool sleeps_soon = false;

std::uint64_t own_id() {
  thread_local const auto id = static_cast<std::uint64_t>(::syscall(SYS_gettid));
  return id;
}

/// Where this thread may run, and back to that at the end if it was changed.
class Processors {
 public:
  Processors() : known_(::sched_getaffinity(0, sizeof(allowed_), &allowed_) == 0) {}

  bool several() const { return known_ && CPU_COUNT(&allowed_) > 1; }
  void restore() const { ::sched_setaffinity(0, sizeof(allowed_), &allowed_); }

 private:
  cpu_set_t allowed_{};
  bool known_;
};

/// While it lives, this thread may be brought to another processor; afterwards it runs where it could before.
class Sleeping {
 public:
  explicit Sleeping(Place& place) : place_(place) {
    if (processors_.several()) place_.store(own_id() << kMarkBits);
  }
  ~Sleeping() {
    if (!processors_.several()) return;
    // Who moves us is through in a moment, or has been killed.
    const auto patience = std::chrono::steady_clock::now() + std::chrono::milliseconds(1);
    while ((place_.load() & kMoving) != 0 && std::chrono::steady_clock::now() < patience) {
    }
    if (place_.exchange(0) != own_id() << kMarkBits) processors_.restore();
  }
  Sleeping(const Sleeping&) = delete;
  Sleeping& operator=(const Sleeping&) = delete;

 private:
  Place& place_;
  const Processors processors_;
};

/// While it lives, a thread of a real-time class stays where it is; it would make way for one that can't go elsewhere.
class Staying {
 public:
  explicit Staying(const cpu_set_t& here) {
    thread_local const int policy = ::sched_getscheduler(0);
    if (policy != SCHED_FIFO && policy != SCHED_RR) return;
    if (!before_.emplace().several() || ::sched_setaffinity(0, sizeof(here), &here) != 0) before_.reset();
  }
  ~Staying() {
    if (before_) before_->restore();
  }
  Staying(const Staying&) = delete;
  Staying& operator=(const Staying&) = delete;

 private:
  std::optional<Processors> before_;
};

/// Brings who sleeps there to this processor.
void bring(Place& place, const cpu_set_t& here) {
  std::uint64_t sleeper = place.load();
  if (sleeper == 0 || (sleeper & (kMoving | kMoved)) != 0) return;
  if (!place.compare_exchange_strong(sleeper, sleeper | kMoving)) return;
  ::sched_setaffinity(static_cast<pid_t>(sleeper >> kMarkBits), sizeof(here), &here);
  std::uint64_t moving = sleeper | kMoving;
  place.compare_exchange_strong(moving, sleeper | kMoved);
}

/// Wakes up who sleeps there, on the processor that this thread is about to leave: to wake it up on another one takes
/// an interrupt there, and the frame is in this one's caches.
template <typename Wake>
void wake_here(Place& place, const Wake& wake) {
  const int processor = ::sched_getcpu();
  if (processor < 0 || processor >= CPU_SETSIZE) return wake();
  cpu_set_t here;
  CPU_ZERO(&here);
  CPU_SET(processor, &here);
  const Staying staying(here);
  bring(place, here);
  wake();
}

std::optional<Ticket> parse(std::string_view text) {
  Ticket ticket;
  const char* const end = text.data() + text.size();
  const auto process = std::from_chars(text.data(), end, ticket.process);
  if (process.ec != std::errc() || process.ptr == end || *process.ptr != ' ') return std::nullopt;
  const auto descriptor = std::from_chars(process.ptr + 1, end, ticket.descriptor);
  if (descriptor.ec != std::errc() || descriptor.ptr == end || *descriptor.ptr != ' ') return std::nullopt;
  ticket.token = text.substr(static_cast<std::size_t>(descriptor.ptr + 1 - text.data()));
  return ticket;
}

}  // namespace

/// One direction, at the beginning of the memory. Who sends writes `sent`, `entries` and sets bits of `taken`; who
/// receives writes `received` and clears them.
struct SharedFrames::Lane {
  struct Entry {
    std::uint32_t slot = 0;
    std::uint32_t bytes = 0;
  };
  std::atomic<std::uint32_t> rings{0};  ///< of who receives
  std::atomic<std::uint32_t> closed{0};
  Place sleeper{0};  ///< who waits for the next ring
  alignas(64) std::atomic<std::uint32_t> sent{0};
  std::atomic<std::uint32_t> received{0};
  std::atomic<std::uint64_t> taken{0};  ///< a bit for each slot
  std::array<Entry, kMaxSlots> entries{};

  void ring() {
    rings.fetch_add(1);
    ::syscall(SYS_futex, &rings, FUTEX_WAKE, std::numeric_limits<int>::max(), nullptr, nullptr, 0);
  }
};

struct SharedFrames::Layout {
  std::array<std::uint64_t, 2> token{};
  std::array<Lane, 2> lanes;  ///< from the client, to the client
};

SharedFrames::SharedFrames(int descriptor, void* memory, std::size_t bytes, std::uint32_t slots, bool client)
    : descriptor_(descriptor), layout_(static_cast<Layout*>(memory)), bytes_(bytes), slots_(slots), client_(client) {}

std::unique_ptr<SharedFrames> SharedFrames::offer(std::uint32_t window) {
  static_assert(sizeof(Layout) <= kLayoutBytes);
  static_assert(std::atomic<std::uint32_t>::is_always_lock_free && std::atomic<std::uint64_t>::is_always_lock_free);
  const std::uint32_t slots = slots_of(window);
  const std::size_t bytes = bytes_of(slots);
  if (!may_be_as_large(bytes)) return nullptr;
  const int descriptor = ::memfd_create("pleat-frames", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  if (descriptor < 0) return nullptr;
  std::array<std::uint64_t, 2> token{};
  const bool sized = ::ftruncate(descriptor, static_cast<off_t>(bytes)) == 0 &&
                     ::fcntl(descriptor, F_ADD_SEALS, kSeals) == 0 &&
                     ::getrandom(token.data(), sizeof(token), 0) == static_cast<ssize_t>(sizeof(token));
  void* const memory = sized ? map(descriptor, bytes) : nullptr;
  if (memory == nullptr) {
    ::close(descriptor);
    return nullptr;
  }
  auto* const layout = new (memory) Layout;
  layout->token = token;
  std::unique_ptr<SharedFrames> frames(new SharedFrames(descriptor, memory, bytes, slots, true));
  frames->ticket_ = std::to_string(::getpid()) + " " + std::to_string(descriptor) + " " + hexadecimal(token);
  return frames;
}

std::unique_ptr<SharedFrames> SharedFrames::accept(std::string_view text, std::uint32_t window) {
  const std::optional<Ticket> ticket = parse(text);
  if (!ticket || ticket->process <= 0 || ticket->descriptor < 0) return nullptr;
  const std::string path = "/proc/" + std::to_string(ticket->process) + "/fd/" + std::to_string(ticket->descriptor);
  // The path may lead to anything that this user has open: what is no sealed memory is not touched.
  struct stat there {};
  if (::stat(path.c_str(), &there) != 0 || !S_ISREG(there.st_mode) || there.st_uid != ::geteuid()) return nullptr;
  const int descriptor = ::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
  if (descriptor < 0) return nullptr;
  const std::uint32_t slots = slots_of(window);
  const std::size_t bytes = bytes_of(slots);
  const int seals = ::fcntl(descriptor, F_GET_SEALS);
  const bool right = ::fstat(descriptor, &there) == 0 && S_ISREG(there.st_mode) && there.st_uid == ::geteuid() &&
                     there.st_size == static_cast<off_t>(bytes) && seals >= 0 && (seals & kSeals) == kSeals;
  void* const memory = right ? map(descriptor, bytes) : nullptr;
  ::close(descriptor);
  if (memory == nullptr) return nullptr;
  std::unique_ptr<SharedFrames> frames(new SharedFrames(-1, memory, bytes, slots, false));
  return hexadecimal(frames->layout_->token) == ticket->token ? std::move(frames) : nullptr;
}

SharedFrames::~SharedFrames() {
  withdraw();
  ::munmap(layout_, bytes_);
}

void SharedFrames::withdraw() {
  if (descriptor_ >= 0) ::close(descriptor_);
  descriptor_ = -1;
}

std::byte* SharedFrames::slot(std::uint32_t lane, std::uint32_t index) const {
  return reinterpret_cast<std::byte*>(layout_) + kLayoutBytes + (std::size_t{lane} * slots_ + index) * kSlotBytes;
}

SharedFrames::Lane& SharedFrames::out() const { return layout_->lanes[client_ ? 0 : 1]; }
SharedFrames::Lane& SharedFrames::in() const { return layout_->lanes[client_ ? 1 : 0]; }

bool SharedFrames::send(const google::protobuf::MessageLite& message) {
  Lane& lane = out();
  const std::size_t size = message.ByteSizeLong();
  // The lowest slot that is free: its pages are there already.
  const auto index = static_cast<std::uint32_t>(std::countr_one(lane.taken.load(std::memory_order_acquire)));
  if (size > kSlotBytes || index >= slots_) return false;
  message.SerializeWithCachedSizesToArray(reinterpret_cast<std::uint8_t*>(slot(client_ ? 0 : 1, index)));
  lane.taken.fetch_or(std::uint64_t{1} << index);
  const std::uint32_t count = lane.sent.load(std::memory_order_relaxed);
  lane.entries[count % kMaxSlots] = {index, static_cast<std::uint32_t>(size)};
  lane.sent.store(count + 1, std::memory_order_release);
  sleeps_soon ? wake_here(lane.sleeper, [&] { lane.ring(); }) : lane.ring();
  return true;
}

std::uint32_t SharedFrames::taken() const { return out().received.load(); }

std::uint32_t SharedFrames::on_their_way() const { return out().sent.load() - out().received.load(); }

void SharedFrames::close() {
  out().closed.store(1, std::memory_order_release);
  out().ring();
}

bool SharedFrames::available() const {
  return in().sent.load(std::memory_order_acquire) != in().received.load(std::memory_order_relaxed);
}

bool SharedFrames::receive(google::protobuf::MessageLite* message) {
  Lane& lane = in();
  const std::uint32_t count = lane.received.load(std::memory_order_relaxed);
  // The other side can write here at any time: what is checked is our copy.
  const Lane::Entry entry = lane.entries[count % kMaxSlots];
  const bool inside = entry.slot < slots_ && entry.bytes <= kSlotBytes;
  bool parsed = false;
  if (inside)
    parsed = message->ParseFromArray(slot(client_ ? 1 : 0, entry.slot), static_cast<int>(entry.bytes));
  else
    message->Clear();
  sleeps_soon = lane.sent.load(std::memory_order_relaxed) == count + 1;
  lane.received.store(count + 1, std::memory_order_release);
  if (inside) lane.taken.fetch_and(~(std::uint64_t{1} << entry.slot), std::memory_order_release);
  return parsed;
}

bool SharedFrames::closed() const { return in().closed.load(std::memory_order_acquire) != 0; }

std::uint32_t SharedFrames::rings() const { return in().rings.load(); }

bool SharedFrames::wait(std::uint32_t rings, std::chrono::steady_clock::time_point until) const {
  const auto since_epoch = until.time_since_epoch();
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(since_epoch);
  const timespec deadline{static_cast<time_t>(seconds.count()),
                          static_cast<long>(std::chrono::nanoseconds(since_epoch - seconds).count())};
  const Sleeping sleeping(in().sleeper);
  // steady_clock is CLOCK_MONOTONIC, which is what this operation counts by.
  ::syscall(SYS_futex, &in().rings, FUTEX_WAIT_BITSET, rings, &deadline, nullptr, FUTEX_BITSET_MATCH_ANY);
  return this->rings() != rings;
}

void SharedFrames::ring() { in().ring(); }

}  // namespace pleat::rpc
