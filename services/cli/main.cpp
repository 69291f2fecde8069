// The command `pleat`.
#include "services/cli/command.hpp"

int main(int argc, char** argv) { return pleat::cli::run_pleat(argc, argv); }
