#include "common/rpc/certificates.hpp"

#include <grpcpp/security/auth_context.h>
#include <grpcpp/security/tls_certificate_provider.h>
#include <grpcpp/security/tls_credentials_options.h>
#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <map>
#include <mutex>
#include <optional>
#include <tuple>

#include "common/base/error.hpp"

namespace pleat::rpc {
namespace {

template <auto Free>
struct Freed {
  template <typename T>
  void operator()(T* object) const {
    Free(object);
  }
};
using Bio = std::unique_ptr<BIO, Freed<BIO_free>>;
using Certificate = std::unique_ptr<X509, Freed<X509_free>>;
using Revocations = std::unique_ptr<X509_CRL, Freed<X509_CRL_free>>;
using Key = std::unique_ptr<EVP_PKEY, Freed<EVP_PKEY_free>>;

std::string read_pem(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) throw_not_found(path + ": can't be read");
  std::string text((std::istreambuf_iterator<char>(stream)), {});
  if (text.find("-----BEGIN") == std::string::npos) throw_invalid_argument(path + ": not a PEM file");
  return text;
}

Bio reader_of(const std::string& pem) { return Bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size()))); }

/// The first of the text, or null.
Certificate certificate_in(const std::string& pem) {
  return Certificate(PEM_read_bio_X509(reader_of(pem).get(), nullptr, nullptr, nullptr));
}

std::vector<Certificate> certificates_in(const std::string& pem) {
  std::vector<Certificate> all;
  const Bio reader = reader_of(pem);
  while (Certificate next{PEM_read_bio_X509(reader.get(), nullptr, nullptr, nullptr)}) all.push_back(std::move(next));
  return all;
}

std::vector<std::string> entries(const X509_NAME* name, int kind) {
  std::vector<std::string> texts;
  for (int at = -1; (at = X509_NAME_get_index_by_NID(name, kind, at)) >= 0;) {
    unsigned char* text = nullptr;
    const int size = ASN1_STRING_to_UTF8(&text, X509_NAME_ENTRY_get_data(X509_NAME_get_entry(name, at)));
    if (size < 0) continue;
    texts.emplace_back(reinterpret_cast<char*>(text), static_cast<std::size_t>(size));
    OPENSSL_free(text);
  }
  return texts;
}

bool can_be_shown(const std::string& text) {
  return !text.empty() &&
         std::all_of(text.begin(), text.end(), [](char c) { return static_cast<unsigned char>(c) >= ' ' && c != 127; });
}

/// One key for a certificate of an authority.
std::string revocation_key(const X509_NAME* issuer, const ASN1_INTEGER* serial) {
  unsigned char* der = nullptr;
  const int size = i2d_X509_NAME(issuer, &der);
  std::string key(reinterpret_cast<char*>(der), static_cast<std::size_t>(std::max(size, 0)));
  OPENSSL_free(der);
  const auto* digits = ASN1_STRING_get0_data(serial);
  return key.append(reinterpret_cast<const char*>(digits), static_cast<std::size_t>(ASN1_STRING_length(serial)));
}

using Provider = grpc::experimental::FileWatcherCertificateProvider;

/// One for each three files: it has a thread that looks at them.
std::shared_ptr<Provider> provider_of(const TlsOptions& tls) {
  static std::mutex mutex;
  static auto& known = *new std::map<std::tuple<std::string, std::string, std::string>, std::weak_ptr<Provider>>;
  const std::lock_guard lock(mutex);
  std::weak_ptr<Provider>& place = known[{tls.key_file, tls.certificate_file, tls.ca_file}];
  std::shared_ptr<Provider> provider = place.lock();
  if (!provider) {
    provider = std::make_shared<Provider>(tls.key_file, tls.certificate_file, tls.ca_file, kReloadSeconds);
    place = provider;
  }
  return provider;
}

}  // namespace

CertificateSubject certificate_subject(const std::string& pem) {
  const Certificate certificate = certificate_in(pem);
  if (!certificate) throw_invalid_argument("no certificate");
  const X509_NAME* name = X509_get_subject_name(certificate.get());
  CertificateSubject subject;
  const std::vector<std::string> names = entries(name, NID_commonName);
  if (!names.empty() && can_be_shown(names.front())) subject.common_name = names.front();
  subject.units = entries(name, NID_organizationalUnitName);
  return subject;
}

RevocationList::RevocationList(const std::string& file, const std::string& ca_file) {
  const std::vector<Certificate> authorities = certificates_in(read_pem(ca_file));
  const std::string text = read_pem(file);
  const Bio reader = reader_of(text);
  int lists = 0;
  while (const Revocations list{PEM_read_bio_X509_CRL(reader.get(), nullptr, nullptr, nullptr)}) {
    ++lists;
    const X509_NAME* issuer = X509_CRL_get_issuer(list.get());
    const bool genuine = std::any_of(authorities.begin(), authorities.end(), [&](const Certificate& authority) {
      if (X509_NAME_cmp(X509_get_subject_name(authority.get()), issuer) != 0) return false;
      return X509_CRL_verify(list.get(), X509_get0_pubkey(authority.get())) == 1;
    });
    if (!genuine) throw_invalid_argument(file + ": a revocation list that no authority in " + ca_file + " has signed");
    STACK_OF(X509_REVOKED)* entries = X509_CRL_get_REVOKED(list.get());
    for (int i = 0; i < sk_X509_REVOKED_num(entries); ++i) {
      revoked_.insert(revocation_key(issuer, X509_REVOKED_get0_serialNumber(sk_X509_REVOKED_value(entries, i))));
    }
  }
  if (lists == 0) throw_invalid_argument(file + ": holds no revocation list");
}

bool RevocationList::revokes(const std::string& certificate_pem) const {
  const Certificate certificate = certificate_in(certificate_pem);
  return certificate && revoked_.contains(revocation_key(X509_get_issuer_name(certificate.get()),
                                                         X509_get0_serialNumber(certificate.get())));
}

RevocationCheck::RevocationCheck(const std::string& file, const std::string& ca_file)
    : list_(
          file, [ca_file](const std::filesystem::path& path) { return RevocationList(path.string(), ca_file); },
          [](const std::string& problem) { spdlog::warn("{}", problem); }) {}

grpc::Status RevocationCheck::Process(const InputMetadata&, grpc::AuthContext* context, OutputMetadata*,
                                      OutputMetadata*) {
  const auto list = list_.get();
  for (const grpc::string_ref& pem : context->FindPropertyValues("x509_pem_cert")) {
    const std::string certificate(pem.data(), pem.size());
    if (!list->revokes(certificate)) continue;
    const std::string name = certificate_subject(certificate).common_name;
    spdlog::warn("audit: a call with the revoked certificate of {} was refused", name);
    return {grpc::StatusCode::UNAUTHENTICATED, "the certificate of " + name + " was revoked"};
  }
  return grpc::Status::OK;
}

void check_tls(const TlsOptions& tls) {
  if (tls.ca_file.empty() || tls.certificate_file.empty() || tls.key_file.empty()) {
    throw_invalid_argument("TLS needs a CA, a certificate and a key, all three");
  }
  if (certificates_in(read_pem(tls.ca_file)).empty()) throw_invalid_argument(tls.ca_file + ": holds no certificate");
  const Certificate certificate = certificate_in(read_pem(tls.certificate_file));
  if (!certificate) throw_invalid_argument(tls.certificate_file + ": holds no certificate");
  const auto no_passphrase = [](char*, int, int, void*) { return 0; };  // else OpenSSL asks on the terminal
  const Key key(PEM_read_bio_PrivateKey(reader_of(read_pem(tls.key_file)).get(), nullptr, no_passphrase, nullptr));
  if (!key) throw_invalid_argument(tls.key_file + ": holds no private key that can be read without a passphrase");
  if (X509_check_private_key(certificate.get(), key.get()) != 1) {
    throw_invalid_argument(tls.key_file + ": is not the key of " + tls.certificate_file);
  }
}

std::shared_ptr<grpc::ChannelCredentials> channel_credentials(const TlsOptions& tls) {
  check_tls(tls);
  grpc::experimental::TlsChannelCredentialsOptions options;
  options.set_certificate_provider(provider_of(tls));
  options.watch_root_certs();
  options.watch_identity_key_cert_pairs();
  return grpc::experimental::TlsCredentials(options);
}

std::shared_ptr<grpc::ServerCredentials> server_credentials(const TlsOptions& tls) {
  check_tls(tls);
  grpc::experimental::TlsServerCredentialsOptions options(provider_of(tls));
  options.watch_root_certs();
  options.watch_identity_key_cert_pairs();
  options.set_cert_request_type(GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  auto credentials = grpc::experimental::TlsServerCredentials(options);
  if (!tls.crl_file.empty()) {
    credentials->SetAuthMetadataProcessor(std::make_shared<RevocationCheck>(tls.crl_file, tls.ca_file));
  }
  return credentials;
}

}  // namespace pleat::rpc
