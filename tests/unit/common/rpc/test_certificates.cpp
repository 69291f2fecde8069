#include "common/rpc/certificates.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <thread>

#include "tests/support/certificates.hpp"
#include "tests/support/errors.hpp"
#include "tests/unit/common/rpc/sample_service.hpp"

namespace pleat::rpc {
namespace {

using namespace std::chrono_literals;

std::string content(const std::string& file) {
  std::ifstream stream(file);
  return {std::istreambuf_iterator<char>(stream), {}};
}

class CertificatesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!ours_.made()) GTEST_SKIP() << "no openssl command";
  }

  test::Certificates ours_;
};

TEST_F(CertificatesTest, TheSubjectHasNameAndUnits) {
  ASSERT_TRUE(ours_.call("--client alice admin"));
  const CertificateSubject alice = certificate_subject(content(ours_.file("client-alice.crt")));
  EXPECT_EQ(alice.common_name, "alice");
  EXPECT_EQ(alice.units, std::vector<std::string>{"admin"});
  EXPECT_EQ(certificate_subject(content(ours_.file("server.crt"))).common_name, "localhost");
  EXPECT_EQ(test::error_of([] { certificate_subject("-----BEGIN CERTIFICATE-----\nx"); }).code(),
            ErrorCode::kInvalidArgument);
}

TEST_F(CertificatesTest, OnlyWhatIsOnTheListIsRevoked) {
  ASSERT_TRUE(ours_.call("--client alice") && ours_.call("--client bob"));
  EXPECT_FALSE(
      RevocationList(ours_.file("ca.crl"), ours_.file("ca.crt")).revokes(content(ours_.file("client-alice.crt"))))
      << "an empty list";
  ASSERT_TRUE(ours_.call("--revoke client-alice"));
  const RevocationList list(ours_.file("ca.crl"), ours_.file("ca.crt"));
  EXPECT_TRUE(list.revokes(content(ours_.file("client-alice.crt"))));
  EXPECT_FALSE(list.revokes(content(ours_.file("client-bob.crt"))));
  ASSERT_TRUE(ours_.call("--renew client-alice"));
  EXPECT_FALSE(list.revokes(content(ours_.file("client-alice.crt")))) << "a new one of the same name";
}

TEST_F(CertificatesTest, AListOfAnotherAuthorityIsRefused) {
  const test::Certificates theirs;
  const Error error = test::error_of([&] { RevocationList(theirs.file("ca.crl"), ours_.file("ca.crt")); });
  EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
  EXPECT_NE(std::string(error.what()).find(theirs.file("ca.crl")), std::string::npos);
  EXPECT_EQ(test::error_of([&] { RevocationList(ours_.file("ca.crt"), ours_.file("ca.crt")); }).code(),
            ErrorCode::kInvalidArgument)
      << "no list at all";
}

TEST_F(CertificatesTest, FilesThatDontBelongTogetherAreNamed) {
  TlsOptions tls = ours_.server();
  EXPECT_NO_THROW(check_tls(tls));
  tls.key_file = ours_.file("client.key");
  EXPECT_NE(std::string(test::error_of([&] { check_tls(tls); }).what()).find("is not the key of"), std::string::npos);
  tls.key_file = ours_.file("ca.crt");
  EXPECT_EQ(test::error_of([&] { check_tls(tls); }).code(), ErrorCode::kInvalidArgument);
  tls.key_file.clear();
  EXPECT_EQ(test::error_of([&] { check_tls(tls); }).code(), ErrorCode::kInvalidArgument);
}

class TlsServerTest : public CertificatesTest {
 protected:
  void start() {
    options_.listen = "127.0.0.1:0";
    options_.tls = ours_.server();
    options_.tls.crl_file = ours_.file("ca.crl");
    server_.emplace(options_, std::vector<HostedService>{{&service_, "pleat.v1.Refinement", {}, {}}});
  }
  /// A connection of its own.
  bool gets_in(const TlsOptions& client, std::chrono::milliseconds timeout = 1s) {
    return is_healthy(create_channel(server_->address(), client), "pleat.v1.Refinement", timeout);
  }
  bool eventually(const std::function<bool()>& condition) {
    for (int i = 0; i < 40; ++i) {
      if (condition()) return true;
      std::this_thread::sleep_for(250ms);
    }
    return false;
  }

  testing::SampleRefinement service_;
  ServerOptions options_;
  std::optional<Server> server_;
};

TEST_F(TlsServerTest, ARevokedClientIsRefusedOnItsOpenConnectionToo) {
  ASSERT_TRUE(ours_.call("--client alice") && ours_.call("--client bob"));
  start();
  const auto alice = create_channel(server_->address(), ours_.client("client-alice"));
  ASSERT_TRUE(is_healthy(alice, "pleat.v1.Refinement", 10s));
  ASSERT_TRUE(ours_.call("--revoke client-alice"));
  EXPECT_FALSE(is_healthy(alice, "pleat.v1.Refinement", 5s));
  EXPECT_FALSE(gets_in(ours_.client("client-alice")));
  EXPECT_TRUE(gets_in(ours_.client("client-bob"), 5s));
  std::ofstream(ours_.file("ca.crl")) << "half of a list";
  EXPECT_FALSE(is_healthy(alice, "pleat.v1.Refinement", 5s)) << "a broken list leaves the old one in force";
}

TEST_F(TlsServerTest, ARenewedCertificateIsShownWithoutARestart) {
  start();
  ASSERT_TRUE(gets_in(ours_.client(), 10s));
  // The whole authority is replaced: who trusts only the old one, or shows a certificate of it, does not get in.
  const test::Certificates theirs;
  for (const char* name : {"server.key", "server.crt", "ca.crt"}) {
    std::filesystem::copy_file(theirs.file(name), ours_.file(name), std::filesystem::copy_options::overwrite_existing);
  }
  EXPECT_TRUE(eventually([&] { return gets_in(theirs.client(), 200ms); }));
  TlsOptions old = ours_.client();
  old.ca_file = theirs.file("ca.crt");
  EXPECT_FALSE(gets_in(old));
}

}  // namespace
}  // namespace pleat::rpc
