// Manual pages and completions say what the command line takes.
#include "common/base/manual.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>

#include "common/base/text_file.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

/// example [-q] run SCENE --detail {network,fold} --tls-ca FILE | dataset info FOLDER
class Manual : public testing::Test {
 protected:
  Manual() {
    root_.add_flag("-q,--quiet", quiet_, "no progress");
    CLI::App* run = root_.add_subcommand("run", "simulate a scene: it's \\fast");
    run->add_option("scene", text_, "a scene file")->required();
    run->add_option("--detail", text_, "what makes wrinkles")->check(CLI::IsMember({"network", "fold"}));
    run->add_option("--secret", text_, "unseen")->group("");
    run->add_option_group("TLS", "other hosts")
        ->add_option("--tls-ca", text_, "authority [PEM]")
        ->envname("EXAMPLE_CA");
    CLI::App* info = root_.add_subcommand("dataset", "data sets")->add_subcommand("info", "what is there");
    info->add_option("folder", text_, "a folder");
    root_.add_subcommand("hidden", "unseen")->group("");
    for (const ManualFile& file : manual(root_, "1.2.3")) files_[file.path.string()] = file.text;
  }

  /// What bash offers behind these words, of which the last is being typed.
  std::string completed(const std::vector<std::string>& words) {
    const pleat::test::TemporaryFolder folder;
    std::ofstream(folder.path() / "script") << files_.at("bash-completion/completions/example");
    std::string line = "source '" + (folder.path() / "script").string() + "'; COMP_WORDS=(example";
    for (const std::string& word : words) line += " '" + word + "'";
    line += "); COMP_CWORD=" + std::to_string(words.size()) + "; _example; echo \"${COMPREPLY[*]}\" >'" +
            (folder.path() / "out").string() + "'";
    std::ofstream(folder.path() / "line") << line;
    EXPECT_EQ(std::system(("bash '" + (folder.path() / "line").string() + "'").c_str()), 0);
    std::string out = read_text_file(folder.path() / "out");
    return out.substr(0, out.find('\n'));
  }

  CLI::App root_{"an example", "example"};
  bool quiet_ = false;
  std::string text_;
  std::map<std::string, std::string> files_;
};

TEST_F(Manual, HasAPageForEveryCommandAndNoneForHiddenOnes) {
  std::vector<std::string> names;
  for (const auto& [name, text] : files_) names.push_back(name);
  EXPECT_THAT(
      names, testing::UnorderedElementsAre("man/man1/example.1", "man/man1/example-run.1", "man/man1/example-dataset.1",
                                           "man/man1/example-dataset-info.1", "bash-completion/completions/example",
                                           "zsh/site-functions/_example", "fish/vendor_completions.d/example.fish"));
}

TEST_F(Manual, APageNamesArgumentsOptionsAndTheirValues) {
  const std::string& page = files_.at("man/man1/example-run.1");
  EXPECT_THAT(page, HasSubstr(".TH EXAMPLE-RUN 1 \"\" \"Pleat 1.2.3\""));
  // Escaped, so that it stands there as it was written.
  EXPECT_THAT(page, HasSubstr("example\\-run \\- simulate a scene: it\\(aqs \\efast\n"));
  EXPECT_THAT(page, HasSubstr("\\fISCENE\\fR\na scene file"));
  EXPECT_THAT(page, HasSubstr("\\fB\\-\\-detail\\fR \\fITEXT\\fR\nwhat makes wrinkles (network, fold)"));
  EXPECT_THAT(page, HasSubstr("\\-\\-tls\\-ca"));
  EXPECT_THAT(page, HasSubstr("environment: EXAMPLE_CA"));
  EXPECT_THAT(page, testing::Not(HasSubstr("secret")));
  EXPECT_THAT(files_.at("man/man1/example.1"), HasSubstr(".BR example\\-dataset (1)"));
}

TEST_F(Manual, BashOffersCommandsOptionsAndValues) {
  EXPECT_EQ(completed({""}), "run dataset help");
  EXPECT_EQ(completed({"da"}), "dataset");
  EXPECT_EQ(completed({"dataset", ""}), "info");
  EXPECT_EQ(completed({"help", "dataset", "i"}), "info");
  EXPECT_EQ(completed({"run", "--d"}), "--detail");
  EXPECT_EQ(completed({"run", "x.json", "--tls"}), "--tls-ca");
  EXPECT_EQ(completed({"run", "--detail", ""}), "network fold");
  EXPECT_EQ(completed({"run", "--tls-ca", "--d"}), "");  // a file name goes here
  EXPECT_EQ(completed({"run", "x"}), "");
}

TEST_F(Manual, OtherShellsTakeTheirScripts) {
  for (const auto& [shell, name] :
       {std::pair{"zsh", "zsh/site-functions/_example"}, std::pair{"fish", "fish/vendor_completions.d/example.fish"}}) {
    const std::string& script = files_.at(name);
    EXPECT_THAT(script, HasSubstr("network fold"));
    EXPECT_THAT(script, testing::Not(HasSubstr("secret")));
    if (std::system((std::string("command -v ") + shell + " >/dev/null").c_str()) != 0) continue;
    const pleat::test::TemporaryFolder folder;
    std::ofstream(folder.path() / "script") << script;
    EXPECT_EQ(std::system((std::string(shell) + " -n '" + (folder.path() / "script").string() + "'").c_str()), 0)
        << script;
  }
}

TEST_F(Manual, IsWrittenBelowAFolder) {
  const pleat::test::TemporaryFolder folder;
  write_manual(root_, "1.2.3", folder.path() / "share");
  EXPECT_EQ(read_text_file(folder.path() / "share/man/man1/example.1"), files_.at("man/man1/example.1"));
  const char* words[] = {"example", "--write-manual", "there"};
  EXPECT_EQ(manual_folder(3, words), "there");
  EXPECT_EQ(manual_folder(2, words), "");
}

}  // namespace
}  // namespace pleat
