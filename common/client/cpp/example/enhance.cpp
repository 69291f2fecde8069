// Enhances a garment live: example ADDRESS GARMENT.obj FRAMES FINE.obj
// The garment swings here; in your program the frames come from your simulator.
#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <string>

#include <pleat/client.hpp>

namespace client = pleat::client;

/// The lines v, vt and f of an OBJ file with material coordinates and triangles alone.
client::Mesh read_garment(const std::string& file) {
  client::Mesh mesh;
  std::ifstream stream(file);
  for (std::string line; std::getline(stream, line);) {
    std::istringstream words(line);
    std::string kind;
    words >> kind;
    float x = 0;
    if (kind == "v")
      while (words >> x) mesh.positions.push_back(x);
    if (kind == "vt")
      while (words >> x) mesh.uv.push_back(x);
    unsigned vertex = 0, coordinate = 0;
    char slash = 0;
    while (kind == "f" && words >> vertex >> slash >> coordinate) {
      mesh.faces.push_back(vertex - 1);
      mesh.uv_faces.push_back(coordinate - 1);
    }
  }
  return mesh;
}

int main(int argc, char** argv) try {
  if (argc != 5) {
    std::fprintf(stderr, "usage: example ADDRESS GARMENT.obj FRAMES FINE.obj\n");
    return 2;
  }
  const client::Mesh garment = read_garment(argv[2]);
  const client::Client coordinator(argv[1]);
  coordinator.wait_ready(std::chrono::seconds(30));

  client::EnhanceSession session = coordinator.enhance({.coarse = garment, .frame_time_s = 0.04});
  std::printf("%s: %zu -> %zu vertices\n", session.info().model.c_str(), garment.vertex_count(),
              session.info().fine.vertex_count());

  std::vector<float> last;
  session.run(
      std::stoul(argv[3]),
      [&](std::uint64_t index) {  // the coarse frame with this index
        client::CoarseFrame frame;
        frame.index = index;
        frame.time_s = 0.04 * static_cast<double>(index);
        frame.positions = garment.positions;
        for (std::size_t i = 0; i < frame.positions.size(); i += 3)
          frame.positions[i + 1] += 0.05f * std::sin(4 * frame.positions[i] + static_cast<float>(frame.time_s));
        return frame;
      },
      [&](const client::EnhancedFrame& fine, const client::CoarseFrame&) {  // its answer, in order
        if (fine.error) {
          std::printf("%s\n", fine.error->what());  // the session goes on
          return;
        }
        double ms = 0;
        for (const client::StageTime& time : fine.stage_times) ms += time.ms;
        std::printf("frame %llu: %.1f ms, %u self-intersections\n", static_cast<unsigned long long>(fine.index), ms,
                    fine.report.self_intersections_after);
        last = fine.positions;
      });

  std::ofstream out(argv[4]);
  for (std::size_t i = 0; i + 2 < last.size(); i += 3)
    out << "v " << last[i] << ' ' << last[i + 1] << ' ' << last[i + 2] << '\n';
  const client::Mesh& fine = session.info().fine;
  for (std::size_t i = 0; i + 2 < fine.faces.size(); i += 3)
    out << "f " << fine.faces[i] + 1 << ' ' << fine.faces[i + 1] + 1 << ' ' << fine.faces[i + 2] + 1 << '\n';
  return out.flush() ? 0 : 1;
} catch (const pleat::Error& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
