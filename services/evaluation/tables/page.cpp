// tables.html: one file without links, for any browser with WebGL 2.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <sstream>

#include "common/base/html.hpp"
#include "services/evaluation/tables/tables.hpp"
#include "services/presentation/report/encode.hpp"

namespace pleat::evaluation {
namespace {

constexpr const char* kHead = R"(<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="generator" content="pleat.tables"><title>Pleat: the paper's tables</title>
<style>
body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1240px;padding:0 1rem;color:#1d2630;background:#fff}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2.2rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .7rem;text-align:right;border-bottom:1px solid #dfe4ea}
th.name,td.name{text-align:left}td.paper{color:#66727f}td.here{font-weight:600}
.scroll{overflow-x:auto}.note{color:#4a5561;max-width:60rem}code{background:#f1f3f6;padding:.1rem .3rem;font-size:.85em}
.row{display:flex;flex-wrap:wrap;gap:.6rem}figure{margin:0;width:228px}figure canvas{width:228px;height:228px;border:1px solid #dfe4ea;border-radius:4px;cursor:grab;touch-action:none;display:block}
figcaption{font-size:.85rem;overflow-wrap:anywhere}.empty{width:228px;height:228px;border:1px dashed #b8c1cb;border-radius:4px;display:flex;align-items:center;justify-content:center;color:#66727f;font-size:.85rem}
.scale{display:inline-block;width:180px;height:10px;vertical-align:middle;margin:0 .5rem;background:linear-gradient(90deg,#24428f,#2fa4c9,#7ec95a,#f2c230,#d2301f)}
)";

constexpr const char* kTitle = R"(</style></head><body>
<h1>The tables of the papers, printed and measured</h1>
)";

/// Draws every canvas[data-mesh] from the meshes in `data`; dragging one turns all of its row.
constexpr const char* kScript = R"(<script>
'use strict';
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const surface = document.createElement('canvas');
surface.width = surface.height = 456;
const gl = surface.getContext('webgl2', {antialias: true, preserveDrawingBuffer: true});
if (!gl) document.querySelectorAll('figcaption').forEach(c => c.append(' (needs WebGL 2)'));
function program() {
  const part = (kind, source) => {
    const s = gl.createShader(kind);
    gl.shaderSource(s, source); gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw Error(gl.getShaderInfoLog(s));
    return s;
  };
  const p = gl.createProgram();
  gl.attachShader(p, part(gl.VERTEX_SHADER, `#version 300 es
    layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in float error;
    uniform mat3 turn; uniform vec3 center; uniform float radius; out vec3 n; out float e;
    void main() { vec3 p = turn * (position - center) / radius; n = turn * normal; e = error;
      gl_Position = vec4(p.x, p.y, -0.3 * p.z, 1.0); }`));
  gl.attachShader(p, part(gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float; in vec3 n; in float e; out vec4 color;
    vec3 ramp(float t) { vec3 c[5] = vec3[5](vec3(.14,.26,.56), vec3(.18,.64,.79), vec3(.49,.79,.35), vec3(.95,.76,.19), vec3(.82,.19,.12));
      t = clamp(t, 0.0, 1.0) * 4.0; int i = min(int(t), 3); return mix(c[i], c[i + 1], t - float(i)); }
    void main() { vec3 base = e < 0.0 ? vec3(.72,.74,.78) : ramp(e);
      float light = abs(dot(normalize(n), normalize(vec3(.35, .5, .8))));
      color = vec4(base * (.35 + .65 * light), 1.0); }`));
  gl.linkProgram(p);
  return p;
}
const shader = gl && program();
function upload(positions, faces, errors) {
  const normals = new Float32Array(positions.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const u = [0, 1, 2].map(k => positions[b + k] - positions[a + k]), v = [0, 1, 2].map(k => positions[c + k] - positions[a + k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const at of [a, b, c]) for (let k = 0; k < 3; ++k) normals[at + k] += n[k];
  }
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  [[positions, 3], [normals, 3], [errors, 1]].forEach(([values, size], place) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
  });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  return array;
}
function turnOf(yaw, pitch) {
  const [c, s, d, t] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return [c, t * s, -d * s, 0, d, t, s, -t * c, d * c];  // columns
}
for (const row of gl ? data : []) {
  const faces = {fine: new Uint32Array(bytes(row.fine).buffer), coarse: new Uint32Array(bytes(row.coarse).buffer)};
  const panels = row.meshes.map(mesh => {
    const positions = new Float32Array(bytes(mesh.positions).buffer), errors = new Float32Array(positions.length / 3).fill(-1);
    return {mesh, positions, errors, faces: mesh.coarse ? faces.coarse : faces.fine};
  });
  const truth = panels.find(p => p.mesh.reference).positions;
  for (const p of panels) {
    if (p.mesh.coarse || p.mesh.reference) continue;
    for (let v = 0; v < p.errors.length; ++v)
      p.errors[v] = Math.hypot(p.positions[3 * v] - truth[3 * v], p.positions[3 * v + 1] - truth[3 * v + 1], p.positions[3 * v + 2] - truth[3 * v + 2]) / row.scale;
  }
  const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
  truth.forEach((x, i) => { low[i % 3] = Math.min(low[i % 3], x); high[i % 3] = Math.max(high[i % 3], x); });
  const center = low.map((x, k) => (x + high[k]) / 2), radius = .52 * Math.hypot(...low.map((x, k) => high[k] - x));
  const view = {yaw: .5, pitch: .35};
  for (const p of panels) {
    p.array = upload(p.positions, p.faces, p.errors);
    p.canvas = document.getElementById(p.mesh.id);
    p.canvas.width = p.canvas.height = surface.width;
  }
  const draw = () => panels.forEach(p => {
    gl.viewport(0, 0, surface.width, surface.height);
    gl.clearColor(1, 1, 1, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST); gl.useProgram(shader);
    gl.uniformMatrix3fv(gl.getUniformLocation(shader, 'turn'), false, turnOf(view.yaw, view.pitch));
    gl.uniform3fv(gl.getUniformLocation(shader, 'center'), center);
    gl.uniform1f(gl.getUniformLocation(shader, 'radius'), radius);
    gl.bindVertexArray(p.array);
    gl.drawElements(gl.TRIANGLES, p.faces.length, gl.UNSIGNED_INT, 0);
    p.canvas.getContext('2d').drawImage(surface, 0, 0);
  });
  let pending = false;
  panels.forEach(p => {
    p.canvas.onpointerdown = event => p.canvas.setPointerCapture(event.pointerId);
    p.canvas.onpointermove = event => {
      if (!event.buttons) return;
      view.yaw += .01 * event.movementX;
      view.pitch = Math.max(-1.5, Math.min(1.5, view.pitch + .01 * event.movementY));
      if (!pending) { pending = true; requestAnimationFrame(() => { pending = false; draw(); }); }
    };
  });
  draw();
}
</script>
)";

std::string figure(const std::optional<double>& value, const std::string& format) {
  if (!value) return "&ndash;";
  char text[64];
  std::snprintf(text, sizeof text, format.c_str(), *value);
  return text;
}

void write_table(std::ostringstream& out, const Table& table) {
  out << "<h2>" << escape_html(table.title) << "</h2>\n<div class=\"scroll\"><table>\n<tr>";
  for (const std::string& key : table.keys) out << "<th class=\"name\" rowspan=\"2\">" << escape_html(key) << "</th>";
  for (std::size_t i = 0; i < table.columns.size(); ++i)
    out << "<th colspan=\"" << (has_printed(table, i) ? 2 : 1) << "\">" << escape_html(table.columns[i]) << "</th>";
  out << "</tr>\n<tr>";
  for (std::size_t i = 0; i < table.columns.size(); ++i)
    out << (has_printed(table, i) ? "<th>paper</th><th>here</th>" : "<th>here</th>");
  out << "</tr>\n";
  std::vector<std::string> missing;
  for (const TableRow& row : table.rows) {
    out << "<tr>";
    for (const std::string& name : row.names) out << "<td class=\"name\">" << escape_html(name) << "</td>";
    for (std::size_t i = 0; i < row.entries.size(); ++i) {
      const TableEntry& entry = row.entries[i];
      if (has_printed(table, i)) out << "<td class=\"paper\">" << figure(entry.printed, table.formats[i]) << "</td>";
      out << "<td class=\"here\">" << figure(entry.measured, table.formats[i]) << "</td>";
      if (entry.measured || entry.missing.empty()) continue;
      std::string line = escape_html(row.names.front());
      for (std::size_t k = 1; k < row.names.size(); ++k) line += ", " + escape_html(row.names[k]);
      line += ": <code>" + escape_html(entry.missing) + "</code>";
      if (std::find(missing.begin(), missing.end(), line) == missing.end()) missing.push_back(line);
    }
    out << "</tr>\n";
  }
  out << "</table></div>\n<p class=\"note\">" << escape_html(table.note) << "</p>\n";
  if (missing.empty()) return;
  out << "<p class=\"note\">Not made on this machine yet:</p><ul>";
  for (const std::string& line : missing) out << "<li>" << line << "</li>";
  out << "</ul>\n";
}

void write_curves(std::ostringstream& out, const std::vector<Convergence>& curves) {
  const char* const colors[] = {"#24428f", "#d2301f"};
  const std::pair<const char*, std::vector<double> Convergence::*> features[] = {
      {"displacement", &Convergence::displacement_db},
      {"normal", &Convergence::normal_db},
      {"velocity", &Convergence::velocity_db}};
  for (const auto& [name, values] : features) {
    LineChart chart{std::string("PSNR of the ") + name + " over minutes of training", "dB", false, {}};
    for (std::size_t c = 0; c < curves.size(); ++c)
      chart.lines.push_back({curves[c].name, colors[c % 2], curves[c].minutes, curves[c].*values});
    out << line_chart(chart);
  }
}

template <typename Array>
std::string encoded(const Array& values) {
  return presentation::base64({reinterpret_cast<const std::uint8_t*>(values.data()),
                               static_cast<std::size_t>(values.size()) * sizeof(*values.data())});
}

/// Distances that 95 % of the vertices of all methods but the worst stay below: a method that is far off must not
/// make the others look perfect.
double error_scale(const PictureRow& row, const Positions& reference) {
  double scale = 0;
  for (const Picture& picture : row.pictures) {
    if (picture.coarse || picture.reference || picture.positions.rows() != reference.rows()) continue;
    std::vector<double> errors;
    for (Eigen::Index v = 0; v < reference.rows(); ++v)
      errors.push_back(static_cast<double>((picture.positions.row(v) - reference.row(v)).norm()));
    std::sort(errors.begin(), errors.end());
    const double high = errors[errors.size() * 95 / 100];
    scale = scale == 0 ? high : std::min(scale, high);
  }
  return 2 * scale;
}

void write_pictures(std::ostringstream& out, const std::string& title, const std::vector<PictureRow>& rows,
                    const std::string& prefix, std::ostringstream& data) {
  out << "<h2>" << title << "</h2>\n";
  if (rows.empty()) out << "<p class=\"note\">No data set on this machine yet.</p>\n";
  for (std::size_t r = 0; r < rows.size(); ++r) {
    const PictureRow& row = rows[r];
    const auto truth =
        std::find_if(row.pictures.begin(), row.pictures.end(), [](const Picture& p) { return p.reference; });
    const double scale = std::max(1e-6, error_scale(row, truth->positions));
    char text[128];
    std::snprintf(text, sizeof text, "0<span class=\"scale\"></span>%.2f mm and more", 1e3 * scale);
    out << "<p>" << escape_html(row.title) << ". Distance to the simulated vertex: " << text
        << ". Drag to turn.</p>\n<div class=\"row\">\n";
    data << "{scale:" << scale << ",fine:\"" << encoded(row.fine_faces) << "\",coarse:\"" << encoded(row.coarse_faces)
         << "\",meshes:[";
    for (std::size_t i = 0; i < row.pictures.size(); ++i) {
      const Picture& picture = row.pictures[i];
      const std::string id = prefix + std::to_string(r) + "-" + std::to_string(i);
      out << "<figure>";
      if (picture.positions.rows() == 0) {
        out << "<div class=\"empty\">not trained here</div><figcaption>" << escape_html(picture.label) << ": <code>"
            << escape_html(picture.missing) << "</code></figcaption></figure>\n";
        continue;
      }
      out << "<canvas id=\"" << id << "\"></canvas><figcaption>" << escape_html(picture.label);
      if (!picture.coarse && !picture.reference) {
        const double mse =
            (picture.positions - truth->positions).template cast<double>().rowwise().squaredNorm().mean();
        std::snprintf(text, sizeof text, ", RMSE %.3g mm", 1e3 * std::sqrt(mse));
        out << text;
      }
      out << "</figcaption></figure>\n";
      data << "{id:\"" << id << "\",coarse:" << (picture.coarse ? "true" : "false")
           << ",reference:" << (picture.reference ? "true" : "false") << ",positions:\"" << encoded(picture.positions)
           << "\"},";
    }
    out << "</div>\n";
    data << "]},\n";
  }
}

}  // namespace

std::string to_html(const PaperTables& tables) {
  std::ostringstream out, data;
  out << kHead << kChartStyle << "\n" << kTitle;
  for (const Table& table : tables.tables) write_table(out, table);
  write_curves(out, tables.figure13);
  write_pictures(out, "Fig. 11. Methods", tables.figure11, "m", data);
  write_pictures(out, "Fig. 12. Terms of the loss", tables.figure12, "l", data);
  write_pictures(out, "[DT-S]. Methods on free simulations", tables.deform, "d", data);
  out << "<script>\nconst data = [\n" << data.str() << "];\n</script>\n" << kScript << "</body></html>\n";
  return out.str();
}

}  // namespace pleat::evaluation
