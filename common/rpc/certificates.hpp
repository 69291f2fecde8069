// X.509 certificates: who they name, whether they were revoked, and credentials that follow the files when they are
// renewed.
#pragma once

#include <grpcpp/security/auth_metadata_processor.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/security/server_credentials.h>

#include <memory>
#include <set>
#include <string>
#include <vector>

#include "common/base/reloaded_file.hpp"
#include "common/rpc/channel.hpp"

namespace pleat::rpc {

/// What the subject of a certificate says.
struct CertificateSubject {
  std::string common_name;         ///< empty: none, or one with characters that can't be shown
  std::vector<std::string> units;  ///< organisational units
};

/// Throws kInvalidArgument if the text holds no certificate.
CertificateSubject certificate_subject(const std::string& pem);

/// The certificates that an authority has taken back. Immutable.
class RevocationList {
 public:
  /// Reads the lists in a PEM file. Throws kNotFound or kInvalidArgument, naming the file, unless there is at least one
  /// and each is signed by an authority in `ca_file`.
  RevocationList(const std::string& file, const std::string& ca_file);

  bool revokes(const std::string& certificate_pem) const;

 private:
  std::set<std::string> revoked_;  ///< issuer and serial number
};

/// Refuses every call of a client whose certificate is on the list, with UNAUTHENTICATED. The list is read again when
/// its file changes; calls that run go on to their end.
class RevocationCheck final : public grpc::AuthMetadataProcessor {
 public:
  RevocationCheck(const std::string& file, const std::string& ca_file);
  bool IsBlocking() const override { return false; }
  grpc::Status Process(const InputMetadata& metadata, grpc::AuthContext* context, OutputMetadata* consumed,
                       OutputMetadata* response) override;

 private:
  ReloadedFile<RevocationList> list_;
};

/// Throws kInvalidArgument or kNotFound, naming the file, unless the three files hold what they should and the key is
/// the certificate's.
void check_tls(const TlsOptions& tls);

/// mTLS with the three files, which are read again when they change (within kReloadSeconds): connections made after
/// that show and demand the new ones. Replace key and certificate together: between the two no connection can be made.
/// Throws as check_tls().
std::shared_ptr<grpc::ChannelCredentials> channel_credentials(const TlsOptions& tls);
std::shared_ptr<grpc::ServerCredentials> server_credentials(const TlsOptions& tls);
inline constexpr unsigned kReloadSeconds = 2;

}  // namespace pleat::rpc
