// The report: a run that is over. Publishes window.pleatReport, which tests and the screenshot script drive.
import { Comparison, type MapKind } from "./comparison";
import { formatNumber } from "./charts";
import { readDataset, type Dataset } from "./data";
import { byId, div, setChips, ViewGrid } from "./grid";
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
  /** Positions x0,y0,z0,x1,... of an obstacle's vertices in the shown frame, metres; none of a sphere. */
  obstacle(index: number): number[];
  /** Draws now, and returns when the picture is complete. */
  render(): void;
}

declare global {
  interface Window {
    pleatReport: PleatReport;
  }
}

class Page {
  private readonly grid = new ViewGrid();
  private readonly comparison: Comparison;
  private readonly stage: Stage;
  private readonly panel: Panel;
  private readonly player: Player;

  constructor(private readonly data: Dataset) {
    const { report } = data.meta;
    byId("title").textContent = report.title;
    setChips([report.model, `${report.device} · ${report.precision}`]);
    this.comparison = new Comparison(data);
    const { grid } = this;
    grid.addView("coarse", `${report.coarse_vertices.toLocaleString("en")} vertices`);
    grid.addView("enhanced", `${report.fine_vertices.toLocaleString("en")} vertices`);
    if (data.reference) grid.addView("reference", "the fine simulation, as reference");
    if (this.comparison.kinds.length > 0) this.addMapView();
    this.stage = new Stage(grid.container, byId<HTMLCanvasElement>("canvas"), data, this.comparison, grid.panels);
    this.panel = new Panel(byId("side"), data, this.comparison, (index) => this.seek(index));
    this.player = new Player(data, (stored) => this.show(stored));
    grid.addTools((event) => this.player.key(event));
    grid.stage = this.stage;
    this.stage.resetCamera();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    this.player.show(0);
    this.publish();
  }

  private addMapView(): void {
    const overlay = this.grid.addView("map", "");
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
    const overlay = this.grid.overlays.get("map");
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

  private redraw(): void {
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
      views: [...this.grid.panels.keys()],
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
        return page.grid.solo;
      },
      set solo(name) {
        page.grid.solo = name;
      },
      get map() {
        return page.stage.mapKind;
      },
      set map(kind) {
        if (kind) page.setMap(kind);
      },
      get wireframe() {
        return page.grid.wireframe;
      },
      set wireframe(on) {
        page.grid.setWireframe(on);
      },
      setCamera: (azimuth, elevation, zoom) => page.stage.resetCamera(azimuth, elevation, zoom),
      distances: (kind) => [...(page.comparison.series.get(kind)?.rms ?? [])],
      obstacle: (index) => {
        const mesh = page.data.obstacles[index]?.mesh;
        return mesh ? [...mesh.positions(page.player.stored, new Float32Array(3 * mesh.vertices))] : [];
      },
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

export async function startReport(): Promise<void> {
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
