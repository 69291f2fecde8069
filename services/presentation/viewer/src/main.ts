// Wires the page together and publishes window.pleatReport, which tests and the screenshot script drive.
import { Comparison, type MapKind } from "./comparison";
import { formatNumber } from "./charts";
import { readDataset, type Dataset } from "./data";
import { mapGradient } from "./materials";
import { Panel } from "./panel";
import { Player } from "./player";
import { Stage, type ViewName } from "./views";

/** The page's interface for scripts. */
interface PleatReport {
  ready: boolean;
  error: string | null;
  readonly frameCount: number;
  readonly views: ViewName[];
  /** Index of the shown frame of the run; setting it pauses. */
  frame: number;
  playing: boolean;
  /** Shows one view alone, or all with null. */
  solo: ViewName | null;
  map: MapKind | undefined;
  wireframe: boolean;
  /** Angles in radians. */
  setCamera(azimuth: number, elevation: number, zoom?: number): void;
  /** RMS distance per shown frame of what the map can show, metres. */
  distances(kind: MapKind): number[];
  /** Draws now, and returns when the picture is complete. */
  render(): void;
}

declare global {
  interface Window {
    pleatReport: PleatReport;
  }
}

const kExpand = '<svg viewBox="0 0 16 16"><path d="M2.5 6V2.5H6M13.5 6V2.5H10M2.5 10v3.5H6M13.5 10v3.5H10"/></svg>';
const kViewTitles: Record<ViewName, string> = {
  coarse: "Coarse",
  enhanced: "Enhanced",
  reference: "Simulated",
  map: "Distance",
};

function byId<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

function div(className: string, parent: HTMLElement): HTMLDivElement {
  const element = document.createElement("div");
  element.className = className;
  parent.append(element);
  return element;
}

class Page {
  private readonly panels = new Map<ViewName, HTMLElement>();
  private readonly overlays = new Map<ViewName, HTMLElement>();
  private readonly overlay: HTMLElement;
  private readonly views = byId("views");
  private readonly comparison: Comparison;
  private readonly stage: Stage;
  private readonly panel: Panel;
  private readonly player: Player;
  private soloView: ViewName | null = null;
  private wire = false;

  constructor(private readonly data: Dataset) {
    const { report } = data.meta;
    byId("title").textContent = report.title;
    for (const text of [report.model, `${report.device} · ${report.precision}`]) {
      if (!text) continue;
      const chip = document.createElement("span");
      chip.textContent = text;
      byId("chips").append(chip);
    }
    this.comparison = new Comparison(data);
    this.overlay = div("overlay", this.views);
    this.addView("coarse", `${report.coarse_vertices.toLocaleString("en")} vertices`);
    this.addView("enhanced", `${report.fine_vertices.toLocaleString("en")} vertices`);
    if (data.reference) this.addView("reference", "the fine simulation, as reference");
    if (this.comparison.kinds.length > 0) this.addMapView();
    this.stage = new Stage(this.views, byId<HTMLCanvasElement>("canvas"), data, this.comparison, this.panels);
    this.panel = new Panel(byId("side"), data, this.comparison, (index) => this.seek(index));
    this.player = new Player(data, (stored) => this.show(stored));
    this.addTools();
    this.arrange();
    this.stage.resetCamera();
    this.applyTheme();
    new ResizeObserver(() => this.arrange()).observe(this.views);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.applyTheme());
    this.player.show(0);
    this.publish();
  }

  private addView(name: ViewName, note: string): HTMLElement {
    this.panels.set(name, div("view", this.views));
    const overlay = div("", this.overlay);
    const label = div("label", overlay);
    label.innerHTML = `<b>${kViewTitles[name]}</b><small></small>`;
    label.querySelector("small")!.textContent = note;
    const expand = document.createElement("button");
    expand.className = "expand";
    expand.innerHTML = kExpand;
    expand.title = `Show this view alone (${this.panels.size})`;
    expand.setAttribute("aria-label", `Show ${kViewTitles[name]} alone`);
    expand.addEventListener("click", () => this.setSolo(this.soloView === name ? null : name));
    overlay.append(expand);
    this.overlays.set(name, overlay);
    return overlay;
  }

  private addMapView(): void {
    const overlay = this.addView("map", "");
    const legend = div("legend", overlay);
    div("ticks", legend);
    div("bar", legend).style.background = mapGradient();
    if (this.comparison.kinds.length < 2) return;
    const segments = div("segments", overlay);
    segments.setAttribute("role", "group");
    segments.setAttribute("aria-label", "What the map shows");
    for (const { kind, button, title } of this.comparison.kinds) {
      const element = document.createElement("button");
      element.textContent = button;
      element.title = title;
      element.dataset.kind = kind;
      element.addEventListener("click", () => this.setMap(kind));
      segments.append(element);
    }
  }

  private setMap(kind: MapKind): void {
    this.stage.mapKind = kind;
    this.stage.setFrame(this.player.stored);
    this.describeMap();
  }

  private describeMap(): void {
    const overlay = this.overlays.get("map");
    const kind = this.stage.mapKind;
    if (!overlay || !kind) return;
    const info = this.comparison.kinds.find((entry) => entry.kind === kind)!;
    const { rms, max } = this.stage.mapFigures;
    overlay.querySelector("b")!.textContent = kind === "detail" ? "Added detail" : "Error map";
    const small = overlay.querySelector("small")!;
    small.textContent = `RMS ${formatNumber(rms * 1000)} mm, largest ${formatNumber(max * 1000)} mm`;
    small.title = info.title;
    for (const button of overlay.querySelectorAll<HTMLButtonElement>(".segments button")) {
      button.setAttribute("aria-pressed", String(button.dataset.kind === kind));
    }
    const top = 1000 * this.comparison.scale.get(kind)!;
    const ticks = overlay.querySelector(".ticks")!;
    ticks.replaceChildren();
    for (let i = 0; i <= 4; ++i) {
      const tick = document.createElement("span");
      tick.style.bottom = `${i * 25}%`;
      tick.textContent = `${i === 4 ? "≥ " : ""}${formatNumber((top * i) / 4)}${i === 0 ? " mm" : ""}`;
      ticks.append(tick);
    }
  }

  private addTools(): void {
    const turntable = byId("turntable");
    const wireframe = byId("wireframe");
    const toggleTurntable = () => {
      this.stage.controls.autoRotate = !this.stage.controls.autoRotate;
      turntable.setAttribute("aria-pressed", String(this.stage.controls.autoRotate));
      this.stage.invalidate();
    };
    const toggleWireframe = () => this.setWireframe(!this.wire);
    turntable.addEventListener("click", toggleTurntable);
    wireframe.addEventListener("click", toggleWireframe);
    byId("reset").addEventListener("click", () => this.stage.resetCamera());
    this.views.addEventListener("dblclick", (event) => {
      for (const [name, panel] of this.panels) {
        if (panel === event.target) this.setSolo(this.soloView === name ? null : name);
      }
    });
    window.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
      const names = [...this.panels.keys()];
      const number = Number(event.key);
      if (number >= 1 && number <= names.length) {
        this.setSolo(this.soloView === names[number - 1] ? null : names[number - 1]);
      } else if (event.key === "Escape" || event.key === "0") {
        this.setSolo(null);
      } else if (event.key === "t") {
        toggleTurntable();
      } else if (event.key === "w") {
        toggleWireframe();
      } else if (event.key === "r") {
        this.stage.resetCamera();
      } else if (!this.player.key(event)) {
        return;
      }
      event.preventDefault();
    });
  }

  private setWireframe(on: boolean): void {
    this.wire = on;
    byId("wireframe").setAttribute("aria-pressed", String(on));
    this.stage.setWireframe(on);
  }

  private setSolo(name: ViewName | null): void {
    this.soloView = name;
    this.arrange();
  }

  /** Chooses the number of columns that gives the largest, squarest panels. */
  private arrange(): void {
    const visible = [...this.panels.keys()].filter((name) => !this.soloView || name === this.soloView);
    const { clientWidth: width, clientHeight: height } = this.views;
    let columns = 1;
    let best = 0;
    for (let candidate = 1; candidate <= visible.length; ++candidate) {
      const rows = Math.ceil(visible.length / candidate);
      const size = Math.min(width / candidate, (1.05 * height) / rows);
      if (size > best * 1.02) {
        best = size;
        columns = candidate;
      }
    }
    for (const grid of [this.views, this.overlay]) {
      grid.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
      grid.style.gridAutoRows = "minmax(0, 1fr)";
    }
    for (const name of this.panels.keys()) {
      // The last view fills its row.
      const holes = (columns - (visible.length % columns)) % columns;
      const span = name === visible[visible.length - 1] ? `span ${1 + holes}` : "";
      for (const element of [this.panels.get(name)!, this.overlays.get(name)!]) {
        element.style.display = visible.includes(name) ? "" : "none";
        element.style.gridColumn = span;
      }
    }
    this.stage.invalidate();
  }

  private applyTheme(): void {
    this.stage.setInk(getComputedStyle(document.documentElement).getPropertyValue("--grid").trim());
    this.panel.redraw();
    this.player.draw();
  }

  private show(stored: number): void {
    this.stage.setFrame(stored);
    this.panel.setFrame(stored * this.data.meta.stride);
    this.describeMap();
  }

  private seek(index: number): void {
    this.player.playing = false;
    this.player.show(Math.floor(index / this.data.meta.stride));
  }

  private publish(): void {
    const page = this;
    window.pleatReport = {
      ready: true,
      error: null,
      frameCount: this.data.meta.report.frames,
      views: [...this.panels.keys()],
      get frame() {
        return page.player.stored * page.data.meta.stride;
      },
      set frame(index) {
        page.seek(index);
      },
      get playing() {
        return page.player.playing;
      },
      set playing(on) {
        page.player.playing = on;
      },
      get solo() {
        return page.soloView;
      },
      set solo(name) {
        page.setSolo(name);
      },
      get map() {
        return page.stage.mapKind;
      },
      set map(kind) {
        if (kind) page.setMap(kind);
      },
      get wireframe() {
        return page.wire;
      },
      set wireframe(on) {
        page.setWireframe(on);
      },
      setCamera: (azimuth, elevation, zoom) => page.stage.resetCamera(azimuth, elevation, zoom),
      distances: (kind) => [...(page.comparison.series.get(kind)?.rms ?? [])],
      render: () => page.stage.render(),
    };
  }

  run(): void {
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches || location.hash.includes("still");
    this.player.playing = !still;
    const step = (now: number) => {
      this.player.advance(now);
      this.stage.draw();
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }
}

async function start(): Promise<void> {
  const notice = byId("notice");
  try {
    const page = new Page(await readDataset());
    notice.hidden = true;
    page.run();
  } catch (error) {
    const reason = error instanceof Error ? error.message : String(error);
    notice.textContent = `The report can't be shown: ${reason}`;
    window.pleatReport = { ready: false, error: reason } as PleatReport;
    throw error;
  }
}

void start();
