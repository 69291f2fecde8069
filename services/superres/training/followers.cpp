#include "services/superres/training/followers.hpp"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>

#include "common/base/error.hpp"

namespace pleat::superres {

Followers::Followers(const std::vector<std::string>& words, int processes, const std::string& rendezvous) {
  for (int rank = 1; rank < processes; ++rank) {
    std::vector<std::string> own{"pleat-train"};
    own.insert(own.end(), words.begin(), words.end());
    for (const std::string& word :
         {std::string("--rank"), std::to_string(rank), std::string("--rendezvous"), rendezvous}) {
      own.push_back(word);
    }
    std::vector<char*> pointers;
    for (std::string& word : own) pointers.push_back(word.data());
    pointers.push_back(nullptr);
    pid_t child = 0;
    if (::posix_spawn(&child, "/proc/self/exe", nullptr, nullptr, pointers.data(), environ) != 0) {
      throw Error(ErrorCode::kResourceExhausted, "can't start another process");
    }
    children_.push_back(child);
  }
}

Followers::~Followers() {
  if (!done_) {
    for (const pid_t child : children_) ::kill(child, SIGKILL);
  }
  for (const pid_t child : children_) ::waitpid(child, nullptr, 0);
}

}  // namespace pleat::superres
