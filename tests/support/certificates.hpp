// An authority and certificates of it, as deploy/certificates/make-certificates.sh makes them.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

#include "common/rpc/channel.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::test {

class Certificates {
 public:
  /// A server "localhost", which is 127.0.0.1 too, and a client.
  Certificates() : made_(call("localhost 127.0.0.1")) {}

  /// False where there is no openssl command.
  bool made() const { return made_; }
  /// make-certificates.sh FOLDER ARGUMENTS
  bool call(const std::string& arguments) {
    const char* source = std::getenv("PLEAT_SOURCE_DIR");
    const std::string script = std::string(source ? source : ".") + "/deploy/certificates/make-certificates.sh";
    return std::system((script + " " + folder_.path().string() + " " + arguments + " > /dev/null").c_str()) == 0;
  }

  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }
  rpc::TlsOptions server() const { return of("server"); }
  rpc::TlsOptions client(const std::string& name = "client") const { return of(name); }

 private:
  rpc::TlsOptions of(const std::string& name) const {
    rpc::TlsOptions tls;
    tls.ca_file = file("ca.crt");
    tls.certificate_file = file(name + ".crt");
    tls.key_file = file(name + ".key");
    return tls;
  }

  const TemporaryFolder folder_;
  bool made_;
};

}  // namespace pleat::test
