#include "services/presentation/live/live_page.hpp"

#include <httplib.h>
#include <openssl/crypto.h>
#include <sys/random.h>

#include <array>
#include <charconv>
#include <deque>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>
#include <vector>

#include "common/client/cpp/client.hpp"
#include "common/frame/detail.hpp"
#include "services/presentation/live/job_view.hpp"
#include "services/presentation/report/viewer_page.hpp"

namespace pleat::presentation {
namespace {

using nlohmann::json;
using std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;

constexpr std::size_t kThreads = 16;         // a browser has up to six connections
constexpr std::size_t kViews = 8;            // jobs that are looked at at the same time
constexpr std::size_t kNotes = 100;          // lines
constexpr std::size_t kEndedJobs = 30;       // in the list
constexpr milliseconds kPatience{15'000};    // of the coordinator's stream, for another question
constexpr milliseconds kLongestWait{8'000};  // for a frame
constexpr milliseconds kListAge{400};        // of a list that serves another question

constexpr const char* kOverHeader = "Pleat-Over";  // the job has ended, and there is no newer frame

struct Listen {
  std::string host;
  int port = 0;
};

Listen parse(const std::string& address) {
  if (rpc::is_unix_address(address) || !rpc::is_local_address(address)) {
    throw_invalid_argument("--page " + address + ": not an address of this host alone, such as 127.0.0.1:8050");
  }
  const auto colon = address.rfind(':');
  Listen listen{address.substr(0, colon), 0};
  if (listen.host.starts_with('[')) listen.host = listen.host.substr(1, listen.host.size() - 2);
  const char* const end = address.data() + address.size();
  const auto parsed = std::from_chars(address.data() + colon + 1, end, listen.port);
  if (parsed.ec != std::errc{} || parsed.ptr != end || listen.port < 0 || listen.port > 65'535) {
    throw_invalid_argument("--page " + address + ": the port must lie in [0, 65535]");
  }
  return listen;
}

std::string random_token() {
  std::array<unsigned char, 16> bytes{};
  if (::getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size())) {
    throw_internal("the system gives no random numbers");
  }
  std::string token;
  for (const unsigned char byte : bytes) {
    token += "0123456789abcdef"[byte >> 4];
    token += "0123456789abcdef"[byte & 15];
  }
  return token;
}

json to_json(const v1::Job& job) {
  const v1::JobSummary& summary = job.summary();
  json warnings = json::array();
  for (const std::string& warning : job.warnings()) warnings.push_back(warning);
  return {{"id", job.id()},
          {"live", job.id().starts_with("live:")},
          {"scene", job.scene_name()},
          {"owner", job.owner()},
          {"state", client::state_name(job.state())},
          {"ended", client::has_ended(job.state())},
          {"queue_place", job.queue_place()},
          {"frames", job.frames()},
          {"frames_complete", job.frames_complete()},
          {"error", job.error()},
          {"warnings", std::move(warnings)},
          {"detail", name_of(summary.detail())},
          {"model", summary.model()},
          {"device", summary.device()},
          {"precision", summary.precision()},
          {"coarse_vertices", summary.coarse_vertices()},
          {"fine_vertices", summary.fine_vertices()},
          {"wall_s", summary.wall_s()},
          {"penetrations", summary.penetrations()},
          {"self_intersections", summary.self_intersections()},
          {"frame_errors", summary.frame_errors()}};
}

int status_of(ErrorCode code) {
  switch (code) {
    case ErrorCode::kNotFound:
      return 404;
    case ErrorCode::kUnavailable:
    case ErrorCode::kResourceExhausted:
    case ErrorCode::kCancelled:
    case ErrorCode::kDeadlineExceeded:
      return 503;
    default:
      return 500;
  }
}

void answer_text(httplib::Response& response, int status, const std::string& text) {
  response.status = status;
  response.set_content(text + "\n", "text/plain; charset=utf-8");
}

void answer_packed(httplib::Response& response, const std::optional<std::string>& bytes) {
  if (bytes) {
    response.set_content(*bytes, "application/octet-stream");
  } else {
    response.status = 204;
  }
}

}  // namespace

struct LivePage::State {
  explicit State(const LivePageOptions& options)
      : client(options.coordinator, options.identity), token(random_token()) {
    const Listen listen = parse(options.listen);
    page = viewer_page("Pleat live", "'self'",
                       "<script type=\"application/json\" id=\"pleat-live\">" +
                           script_safe({{"coordinator", options.coordinator}}) + "</script>\n");
    configure();
    const int port = listen.port > 0 && server.bind_to_port(listen.host, listen.port) ? listen.port
                     : listen.port == 0 ? server.bind_to_any_port(listen.host)
                                        : -1;
    if (port < 0) throw Error(ErrorCode::kUnavailable, "--page " + options.listen + ": can't listen there");
    const std::string name = listen.host.find(':') == std::string::npos ? listen.host : "[" + listen.host + "]";
    hosts = {name + ":" + std::to_string(port), "localhost:" + std::to_string(port)};
    address = "http://" + hosts[0] + "/" + token + "/";
    thread = std::thread([this] { server.listen_after_bind(); });
    // stop() has no effect before.
    while (!server.is_running()) std::this_thread::sleep_for(milliseconds(1));
  }

  ~State() {
    {
      const std::lock_guard lock(mutex);
      stopping = true;
      for (const auto& [id, view] : views) view->stop();
    }
    server.stop();
    if (thread.joinable()) thread.join();
  }
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  void configure() {
    server.new_task_queue = [] { return new httplib::ThreadPool(kThreads); };
    // Not the library's own: with SO_REUSEPORT two pages would share a port.
    server.set_socket_options([](int socket) {
      const int yes = 1;
      setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    });
    server.set_tcp_nodelay(true);
    server.set_keep_alive_max_count(1'000'000);
    server.set_payload_max_length(0);
    server.set_default_headers({{"Cache-Control", "no-store"},
                                {"Content-Security-Policy", "frame-ancestors 'none'"},
                                {"Cross-Origin-Resource-Policy", "same-origin"},
                                {"Referrer-Policy", "no-referrer"},
                                {"X-Content-Type-Options", "nosniff"}});
    server.set_pre_routing_handler([this](const httplib::Request& request, httplib::Response& response) {
      return admit(request, response) ? httplib::Server::HandlerResponse::Unhandled
                                      : httplib::Server::HandlerResponse::Handled;
    });
    server.set_exception_handler([](const httplib::Request&, httplib::Response& response, std::exception_ptr thrown) {
      try {
        std::rethrow_exception(thrown);
      } catch (const Error& error) {
        answer_text(response, status_of(error.code()), error.what());
      } catch (const std::exception& error) {
        answer_text(response, 500, error.what());
      }
    });
    server.Get("/[0-9a-f]+/", [this](const httplib::Request&, httplib::Response& response) {
      response.set_content(page, "text/html; charset=utf-8");
    });
    server.Get("/[0-9a-f]+/state", [this](const httplib::Request&, httplib::Response& response) {
      response.set_content(state().dump(-1, ' ', false, json::error_handler_t::replace), "application/json");
    });
    server.Get("/[0-9a-f]+/jobs/([^/]+)/meshes", [this](const httplib::Request& request, httplib::Response& response) {
      answer_packed(response, view(request.matches[1])->meshes(kLongestWait));
    });
    server.Get("/[0-9a-f]+/jobs/([^/]+)/frame", [this](const httplib::Request& request, httplib::Response& response) {
      const std::string text = request.get_param_value("after");
      std::int64_t after = -1;
      const auto parsed = std::from_chars(text.data(), text.data() + text.size(), after);
      if (!text.empty() && (parsed.ec != std::errc{} || parsed.ptr != text.data() + text.size())) {
        answer_text(response, 400, "after: not a frame's index");
        return;
      }
      const JobView::News news = view(request.matches[1])->newer_than(after, kLongestWait);
      answer_packed(response, news.frame);
      // No error, which browsers would write into their console.
      if (news.over) response.set_header(kOverHeader, "1");
    });
  }

  /// False: the request is refused, and answered.
  bool admit(const httplib::Request& request, httplib::Response& response) const {
    // A page of another origin whose name was made to point here sends that name.
    const std::string host = request.get_header_value("Host");
    if (request.get_header_value_count("Host") != 1 || (host != hosts[0] && host != hosts[1])) {
      answer_text(response, 421, "this is not the host that was asked for");
      return false;
    }
    const std::string given = request.path.substr(std::min<std::size_t>(1, request.path.size()), token.size());
    const bool known = given.size() == token.size() && CRYPTO_memcmp(given.data(), token.data(), token.size()) == 0 &&
                       request.path.size() > token.size() + 1 && request.path[token.size() + 1] == '/';
    if (!known) {
      answer_text(response, 403, "the address has not the token that `pleat up` has printed");
      return false;
    }
    return true;
  }

  json state() {
    const std::lock_guard lock(list_mutex);
    if (Clock::now() - listed > kListAge) {
      json jobs = json::array();
      std::string problem;
      try {
        std::size_t ended = 0;
        for (const v1::Job& job : client.list_jobs(true)) {
          if (client::has_ended(job.state()) && ++ended > kEndedJobs) continue;
          jobs.push_back(to_json(job));
        }
      } catch (const Error& error) {
        problem = error.what();
      }
      list = {{"jobs", std::move(jobs)}, {"problem", problem}};
      listed = Clock::now();
    }
    json all = list;
    const std::lock_guard notes_lock(mutex);
    all["notes"] = notes;
    return all;
  }

  /// Of a job that is looked at already, or of another one. Throws kNotFound.
  std::shared_ptr<JobView> view(const std::string& id) {
    std::vector<std::shared_ptr<JobView>> gone;  // ended without the lock
    {
      const std::lock_guard lock(mutex);
      const auto found = views.find(id);
      if (found != views.end() && !found->second->has_failed()) return found->second;
    }
    const v1::Job job = client.get_job(id);
    const std::lock_guard lock(mutex);
    if (stopping) throw Error(ErrorCode::kUnavailable, "the page is closing");
    for (auto view = views.begin(); view != views.end();) {
      const bool drop = view->second->has_failed() || views.size() >= kViews;
      if (drop) gone.push_back(std::move(view->second));
      view = drop ? views.erase(view) : std::next(view);
    }
    if (const auto found = views.find(id); found != views.end()) return found->second;
    const std::uint64_t from = job.frames_complete() > 0 ? job.frames_complete() - 1 : 0;
    return views.emplace(id, std::make_shared<JobView>(client, id, from, kPatience)).first->second;
  }

  const client::Client client;
  const std::string token;
  std::string page, address;
  std::array<std::string, 2> hosts;
  std::mutex list_mutex;
  json list;
  Clock::time_point listed{};
  std::mutex mutex;
  std::deque<std::string> notes;
  std::map<std::string, std::shared_ptr<JobView>> views;
  bool stopping = false;
  httplib::Server server;
  std::thread thread;
};

void check_listen(const std::string& listen) { parse(listen); }

LivePage::LivePage(const LivePageOptions& options) : state_(std::make_unique<State>(options)) {}
LivePage::~LivePage() = default;

const std::string& LivePage::address() const { return state_->address; }

void LivePage::note(const std::string& line) {
  const std::lock_guard lock(state_->mutex);
  state_->notes.push_back(line);
  if (state_->notes.size() > kNotes) state_->notes.pop_front();
}

}  // namespace pleat::presentation
