#include "services/superres/networks/registry.hpp"

#include <algorithm>
#include <iterator>

#include "common/base/error.hpp"
#include "services/superres/networks/chen2018/chen2018.hpp"
#include "services/superres/networks/mfsr/mfsr.hpp"
#include "services/superres/networks/options.hpp"
#include "services/superres/networks/published/published.hpp"
#include "services/superres/networks/srresnet/srresnet.hpp"
#include "services/superres/networks/tokens/tokens.hpp"
#include "services/superres/networks/unet/unet.hpp"

namespace pleat::superres {
namespace {

struct NetworkKind {
  const char* name;
  Description (*describe)(Options& options, const Ports& ports);
};
constexpr NetworkKind kKinds[] = {{"mfsr", describe_mfsr},           {"srresnet", describe_srresnet},
                                  {"chen2018", describe_chen2018},   {"tokens", describe_tokens},
                                  {"published", describe_published}, {"unet", describe_unet}};

const NetworkKind* find(const std::string& name) {
  const auto* found = std::find_if(std::begin(kKinds), std::end(kKinds), [&](const auto& k) { return name == k.name; });
  return found == std::end(kKinds) ? nullptr : found;
}

const NetworkKind& get(const std::string& name) {
  const NetworkKind* kind = find(name);
  if (kind != nullptr) return *kind;
  std::string all;
  for (const auto& known : kKinds) all += std::string(all.empty() ? "'" : ", '") + known.name + "'";
  throw_invalid_argument("architecture: kind '" + name + "' is none of " + all);
}

}  // namespace

std::vector<std::string> network_kinds() {
  std::vector<std::string> names;
  for (const NetworkKind& kind : kKinds) names.emplace_back(kind.name);
  return names;
}

bool is_registered(const std::string& kind) { return find(kind) != nullptr; }

Architecture complete(const Architecture& architecture) {
  Options options(architecture.options);
  get(architecture.kind).describe(options, {});
  return {architecture.kind, options.finish()};
}

Description describe(const Architecture& architecture, const Ports& ports) {
  Options options(architecture.options);
  Description description = get(architecture.kind).describe(options, ports);
  options.finish();
  return description;
}

}  // namespace pleat::superres
