#include "common/base/progress.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>

#include "common/base/terminal.hpp"

namespace pleat {
namespace {

constexpr int kBarWidth = 30;

}  // namespace

Progress::Progress(std::string label, std::uint64_t total)
    : label_(std::move(label)),
      total_(total),
      terminal_(::isatty(STDERR_FILENO) == 1),
      start_(std::chrono::steady_clock::now()) {}

Progress::~Progress() {
  if (terminal_ && shown_ && !finished_) std::fputc('\n', stderr);
}

void Progress::update(std::uint64_t done, const std::string& note) {
  done_ = done;
  const auto now = std::chrono::steady_clock::now();
  if (terminal_) {
    if (shown_ && now - last_shown_ < std::chrono::milliseconds(100)) return;
    last_shown_ = now;
  } else {
    if (done < next_line_ || done == 0) return;
    const std::uint64_t step = std::max<std::uint64_t>(1, total_ > 0 ? total_ / 10 : 100);
    next_line_ = (done / step + 1) * step;
    // The last line is finish's.
    if (total_ > 0 && done >= total_) return;
  }
  show(note, false);
}

void Progress::line(const std::string& text) {
  std::fprintf(stderr, "%s%s\n", terminal_ && shown_ ? "\r\033[K" : "", text.c_str());
}

void Progress::finish(const std::string& note) {
  if (finished_) return;
  show(note, true);
  finished_ = true;
}

void Progress::show(const std::string& note, bool last) {
  if (verbosity() == Verbosity::kQuiet) return;
  shown_ = true;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  const double rate = seconds > 0 ? static_cast<double>(done_) / seconds : 0;
  std::string counts = std::to_string(done_);
  if (total_ > 0) counts += "/" + std::to_string(total_);
  std::string tail;
  if (!note.empty()) tail.append("  ").append(note);
  if (!terminal_) {
    std::fprintf(stderr, "%s %s  %.1f/s%s\n", label_.c_str(), counts.c_str(), rate, tail.c_str());
    return;
  }
  std::string bar;
  if (total_ > 0) {
    const auto filled = static_cast<int>(std::min<std::uint64_t>(done_, total_) * kBarWidth / total_);
    bar = " [" + std::string(static_cast<std::size_t>(filled), '#') +
          std::string(static_cast<std::size_t>(kBarWidth - filled), '.') + "]";
  }
  std::fprintf(stderr, "\r\033[K%s%s %s  %.1f/s%s%s", label_.c_str(), bar.c_str(), counts.c_str(), rate, tail.c_str(),
               last ? "\n" : "");
}

}  // namespace pleat
