#include "common/rpc/caller.hpp"

#include <grpcpp/security/auth_context.h>
#include <openssl/crypto.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <sstream>
#include <utility>

#include "common/base/error.hpp"
#include "common/rpc/certificates.hpp"

namespace pleat::rpc {
namespace {

constexpr std::array<std::pair<Role, std::string_view>, 3> kRoles{
    {{Role::kWatcher, "watcher"}, {Role::kUser, "user"}, {Role::kAdmin, "admin"}}};
constexpr std::size_t kLeastToken = 16, kLongestName = 64;

[[noreturn]] void refuse(const std::string& message) { throw CallRefused(grpc::StatusCode::UNAUTHENTICATED, message); }

void require_usable(const std::string& name) {
  if (name.empty()) refuse("the client's certificate has no common name that can be shown");
  if (name.size() > kLongestName) refuse("the common name of the client's certificate is too long");
  // Else it would own what was made without any certificate.
  if (name == kLocalName) refuse(std::string("a certificate can't be for '") + kLocalName + "'");
}

}  // namespace

std::string_view to_string(Role role) {
  for (const auto& [candidate, name] : kRoles) {
    if (candidate == role) return name;
  }
  return "unknown";
}

std::optional<Role> role_named(std::string_view name) {
  for (const auto& [role, candidate] : kRoles) {
    if (candidate == name) return role;
  }
  return std::nullopt;
}

std::string Caller::describe() const { return name + " (" + std::string(to_string(role)) + ") at " + host; }

TokenTable::TokenTable(const std::filesystem::path& file) {
  std::ifstream stream(file);
  struct stat status {};
  if (!stream || ::stat(file.c_str(), &status) != 0) throw_not_found(file.string() + ": can't be read");
  if ((status.st_mode & 077) != 0) {
    throw Error(ErrorCode::kFailedPrecondition, file.string() + ": holds secrets and is open to others; chmod 600 it");
  }
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    std::istringstream words(line);
    std::string name, role, token, more;
    if (!(words >> name) || name.starts_with('#')) continue;
    const auto fail = [&](const std::string& problem) {
      throw_invalid_argument(file.string() + ":" + std::to_string(number) + ": " + problem);
    };
    if (!(words >> role >> token) || words >> more) fail("a line is NAME ROLE TOKEN");
    const auto known = role_named(role);
    if (!known) fail("no role '" + role + "'; there are admin, user and watcher");
    if (name.size() > kLongestName || name == kLocalName) fail("'" + name + "' can't be a name");
    if (token.size() < kLeastToken) fail("a token has at least " + std::to_string(kLeastToken) + " characters");
    if (!bearers_.emplace(token, Bearer{name, *known}).second) fail("the token is there twice");
  }
}

const TokenTable::Bearer* TokenTable::find(std::string_view token) const {
  const Bearer* found = nullptr;
  for (const auto& [secret, bearer] : bearers_) {
    if (secret.size() == token.size() && CRYPTO_memcmp(secret.data(), token.data(), token.size()) == 0) {
      found = &bearer;
    }
  }
  return found;
}

Callers::Callers(const std::string& token_file)
    : tokens_(token_file.empty() ? nullptr
                                 : std::make_unique<ReloadedFile<TokenTable>>(
                                       token_file, [](const std::filesystem::path& path) { return TokenTable(path); },
                                       [](const std::string& problem) { spdlog::warn("{}", problem); })) {}

Caller Callers::identify(const grpc::ServerContextBase& context) const {
  Caller caller;
  caller.host = host_of_peer(context.peer());
  const auto auth = context.auth_context();
  if (auth && auth->IsPeerAuthenticated()) {
    for (const grpc::string_ref& pem : auth->FindPropertyValues("x509_pem_cert")) {
      const CertificateSubject subject = certificate_subject({pem.data(), pem.size()});
      require_usable(subject.common_name);
      caller.name = subject.common_name;
      for (const std::string& unit : subject.units) caller.role = role_named(unit).value_or(caller.role);
      return caller;
    }
  }
  if (!tokens_) {
    caller.name = kLocalName;
    caller.role = Role::kAdmin;
    return caller;
  }
  const auto& metadata = context.client_metadata();
  const auto given = metadata.find(kTokenKey);
  const std::string_view prefix = kTokenPrefix;
  if (given == metadata.end() || !given->second.starts_with(grpc::string_ref(prefix.data(), prefix.size()))) {
    refuse("this coordinator wants a token (--token-file)");
  }
  const std::string_view token(given->second.data() + prefix.size(), given->second.size() - prefix.size());
  const auto table = tokens_->get();
  const TokenTable::Bearer* bearer = table->find(token);
  if (bearer == nullptr) refuse("the token is not known here");
  caller.name = bearer->name;
  caller.role = bearer->role;
  return caller;
}

std::string read_token(const std::string& file) {
  std::ifstream stream(file);
  std::string token, more;
  if (!stream) throw_not_found(file + ": can't be read");
  if (!(stream >> token) || stream >> more) throw_invalid_argument(file + ": holds more or less than one token");
  return token;
}

std::string host_of_peer(const std::string& peer) {
  const auto scheme = peer.find(':');
  if (peer.rfind("ipv", 0) != 0) return peer.substr(0, scheme);
  const auto port = peer.rfind(':');
  return port == scheme ? peer : peer.substr(0, port);
}

}  // namespace pleat::rpc
