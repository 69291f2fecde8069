// The paper's tables on a small data set.
#include "services/evaluation/tables/tables.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/executable.hpp"
#include "tests/unit/services/evaluation/evaluation_dataset.hpp"

namespace pleat::evaluation {
namespace {

namespace fs = std::filesystem;
using test::kOffset;
using testing::HasSubstr;
using testing::Not;

class Tables : public test::EvaluationDataset {
 protected:
  PaperTables tables() const {
    TablesOptions options;
    options.draping = folder_;
    options.hitting = options.skirt = folder_ / "nothing";
    for (const auto& [set, title] : free_set_names()) options.free_sets[set] = folder_ / "nothing";
    options.free_sets["sheet"] = options.free_sets["sheet-tracked"] = folder_;
    options.trained = folder_ / "trained";
    options.models = folder_ / "models";
    options.out = folder_ / "out";
    options.every = 1;
    options.timed_frames = 0;
    return make_tables(options, [](auto, auto, const auto&) {});
  }
  static const TableRow& row(const Table& table, const std::vector<std::string>& names) {
    for (const TableRow& row : table.rows) {
      if (row.names == names) return row;
    }
    ADD_FAILURE() << "no row " << names.back();
    return table.rows.front();
  }
};

TEST_F(Tables, HaveThePrintedFiguresBesideThoseOfTheData) {
  const PaperTables result = tables();
  ASSERT_EQ(result.tables.size(), 7u);
  const TableRow& sizes = row(result.tables[0], {"DRAPING"});
  EXPECT_EQ(sizes.entries[0].printed, 749);
  EXPECT_EQ(sizes.entries[0].measured, 16);
  EXPECT_EQ(sizes.entries[2].printed, 4270);  // 4.27 s
  EXPECT_FALSE(sizes.entries[2].measured.has_value());

  const Table& methods = result.tables[1];
  const TableRow& upsampled = row(methods, {"DRAPING", "barycentric upsampling"});
  EXPECT_FALSE(upsampled.entries[0].printed.has_value());
  EXPECT_NEAR(upsampled.entries[2].measured.value(), 1e3 * kOffset, 1e-3);
  EXPECT_NEAR(upsampled.entries[1].measured.value(), kOffset * kOffset, 1e-8);
  // The training sequence has the test sequence's offset.
  EXPECT_NEAR(row(methods, {"DRAPING", "Zurdo 2013"}).entries[2].measured.value(), 0, 1e-3);
  EXPECT_EQ(row(methods, {"DRAPING", "Zurdo 2013"}).entries[1].printed, 1.30e-4);
  const TableRow& chen = row(methods, {"DRAPING", "Chen 2018"});
  EXPECT_EQ(chen.entries[0].printed, 59.07);
  EXPECT_FALSE(chen.entries[0].measured.has_value());
  EXPECT_EQ(chen.entries[0].missing, "build/bin/pleat-train deploy/models/draping-chen2018.train.json");
  EXPECT_EQ(row(methods, {"HITTING", "MFSR"}).entries[0].printed, 72.25);
  EXPECT_THAT(row(methods, {"HITTING", "MFSR"}).entries[0].missing, HasSubstr("pleat dataset generate"));
  EXPECT_EQ(row(result.tables[2], {"SKIRT"}).entries[4].printed, 62.88);
}

TEST_F(Tables, TheSecondSystemsSetsHaveSizesMethodsAndAblations) {
  const PaperTables result = tables();
  const TableRow& sizes = row(result.tables[4], {"SHEET x16"});
  EXPECT_FALSE(sizes.entries[0].printed.has_value()) << "its table 1 has the sheet of 81 vertices";
  EXPECT_EQ(sizes.entries[0].measured, 16);
  EXPECT_EQ(row(result.tables[4], {"SHEET x64"}).entries[2].printed, 2480);

  const Table& methods = result.tables[5];
  const TableRow& upsampled = row(methods, {"SHEET x16", "barycentric upsampling"});
  EXPECT_NEAR(upsampled.entries[0].measured.value(), 1e3 * kOffset, 1e-3);
  EXPECT_TRUE(upsampled.entries[1].measured.has_value());
  EXPECT_TRUE(upsampled.entries[2].measured.has_value());
  EXPECT_NEAR(row(methods, {"SHEET x16", "Zurdo 2013, tracked"}).entries[0].measured.value(), 0, 1e-3);
  EXPECT_EQ(row(methods, {"SHEET x16", "published, 32 numbers"}).entries[0].missing,
            "build/bin/pleat-train deploy/models/sheet-published-latent-32.train.json");
  EXPECT_THAT(row(methods, {"DISK", "tokens"}).entries[0].missing, HasSubstr("--set disk --scale full"));

  const Table& factors = result.tables[6];
  EXPECT_NEAR(row(factors, {"SHEET x16"}).entries[0].measured.value(), 1e3 * kOffset, 1e-3);
  EXPECT_EQ(row(factors, {"SHEET x256"}).entries[1].printed, 5.31);
  EXPECT_EQ(factors.rows.size(), 3u);
}

TEST_F(Tables, RemoveNothingOfOthers) {
  const fs::path precious = folder_ / "out" / "tables-draping" / "precious.txt";
  fs::create_directories(precious.parent_path());
  std::ofstream(precious) << "mine";
  tables();
  EXPECT_TRUE(fs::exists(precious));
}

TEST_F(Tables, EveryCommandNamesAConfigurationThatIsShipped) {
  const PaperTables result = tables();
  const fs::path root = std::getenv("PLEAT_SOURCE_DIR");
  int commands = 0;
  for (const Table& table : result.tables) {
    for (const TableRow& row : table.rows) {
      for (const TableEntry& entry : row.entries) {
        const auto place = entry.missing.find("deploy/models/");
        if (place == std::string::npos) continue;
        EXPECT_TRUE(fs::exists(root / entry.missing.substr(place))) << entry.missing;
        ++commands;
      }
    }
  }
  EXPECT_GE(commands, 9);
}

TEST_F(Tables, TextHasBothAndWhatIsMissing) {
  const std::string text = to_text(tables());
  EXPECT_THAT(text, HasSubstr("paper"));
  EXPECT_THAT(text, HasSubstr("68.91"));
  EXPECT_THAT(text, HasSubstr("20.000"));  // mm
  EXPECT_THAT(text, HasSubstr("missing: DRAPING, Chen 2018: build/bin/pleat-train"));
  std::size_t longest = 0, begin = 0;
  for (std::size_t end; (end = text.find('\n', begin)) != std::string::npos; begin = end + 1)
    if (text[begin] == ' ' && text.find(". ", begin) > end && text.compare(begin, 10, "  missing:") != 0)
      longest = std::max(longest, end - begin);
  EXPECT_LT(longest, 160u);
}

TEST_F(Tables, PageShowsTheMeshesAndNeedsNothingElse) {
  const std::string page = to_html(tables());
  std::size_t canvases = 0;
  for (std::size_t at = page.find("<canvas id="); at != std::string::npos; at = page.find("<canvas id=", at + 1))
    ++canvases;
  // Fig. 11: coarse, Zurdo, simulated; Fig. 12: coarse, simulated; SHEET: coarse, Zurdo twice, simulated.
  EXPECT_EQ(canvases, 9u);
  EXPECT_THAT(page, HasSubstr("not trained here"));
  EXPECT_THAT(page, HasSubstr("draping-loss-dnv.train.json"));
  EXPECT_THAT(page, Not(HasSubstr("http")));
  EXPECT_THAT(page, Not(HasSubstr("src=")));
}

TEST_F(Tables, CurvesComeFromTheLogOfATraining) {
  EXPECT_TRUE(read_convergence("none", folder_ / "log.csv").minutes.empty());
  fs::create_directories(folder_ / "trained/draping-srresnet");
  std::ofstream(folder_ / "trained/draping-srresnet/log.csv")
      << "epoch,minutes,psnr_db,psnr_normal_db,psnr_velocity_db\n1,0.5,60,20,70\n2,1,nan,nan,nan\n3,1.5,62,23,71\n4,2";
  const PaperTables result = tables();
  ASSERT_EQ(result.figure13.size(), 1u);
  EXPECT_EQ(result.figure13[0].minutes, (std::vector<double>{0.5, 1.5}));
  EXPECT_EQ(result.figure13[0].normal_db, (std::vector<double>{20, 23}));
  EXPECT_EQ(row(result.tables[3], {"SRResNet"}).entries[0].measured, 62);
  EXPECT_THAT(to_html(result), HasSubstr("<path class=\"line\""));
}

TEST_F(Tables, AsACommand) {
  std::vector<std::string> words{"bench",     "tables",
                                 "--draping", folder_.string(),
                                 "--hitting", "nowhere",
                                 "--skirt",   "nowhere",
                                 "--trained", (folder_ / "trained").string(),
                                 "--models",  (folder_ / "models").string(),
                                 "--out",     (folder_ / "out").string(),
                                 "--timed",   "0",
                                 "--every",   "1",
                                 "--json"};
  for (const auto& [set, title] : free_set_names()) words.insert(words.end(), {"--" + set, "nowhere"});
  const test::Outcome outcome = test::run(test::built("pleat"), words, folder_ / "outcome");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const nlohmann::json rows = nlohmann::json::parse(outcome.out).at("tables").at("table2").at("rows");
  EXPECT_NEAR(rows.at(0).at("figures").at("RMSE mm").at("measured").get<double>(), 1e3 * kOffset, 1e-3);
  EXPECT_TRUE(rows.at(2).at("figures").at("PSNR dB").at("measured").is_null());
  EXPECT_TRUE(fs::exists(folder_ / "out/tables.html"));
}

}  // namespace
}  // namespace pleat::evaluation
