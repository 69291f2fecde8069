// The panels of the 3D views: their places, labels, tools and keys. Shared by the report and the live page.
import type { Stage, ViewName } from "./views";

const kExpand = '<svg viewBox="0 0 16 16"><path d="M2.5 6V2.5H6M13.5 6V2.5H10M2.5 10v3.5H6M13.5 10v3.5H10"/></svg>';
const kViewTitles: Record<ViewName, string> = {
  coarse: "Coarse",
  enhanced: "Enhanced",
  reference: "Simulated",
  map: "Distance",
};

export function byId<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

export function div(className: string, parent: HTMLElement): HTMLDivElement {
  const element = document.createElement("div");
  element.className = className;
  parent.append(element);
  return element;
}

/** Small facts beside the title. */
export function setChips(texts: string[]): void {
  const chips = texts.filter((text) => text !== "").map((text) => {
    const chip = document.createElement("span");
    chip.textContent = text;
    return chip;
  });
  byId("chips").replaceChildren(...chips);
}

export class ViewGrid {
  readonly container = byId("views");
  readonly panels = new Map<ViewName, HTMLElement>();
  readonly overlays = new Map<ViewName, HTMLElement>();
  private readonly overlay = div("overlay", this.container);
  private shown: Stage | undefined;
  private soloView: ViewName | null = null;
  private wire = false;

  constructor() {
    new ResizeObserver(() => this.arrange()).observe(this.container);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.applyTheme());
  }

  /** What the panels show; `stage` is made for them. */
  get stage(): Stage | undefined {
    return this.shown;
  }
  set stage(stage: Stage | undefined) {
    this.shown = stage;
    this.applyTheme();
    this.setWireframe(this.wire);
    this.arrange();
  }

  get solo(): ViewName | null {
    return this.soloView;
  }
  set solo(name: ViewName | null) {
    this.soloView = name;
    this.arrange();
  }

  get wireframe(): boolean {
    return this.wire;
  }

  addView(name: ViewName, note: string): HTMLElement {
    this.panels.set(name, div("view", this.container));
    const overlay = div("", this.overlay);
    const label = div("label", overlay);
    label.innerHTML = `<b>${kViewTitles[name]}</b><small></small>`;
    const expand = document.createElement("button");
    expand.className = "expand";
    expand.innerHTML = kExpand;
    expand.title = `Show this view alone (${this.panels.size})`;
    expand.setAttribute("aria-label", `Show ${kViewTitles[name]} alone`);
    expand.addEventListener("click", () => this.toggleSolo(name));
    overlay.append(expand);
    this.overlays.set(name, overlay);
    this.setNote(name, note);
    return overlay;
  }

  setNote(name: ViewName, note: string): void {
    this.overlays.get(name)!.querySelector("small")!.textContent = note;
  }

  setWireframe(on: boolean): void {
    this.wire = on;
    byId("wireframe").setAttribute("aria-pressed", String(on));
    this.shown?.setWireframe(on);
  }

  /** Buttons and keys; `key` gets those that are not ours, and returns whether it knew them. */
  addTools(key: (event: KeyboardEvent) => boolean): void {
    const turntable = byId("turntable");
    const toggleTurntable = () => {
      if (!this.shown) return;
      const { controls } = this.shown;
      controls.autoRotate = !controls.autoRotate;
      turntable.setAttribute("aria-pressed", String(controls.autoRotate));
      this.shown.invalidate();
    };
    const toggleWireframe = () => this.setWireframe(!this.wire);
    turntable.addEventListener("click", toggleTurntable);
    byId("wireframe").addEventListener("click", toggleWireframe);
    byId("reset").addEventListener("click", () => this.shown?.resetCamera());
    this.container.addEventListener("dblclick", (event) => {
      for (const [name, panel] of this.panels) {
        if (panel === event.target) this.toggleSolo(name);
      }
    });
    window.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
      const names = [...this.panels.keys()];
      const number = Number(event.key);
      if (number >= 1 && number <= names.length) {
        this.toggleSolo(names[number - 1]);
      } else if (event.key === "Escape" || event.key === "0") {
        this.solo = null;
      } else if (event.key === "t") {
        toggleTurntable();
      } else if (event.key === "w") {
        toggleWireframe();
      } else if (event.key === "r") {
        this.shown?.resetCamera();
      } else if (!key(event)) {
        return;
      }
      event.preventDefault();
    });
  }

  private toggleSolo(name: ViewName): void {
    this.solo = this.soloView === name ? null : name;
  }

  /** Chooses the number of columns that gives the largest, squarest panels. */
  private arrange(): void {
    const visible = [...this.panels.keys()].filter((name) => !this.soloView || name === this.soloView);
    const { clientWidth: width, clientHeight: height } = this.container;
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
    for (const grid of [this.container, this.overlay]) {
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
    this.shown?.invalidate();
  }

  private applyTheme(): void {
    this.shown?.setInk(getComputedStyle(document.documentElement).getPropertyValue("--grid").trim());
  }
}
