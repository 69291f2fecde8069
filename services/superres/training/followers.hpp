// The other processes of a data-parallel training: this program again, each with a rank. They end with this one.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

namespace pleat::superres {

class Followers {
 public:
  /// Starts `processes` - 1 of them with this program's own `words` (without argv[0]), --rank and --rendezvous. Throws
  /// kResourceExhausted.
  Followers(const std::vector<std::string>& words, int processes, const std::string& rendezvous);
  /// They end by themselves when the training is done or this process has left the group. Without done() they are
  /// killed: an error here must not leave them waiting.
  ~Followers();
  Followers(const Followers&) = delete;
  Followers& operator=(const Followers&) = delete;
  void done() { done_ = true; }

 private:
  std::vector<pid_t> children_;
  bool done_ = false;
};

}  // namespace pleat::superres
