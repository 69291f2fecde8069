// The column of figures: tiles, stage times, distances, facts.
import { Chart, formatNumber, type Series } from "./charts";
import type { Comparison } from "./comparison";
import type { Dataset } from "./data";
import { percentile } from "./geometry";

export const kPalette = 8;

export function make<K extends keyof HTMLElementTagNameMap>(tag: K, className = "", text = ""): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  return element;
}

export function card(parent: HTMLElement, title: string, note: string): HTMLElement {
  const section = make("section", "card");
  const heading = make("h2", "", title);
  heading.append(make("span", "", note));
  section.append(heading);
  parent.append(section);
  return section;
}

export function readable(name: string): string {
  const spaced = name.replace(/[_-]+/g, " ");
  return spaced.charAt(0).toUpperCase() + spaced.slice(1);
}

export function tile(parent: HTMLElement, value: string, name: string, kind = ""): void {
  const element = make("div", `tile ${kind}`);
  element.append(make("b", "", value), make("span", "", name));
  parent.append(element);
}

function addTiles(side: HTMLElement, data: Dataset): void {
  const { report } = data.meta;
  const section = make("section", "card");
  const tiles = make("div", "tiles");
  section.append(tiles);
  side.append(section);
  tile(tiles, formatNumber(report.frames_per_s), "frames/s, end to end");
  tile(tiles, report.frames.toLocaleString("en"), `frames in ${formatNumber(report.wall_s)} s`);
  tile(tiles, `${(report.fine_vertices / Math.max(1, report.coarse_vertices)).toFixed(1)}×`, "the vertices");
  const fidelity = report.fidelity?.enhanced;
  if (fidelity) {
    tile(tiles, formatNumber(1000 * fidelity.rmse_m), "mm RMS to the reference");
  } else {
    tile(tiles, report.fine_faces.toLocaleString("en"), "fine faces");
  }
  const verdict = (value: number) => (value === 0 ? "good" : "bad");
  tile(tiles, report.penetrations.toLocaleString("en"), "penetrations", verdict(report.penetrations));
  tile(tiles, report.self_intersections.toLocaleString("en"), "self-inter\u00adsections", verdict(report.self_intersections));
}

function addStages(side: HTMLElement, data: Dataset, onFrame: (index: number) => void): Chart | undefined {
  const { meta } = data;
  if (meta.stages.length === 0) return undefined;
  const section = card(side, "Stage times", "ms per frame");
  const series: Series[] = meta.stages.map(({ name, ms }, i) => ({ name, values: ms, color: `--c${i % kPalette}` }));
  const chart = new Chart(series, meta.report.frames, { stacked: true, height: 150, onFrame });
  chart.canvas.id = "stage-chart";
  section.append(chart.canvas);
  const table = make("table");
  const head = table.createTHead().insertRow();
  for (const title of ["Stage", "now", "median", "p95"]) head.append(make("th", "", title));
  const body = table.createTBody();
  for (const { name, color } of series) {
    const row = body.insertRow();
    const label = row.insertCell();
    const swatch = make("i", "swatch");
    swatch.style.background = `var(${color})`;
    label.append(swatch, readable(name));
    row.insertCell().className = "now";
    row.insertCell().textContent = meta.report.stages[name].median_ms.toFixed(2);
    row.insertCell().textContent = meta.report.stages[name].p95_ms.toFixed(2);
  }
  const totals = new Float64Array(meta.report.frames);
  for (const { values } of series) for (let i = 0; i < totals.length; ++i) totals[i] += values[i];
  const total = body.insertRow();
  total.className = "total";
  total.insertCell().textContent = "Sum";
  total.insertCell().className = "now";
  total.insertCell().textContent = percentile(totals, 0.5).toFixed(2);
  total.insertCell().textContent = percentile(totals, 0.95).toFixed(2);
  total.title = "Stages of different frames overlap: the time between two frames is shorter than the sum";
  section.append(table);
  return chart;
}

function addDistances(side: HTMLElement, data: Dataset, comparison: Comparison, onFrame: (index: number) => void): Chart | undefined {
  const shown = comparison.kinds.filter(({ kind }) => !data.reference || kind !== "detail");
  if (shown.length === 0) return undefined;
  const section = card(side, data.reference ? "Distance to the reference" : "Detail added", "RMS, mm");
  const colors = { enhanced: "--c2", upsampled: "--c0", detail: "--c2" };
  const series: Series[] = shown.map(({ kind }) => ({
    name: kind === "enhanced" ? "Enhanced" : kind === "upsampled" ? "Coarse, upsampled" : "To the upsampled coarse cloth",
    color: colors[kind],
    values: stretch(comparison.series.get(kind)!.rms, data).map((metres) => 1000 * metres),
  }));
  const chart = new Chart(series, data.meta.report.frames, { stacked: false, height: 120, onFrame });
  chart.canvas.id = "distance-chart";
  section.append(chart.canvas);
  const keys = make("div", "keys");
  for (const { name, color } of series) {
    const key = make("span");
    const swatch = make("i", "swatch");
    swatch.style.background = `var(${color})`;
    key.append(swatch, name);
    keys.append(key);
  }
  section.append(keys);
  return chart;
}

/** Values of the stored frames onto all frames of the run. */
function stretch(values: Float32Array, data: Dataset): Float32Array {
  const out = new Float32Array(data.meta.report.frames);
  for (let i = 0; i < out.length; ++i) out[i] = values[Math.min(values.length - 1, Math.floor(i / data.meta.stride))];
  return out;
}

function addFacts(side: HTMLElement, data: Dataset): void {
  const { report, stride } = data.meta;
  const section = card(side, "Run", "");
  const list = make("dl");
  const fact = (name: string, value: string) => {
    const description = make("dd", "", value);
    description.title = value;
    list.append(make("dt", "", name), description);
  };
  fact("Model", report.model || "none");
  fact("Device", `${report.device}, ${report.precision}`);
  fact("Coarse", `${report.coarse_vertices.toLocaleString("en")} vertices, ${report.coarse_faces.toLocaleString("en")} faces`);
  fact("Fine", `${report.fine_vertices.toLocaleString("en")} vertices, ${report.fine_faces.toLocaleString("en")} faces`);
  fact("Motion", `${formatNumber(report.frames * report.frame_time_s)} s, ${formatNumber(1 / report.frame_time_s)} frames/s`);
  if (stride > 1) fact("Shown", `every ${stride}th frame`);
  if (report.git_revision) fact("Revision", report.git_revision);
  section.append(list);
}

export class Panel {
  private readonly charts: Chart[];

  constructor(
    private readonly side: HTMLElement,
    private readonly data: Dataset,
    comparison: Comparison,
    onFrame: (index: number) => void,
  ) {
    addTiles(side, data);
    const charts = [addStages(side, data, onFrame), addDistances(side, data, comparison, onFrame)];
    this.charts = charts.filter((chart) => chart !== undefined);
    addFacts(side, data);
  }

  /** index: frame of the run. */
  setFrame(index: number): void {
    for (const chart of this.charts) chart.setCurrent(index);
    const times = this.data.meta.stages.map(({ ms }) => ms[index] ?? 0);
    const cells = this.side.querySelectorAll<HTMLElement>("td.now");
    cells.forEach((cell, row) => {
      const value = row < times.length ? times[row] : times.reduce((sum, ms) => sum + ms, 0);
      cell.textContent = value.toFixed(2);
    });
  }

  redraw(): void {
    for (const chart of this.charts) chart.draw();
  }
}
